"""A folder of furniture meshes and textures, placed among the parametric things where it is given.

The folder holds `models.csv` and `textures.csv`, which list the files beside them. Meshes are in
metres with z up; `mount` says where the origin lies: `floor` the centre of the base, `wall` the
centre of the back at y = 0. A mesh's name begins with its class. Untextured parts have uv in metres
and a material name that says what they are made of.
"""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache
from pathlib import Path

import numpy as np

from mvsam.errors import InputError

from . import classes
from . import materials as m
from .dice import Dice
from .mesh import Soup
from .pictures import register
from .room import Piece

Row = dict[str, str]
_NAMES = {name.lower(): label for name, label in vars(classes).items() if name.isupper()}
LABELS = _NAMES | {"otherfurniture": classes.OTHER_FURNITURE, "ignore": classes.CLUTTER}
"""Class as the pack writes it -> label."""
_LARGEST_WALL_THING = 2.6
"""Metres; taller curtains do not fit most rooms."""


@dataclass(frozen=True)
class Assets:
    """A pack of models and textures; raises `InputError` where its lists are missing."""

    folder: Path

    def __post_init__(self):
        for name in ("models.csv", "textures.csv"):
            if not (self.folder / name).is_file():
                raise InputError(
                    f"{self.folder / name}: no such file; name the folder of an asset pack with "
                    "models.csv and textures.csv."
                )

    @cached_property
    def models(self) -> list[Row]:
        return _rows(self.folder / "models.csv")

    @cached_property
    def textures(self) -> list[Row]:
        return [row for row in _rows(self.folder / "textures.csv") if row["tileable"] == "yes"]

    def texture(self, dice: Dice, use: str, tint: m.Color | None = None) -> m.Material:
        """Some picture that suits a `floor`, `wall`, `ceiling`, `furniture` or `fabric`.

        tint: multiplies it; the pack's plaster and paper are nearly neutral.
        """
        row = dice.pick([row for row in self.textures if use in row["suitable_for"].split()])
        scale = float(row["metres"] or 1.0) * dice.uniform(0.75, 1.4)
        color = (1.0, 1.0, 1.0) if tint is None else tint
        gloss = dice.pick([0.0, 0.2, 0.6]) if use in ("floor", "furniture") else 0.0
        return m.Material("image", color, color, scale, gloss=gloss, image=self._path(row))

    def surfaces(
        self, dice: Dice, paint: m.Material, ground: m.Material
    ) -> tuple[m.Material, m.Material]:
        """(wall, floor): pictures from the pack in about half the rooms, else the given ones."""
        if dice.chance(0.35):
            tint = paint.color if dice.chance(0.6) else None
            paint = self.texture(dice, "wall", tint)
        if dice.chance(0.5):
            ground = self.texture(dice, "floor")
        return paint, ground

    def thing(self, dice: Dice, mount: str, kind: str) -> tuple[Piece, float] | None:
        """(a model for this kind of room, the usual height of its origin); None if there is none.

        Its back is at y = 0, its front towards +y.
        """
        rows = [
            row
            for row in self.models
            if row["mount"] == mount
            and {kind, "any"} & {*row["rooms"].split()}
            and float(row["size_z"]) < _LARGEST_WALL_THING
            and row["class"] not in ("window", "door", "wall", "floor")
        ]
        if not rows:
            return None
        row = dice.pick(rows)
        piece = _piece(dice, self._path(row), dice.uniform(0.92, 1.08))
        return piece, float(row["typical_z"] or 0.0)

    def _path(self, row: Row) -> str:
        return str(self.folder / row["file"])


@cache
def open_assets(folder: str) -> Assets:
    """The pack of a folder, its lists read once."""
    return Assets(Path(folder))


def _rows(file: Path) -> list[Row]:
    with file.open(encoding="utf-8", newline="") as lines:
        return list(csv.DictReader(lines))


def _piece(dice: Dice, file: str, stretch: float) -> Piece:
    """A model with its back at y = 0, one material for each of its materials' names."""
    piece, chosen = Piece(), {}
    for soup, label, material in _model(file):
        if material.image == "" and material.pattern not in chosen:
            chosen[material.pattern] = _made_of(dice, material.pattern, material.color)
        made = material if material.image else chosen[material.pattern]
        piece.add(label, made, replace(soup, corners=soup.corners * stretch))
    back = float(piece.bounds()[0, 1])
    return Piece().place(piece, 0.0, 0.0, -back, 0.0)


def _made_of(dice: Dice, name: str, color: m.Color) -> m.Material:
    """What an untextured part is made of, by the name that the pack gives its material."""
    word = name.lower()
    if word.startswith("wood"):
        return m.board(dice) if dice.chance(0.3) else m.wood(dice)
    if word.startswith("metal"):
        return m.metal(dice)
    if word == "carpetwhite":
        return m.ceramic(dice)
    if word.startswith("carpet") or word == "fur":
        return m.fabric(dice)
    if word == "glass":
        return m.plain(m.srgb(120, 135, 140), 1.5)
    return m.plain(color if word != "_defaultmat" else m.WHITE, dice.uniform(0, 0.4))


@lru_cache(maxsize=64)
def _model(file: str) -> Sequence[tuple[Soup, int, m.Material]]:
    """Triangles, label and material of each mesh; an untextured material's pattern is its name."""
    import trimesh

    parts = []
    for name, mesh in trimesh.load_scene(file).geometry.items():
        faces, visual = mesh.faces, mesh.visual
        corners = np.asarray(mesh.vertices[faces], dtype=np.float64)
        normals = np.asarray(mesh.vertex_normals[faces], dtype=np.float64)
        uv = np.asarray(visual.uv[faces], dtype=np.float64)
        base = visual.material
        factor = [255, 255, 255] if base.baseColorFactor is None else base.baseColorFactor
        color = m.srgb(*[int(v) for v in factor[:3]])
        label = LABELS[name.rsplit(".", 1)[0]]
        if base.baseColorTexture is None:
            material = m.Material(str(base.name), color, color)
        else:
            key = f"{file}#{name}"
            register(key, np.array(base.baseColorTexture.convert("RGB")))
            material = m.Material("image", (1.0, 1.0, 1.0), color, image=key)
        parts.append((Soup(corners, normals, uv), label, material))
    return parts
