"""Every row of Tables 1 to 5 as a run, under two budgets: the paper's on ScanNet, ours on rooms.

A row is one method of the paper. `scannet` trains it as the paper says, at the paper's size.
`rooms` trains all rows on the same procedural rooms at 160x128, those with SAM or a cascade in the
sizes of `tiny`; the rows that the paper's claims rest on on 4,800 pictures, the others on a
sixteenth of that, which says that they run and no more.
"""

from dataclasses import dataclass, replace
from typing import Literal

from mvsam.data.streaming.config import DataConfig
from mvsam.experiments import recipes
from mvsam.experiments.config import Experiment, ModelConfig
from mvsam.experiments.recipes import Recipe
from mvsam.training.module import TrainConfig

Budget = Literal["rooms", "scannet"]

TRIPLETS = 86_324
"""Training samples of the paper's split of ScanNet, which is MVS2D's."""
OFFICIAL_IMAGES = 19_466
"""Of the official split, whose 2D benchmark takes every hundredth frame (scannet_frames_25k)."""


@dataclass(frozen=True)
class Row:
    """A method of the tables and what it is trained as under each budget."""

    name: str
    recipe: Recipe
    scannet: ModelConfig
    rooms: ModelConfig
    views: int = 1
    """How many it looks at."""
    seeds: int = 1
    """Under `rooms`: three where a claim of the paper rests on a small difference of the row."""
    is_long: bool = False
    """Under `rooms`: trained on as many pictures as all that are compared."""
    official_split: bool = False
    """On ScanNet: the benchmark's split (Table 3), not MVS2D's."""
    after: str | None = None
    """The row whose weights it begins with."""

    def data_of(self, data: DataConfig) -> DataConfig:
        """These data as the row sees them: its number of views, its recipe's augmentation."""
        return replace(
            data,
            num_views=self.views,
            mirror=self.recipe.mirror,
            color_jitter=self.recipe.color_jitter,
        )

    @property
    def scored_views(self) -> int:
        """Photos of a tuple when it is scored; methods of one picture look at the first."""
        return max(3, self.views)


@dataclass(frozen=True)
class RowRun:
    """One row under one budget: what is trained, for which seeds, and what it is scored on."""

    row: Row
    experiment: Experiment
    seeds: tuple[int, ...]
    scored_on: str
    protocol: str
    views: int
    """`Row.scored_views`."""
    enough: int
    """Pictures it must have been trained on to carry a claim."""


_SAM = "sam_vit_b_01ec64.pth"
_ENCODER = "rows_encoder"
"""In the place of SAM's weights under `rooms`: the semantic encoder that `tiny` had at 231a0ad (its
hash was 2754a3b7). It comes with the package and stays as it is while `tiny` learns on, so that
rows of different days compare."""


def _ready_made(name: str, recipe: Recipe, *, has_imagenet: bool = True, **settings) -> Row:
    """A method that is the same network under both budgets."""
    imagenet = "download" if has_imagenet else None
    return Row(name, recipe, ModelConfig(name, imagenet=imagenet), ModelConfig(name), **settings)


def _with_sam(name: str, model: str, tiny: str, tuned_blocks: int, **settings) -> Row:
    """SAM's ViT-B with its weights, or `tiny`'s with `_ENCODER`."""
    return Row(
        name,
        recipes.PAPER,
        ModelConfig(model, tuned_blocks=tuned_blocks, sam_checkpoint=_SAM),
        ModelConfig(tiny, tuned_blocks=tuned_blocks, semantic_encoder=_ENCODER),
        is_long=True,
        **settings,
    )


_ROWS = (
    _ready_made("mvs2d", recipes.MVS2D, views=3),
    _ready_made("trans_mvsnet", recipes.TRANS_MVSNET, has_imagenet=False, views=3),
    Row(
        "cas_mvsnet",
        recipes.PAPER,
        ModelConfig("cas_mvsnet"),
        ModelConfig("tiny_cas_mvsnet"),
        views=3,
        seeds=3,
        is_long=True,
    ),
    _ready_made("unet_r34", recipes.UNET, is_long=True),
    Row(
        "mvs_unet",
        recipes.PAPER,
        ModelConfig("mvs_unet", init=("runs/unet_r34_scannet-0/model.safetensors",)),
        ModelConfig("tiny_mvs_unet", init=("runs/unet_r34_rooms-0/model.safetensors",)),
        views=3,
        seeds=3,
        is_long=True,
        after="unet_r34",
    ),
    _with_sam("mvs_sam", "mvs_sam", "tiny_mvs_sam", 0, views=3, seeds=3),
    _with_sam("base", "base", "tiny_base", 3, views=3, seeds=3),
    _with_sam("base_5_views", "base", "tiny_base", 3, views=5, seeds=3),
    _ready_made("mt_refinenet", recipes.MT_REFINENET),
    _ready_made("pad_net", recipes.MULTI_TASK),
    _ready_made("mti_net", recipes.MULTI_TASK),
    _ready_made("mtan", recipes.MULTI_TASK, seeds=3, is_long=True),
    _ready_made("segnet", recipes.SEGNET, official_split=True),
    _ready_made("deeplab_v2", recipes.DEEPLAB_V2, official_split=True),
    _ready_made("deeplab_v3", recipes.DEEPLAB_V3, official_split=True),
    _ready_made("adapnet_pp", recipes.ADAPNET_PP, has_imagenet=False, official_split=True),
    _ready_made("fusenet", recipes.FUSENET, official_split=True),
    _ready_made("emsaformer", recipes.EMSAFORMER, has_imagenet=False, official_split=True),
    _ready_made("ssma", recipes.ADAPNET_PP, has_imagenet=False, official_split=True),
    _with_sam("base_official", "base", "tiny_base", 3, views=5, official_split=True),
    _ready_made("unet_r50", recipes.UNET),
    _with_sam("sam_conv", "sam_conv", "tiny_sam_conv", 0, seeds=3),
    _with_sam("sam_frozen", "sam_semantic", "tiny_sam_semantic", 0, seeds=3),
    _with_sam("sam_tuned", "sam_semantic", "tiny_sam_semantic", 3, seeds=3),
    _with_sam("sam_frozen_gt_depth", "sam_semantic_gt_depth", "tiny_semantic_gt_depth", 0),
    _with_sam("sam_tuned_gt_depth", "sam_semantic_gt_depth", "tiny_semantic_gt_depth", 3, seeds=3),
    _with_sam("base_no_bridge", "base_no_bridge", "tiny_no_bridge", 3, views=3, seeds=3),
)

_ROOMS_DATA = DataConfig(train="rooms:train:10000-10800", size=(160, 128), cache="cache/rooms")
"""Five frames a room. SAM sees the same small pictures as all others, enlarged."""
_LONG, _SHORT = 400, 25
_ROOMS_A_STEP = 12
"""With one reference each, whether a row sees one view of a room or several. Four rooms with three
references are cheaper and teach less: docs/claims.md."""


def rooms_runs(class_weights: tuple[float, ...]) -> dict[str, RowRun]:
    """By row. Rare classes weigh more in every row that has classes: their rarity is the data's."""
    runs = {row.name: _rooms_run(row, class_weights) for row in _ROWS}
    return runs | {"base_official": runs["base_5_views"]}  # rooms have one split


def _rooms_run(row: Row, class_weights: tuple[float, ...]) -> RowRun:
    recipe = row.recipe.with_class_weights(class_weights)
    steps = _LONG if row.is_long else _SHORT
    experiment = Experiment(
        name=f"{row.name}_rooms",
        about=f"Row `{row.name}` of the tables on procedural rooms; `mvsam table` has its scores.",
        model=row.rooms,
        data=row.data_of(_ROOMS_DATA),
        loss=recipe.loss,
        optimizer=replace(recipe.optimizer, steps=steps),
        train=TrainConfig(batch_size=_ROOMS_A_STEP, val_every=steps, checkpoint_every=25),
    )
    return RowRun(
        row,
        experiment,
        seeds=tuple(range(row.seeds)),
        scored_on="rooms:test:0-60",
        protocol="half",
        views=row.scored_views,
        enough=_LONG * _ROOMS_A_STEP,
    )


def scannet_runs() -> dict[str, RowRun]:
    """By row, with one seed as in the paper. None was run here: they need ScanNet."""
    return {row.name: _scannet_run(row) for row in _ROWS}


def _scannet_run(row: Row) -> RowRun:
    recipe = row.recipe
    folder = "scannet_official" if row.official_split else "scannet"
    samples = OFFICIAL_IMAGES if row.official_split else TRIPLETS
    steps = samples * recipe.epochs // recipe.batch_size
    experiment = Experiment(
        name=f"{row.name}_scannet",
        about=f"Row `{row.name}` of the tables with its published settings; needs ScanNet. Not run "
        "here.",
        model=row.scannet,
        data=row.data_of(
            DataConfig(train=f"{folder}/train", val=f"{folder}/val", cache="cache", workers=4)
        ),
        loss=recipe.loss,
        optimizer=replace(recipe.optimizer, steps=steps),
        train=TrainConfig(batch_size=recipe.batch_size),
    )
    return RowRun(
        row,
        experiment,
        seeds=(0,),
        scored_on=f"{folder}/val",
        protocol="paper",
        views=row.scored_views,
        enough=steps * recipe.batch_size,
    )


def pictures_of(experiment: Experiment, steps: int) -> int:
    """How many references with their truth such a run learns from in so many steps."""
    return steps * experiment.train.batch_size * experiment.data.references
