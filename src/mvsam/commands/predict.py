"""`mvsam predict`."""

from __future__ import annotations

import json
import logging
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mvsam.commands.shared import (
    Device,
    Scale,
    for_each_scene,
    load_model,
    open_scenes,
    progress_bar,
)
from mvsam.errors import InputError, counted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mvsam.data.sampling import ViewTuple
    from mvsam.inference.scene import SceneResult
    from mvsam.types import Model, Scene

log = logging.getLogger("mvsam")


@dataclass(frozen=True)
class Predict:
    """Depth, confidence and labels for every photo of a scene.

    Photos that are done are skipped, so an interrupted run goes on with the same command.

    Example: mvsam predict my_room --out out/my_room
    """

    scene: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SCENE")]
    """A scene's folder in any format (docs/data.md), a folder of such, or rooms:val:0-3."""
    out: Path
    """Folder for the maps; of several scenes each gets a folder in it."""
    model: str = "tiny"
    """Name with embedded weights, path of a .safetensors file, or Hugging Face id."""
    views: int = 3
    """Photos that are looked at together: a reference and its best sources, 2 to 8; a model of
    single pictures takes one."""
    tuples: str | None = None
    """Which photos go together, as in mvsam eval: keyframes (only the photos of a stream
    that moved 10 cm or turned 15 degrees), mvs2d, every-100, or a file; where it is not given, the
    scene's own tuples, else every photo with those that overlap it best."""
    depth_range: tuple[float, float] | Literal["auto"] = (0.1, 5.0)
    """Nearest and farthest depth, metres; auto: an estimate from the scene's sparse points, where
    its format has them, or from its poses."""
    references: tuple[str, ...] = ()
    """Names of the photos to predict, without ending; all where none is given."""
    format: str | None = None
    """Format of the scene; found from its files where it is not given."""
    scale: Scale = 1.0
    poses: Literal["given", "refined", "colmap"] = "given"
    """refined: let the photos correct the given ones, which trackers have wrong by half a degree
    and some centimetres; seconds for a few photos. colmap: let COLMAP find them for a folder of
    photos or a video, which takes minutes; their scale is unknown unless --scale gives it."""
    save_npz: bool = False
    """Write depth/NAME.npz too: float32, metres."""
    overwrite: bool = False
    """Predict again what is done already."""
    device: Device = "auto"
    """Where the network runs; auto takes a GPU where there is one."""
    precision: Literal["auto", "float32", "bfloat16"] = "auto"
    """auto: bfloat16 where the device multiplies it natively; elsewhere it would be slower."""
    alone: bool = False
    """Leave each photo's maps as the network made them from its own few views. Else those of up to
    20 neighbours correct them in the end, which takes some tenths of a second a photo and makes
    depth and labels better where many photos see the same (own/ keeps the former)."""
    size: tuple[int, int] | None = None
    """Width and height at which the network sees the photos, multiples of 32; those it was trained
    with where they are not given. 480 384 gives tiny finer depth of photos as large, in 1.6 times
    the time, where cameras are right: from a renderer, or with --poses refined."""
    max_memory: float | None = None
    """GB (10^9 bytes) of RAM, on a GPU of its memory, to stay within: fewer encoded photos are then
    remembered, which takes longer and changes no result. An estimate from the shapes of all tensors
    in float32, not a guarantee: what libraries take for themselves is not in it, nor the 2 MB a
    photo in the end, when photos correct each other."""
    feature_cache: Path | None = None
    """Folder that keeps the features of SAM's encoder between runs, 2.1 MB a photo for base."""

    def run(self) -> None:
        from mvsam.encoders.sam import cache_frozen_features
        from mvsam.inference.photos import check_size

        check_size(self.size)  # before COLMAP seeks poses for minutes
        model = load_model(self.model, self.device)
        if self.feature_cache is not None:
            cache_frozen_features(model, self.feature_cache)
        scenes = open_scenes(
            self.scene,
            self.format,
            scale=self.scale,
            poses=self.poses,
            tuples=self.tuples,
            num_views=self.views,
            depth_range=self.depth_range,
        )
        failure = for_each_scene(
            scenes, lambda scene: self._predict(model, scene, is_one_of_many=len(scenes) > 1)
        )
        if failure is not None:
            raise failure

    def _predict(self, model: Model, scene: Scene, is_one_of_many: bool) -> None:
        out = self.out / scene.name if is_one_of_many else self.out
        given = Path(self.scene).resolve()
        if out.resolve() in (given, given / scene.name):
            raise InputError(f"--out {out} is the scene itself: choose another folder.")
        result = predict_with_bar(self, model, scene, out)
        print(f"{out}: {counted(len(result.written), 'photo')} predicted{_remark(result)}")
        if result.written and self.poses == "given" and len(result.tuples[0]) > 1:
            _hint_at_cameras(scene, result.tuples)


def _hint_at_cameras(scene: Scene, tuples: Sequence[ViewTuple]) -> None:
    """Says what would make depth better, after the maps, which nothing here can spoil."""
    from mvsam.data.check.features import camera_hint

    try:
        features = camera_hint(scene, tuples)
    except (InputError, OSError) as error:
        log.info("%s: whether its cameras fit was not asked: %s", scene.name, error)
        return
    if features is None:
        return
    if features.are_wrong:
        log.warning("%s: its features lie %s", scene.name, features.sentence)
    else:
        log.info("%s: its features lie %s Add another --out.", scene.name, features.sentence)


def predict_with_bar(arguments: Predict, model: Model, scene: Scene, out: Path) -> SceneResult:
    """`predict_scene` with a progress bar."""
    from mvsam.inference.scene import predict_scene

    with progress_bar() as progress:
        task = progress.add_task(f"predict {scene.name}", total=None)
        return predict_scene(
            model,
            scene,
            out,
            num_views=arguments.views,
            depth_range=arguments.depth_range,
            references=arguments.references or None,
            overwrite=arguments.overwrite,
            save_npz=arguments.save_npz,
            precision=arguments.precision,
            size=arguments.size,
            max_memory=_bytes(arguments.max_memory),
            fuse=not arguments.alone,
            arguments=json.loads(json.dumps(asdict(arguments), default=str)),
            on_photo=lambda done, total, _: progress.update(task, completed=done, total=total),
        )


def _bytes(gigabytes: float | None) -> int | None:
    if gigabytes is not None and not 0 < gigabytes < float("inf"):
        raise InputError(f"--max-memory {gigabytes:g}: give gigabytes, as 2.5.")
    return None if gigabytes is None else int(1e9 * gigabytes)


def _remark(result: SceneResult) -> str:
    kept = f", {len(result.kept)} done before" if result.kept else ""
    skipped = f", {len(result.skipped)} skipped" if result.skipped else ""
    return kept + skipped
