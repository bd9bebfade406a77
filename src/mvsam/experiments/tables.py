"""Tables 1 to 6 of the paper: rows in its order, with what it published."""

from dataclasses import dataclass

METRICS = ("abs", "rel", "rmse", "miou")
"""Names in `mvsam eval --json`; metres and fractions, which tables show as cm and percent."""


@dataclass(frozen=True)
class TableRow:
    """One line of a table."""

    method: str
    """As the paper calls it."""
    run: str
    """Row of `experiments/rows.py`."""
    views: int
    modality: str
    published: dict[str, float]
    """By metric of the table, metres and fractions of 1."""


@dataclass(frozen=True)
class Table:
    """A table of figures."""

    number: int
    title: str
    metrics: tuple[str, ...]
    rows: tuple[TableRow, ...]
    note: str = ""
    """What a reader must know to compare."""


@dataclass(frozen=True)
class Method:
    """What the paper says of a method, in whichever of its tables."""

    views: int
    """How many it looks at."""
    modality: str
    published: dict[str, float]
    """By metric, metres and fractions of 1."""


def _method(views: int = 1, modality: str = "RGB", **printed: float) -> Method:
    """`printed`: as in the paper, cm and percent."""
    published = {name: round(value / 100, 6) for name, value in printed.items()}
    return Method(views, modality, published)


METHODS = {
    "mvs2d": _method(3, abs=10.8, rel=5.9),
    "trans_mvsnet": _method(3, abs=13.2, rel=8.3),
    "cas_mvsnet": _method(3, abs=10.0, rel=6.0),
    "mvs_unet": _method(3, abs=9.5, rel=5.8),
    "mvs_sam": _method(3, abs=9.3, rel=5.5),
    "base": _method(3, abs=9.0, rel=5.6, rmse=14.9, miou=62.5),
    "base_5_views": _method(5, abs=8.3, rel=5.2),
    "base_official": _method(5, miou=62.1),
    "base_no_bridge": _method(3, abs=10.0, rel=6.1, miou=60.0),
    "mt_refinenet": _method(miou=42.0, abs=32.4, rel=21.7, rmse=44.3),
    "pad_net": _method(miou=42.2, abs=26.9, rel=17.4, rmse=37.8),
    "mti_net": _method(miou=53.7, abs=22.4, rel=14.0, rmse=32.2),
    "mtan": _method(miou=56.1, abs=22.7, rel=14.6, rmse=32.6),
    "segnet": _method(miou=27.5),
    "deeplab_v2": _method(miou=43.9),
    "deeplab_v3": _method(miou=50.1),
    "adapnet_pp": _method(miou=53.0),
    "fusenet": _method(modality="RGB-D", miou=63.8),
    "emsaformer": _method(modality="RGB-D", miou=63.8),
    "ssma": _method(modality="RGB-D", miou=67.4),
    "unet_r34": _method(miou=50.9),
    "unet_r50": _method(miou=34.5),
    "sam_conv": _method(miou=27.2),
    "sam_frozen": _method(miou=47.2),
    "sam_tuned": _method(miou=59.0),
    "sam_frozen_gt_depth": _method(modality="RGB-D", miou=52.4),
    "sam_tuned_gt_depth": _method(modality="RGB-D", miou=63.4),
}
"""By row of `experiments/rows.py`. Each figure stands here once, though tables share methods."""


def _table(
    number: int,
    title: str,
    metrics: tuple[str, ...],
    rows: tuple[tuple[str, str], ...],
    note: str = "",
) -> Table:
    """rows: the method as this table calls it, and its key in `METHODS`."""
    return Table(number, title, metrics, tuple(_row(*row, metrics) for row in rows), note)


def _row(label: str, run: str, metrics: tuple[str, ...]) -> TableRow:
    method = METHODS[run]
    published = {name: value for name, value in method.published.items() if name in metrics}
    return TableRow(label, run, method.views, method.modality, published)


_TABLES = (
    _table(
        1,
        "Multi-view depth estimation",
        ("abs", "rel"),
        (
            ("MVS2D", "mvs2d"),
            ("TransMVSNet", "trans_mvsnet"),
            ("CasMVSNet", "cas_mvsnet"),
            ("Ours, MVS + UNet feat", "mvs_unet"),
            ("Ours, MVS + SAM feat", "mvs_sam"),
            ("Ours, full", "base"),
            ("Ours, full", "base_5_views"),
        ),
        "The figures published for MVS2D are those of its authors, under their own protocol, "
        "`mvsam eval --protocol mvs2d`, at 640x480.",
    ),
    _table(
        2,
        "Monocular multi-task methods",
        ("miou", "abs", "rel", "rmse"),
        (
            ("MT RefineNet", "mt_refinenet"),
            ("PAD Net", "pad_net"),
            ("MTI Net", "mti_net"),
            ("MTAN", "mtan"),
            ("Ours, 3 views", "base"),
        ),
    ),
    _table(
        3,
        "2D semantic segmentation",
        ("miou",),
        (
            ("SegNet", "segnet"),
            ("DeepLab v2", "deeplab_v2"),
            ("DeepLab v3", "deeplab_v3"),
            ("AdapNet++", "adapnet_pp"),
            ("FuseNet", "fusenet"),
            ("EMSAFormer", "emsaformer"),
            ("SSMA", "ssma"),
            ("Ours", "base_official"),
        ),
        "Published on ScanNet's official validation split. What the paper gives for the others "
        "looks quoted, not trained again: their own sizes, weights and augmentation, which the "
        "measured figures do not share.",
    ),
    _table(
        4,
        "2D semantic segmentation ablations",
        ("miou",),
        (
            ("UNet (ResNet-34)", "unet_r34"),
            ("UNet (ResNet-50)", "unet_r50"),
            ("SAM (frozen) + conv decoder", "sam_conv"),
            ("SAM (frozen) + our decoder", "sam_frozen"),
            ("SAM (tuned) + our decoder", "sam_tuned"),
            ("Our full model", "base"),
            ("SAM (frozen) + our dec. (GT depth)", "sam_frozen_gt_depth"),
            ("SAM (tuned) + our dec. (GT depth)", "sam_tuned_gt_depth"),
        ),
    ),
    _table(
        5,
        "Model ablations",
        ("abs", "rel", "miou"),
        (
            ("CasMVSNet", "cas_mvsnet"),
            ("MVS + SAM features", "mvs_sam"),
            ("Semantic SAM (frozen)", "sam_frozen"),
            ("Semantic SAM (tuned)", "sam_tuned"),
            ("Ours, no SAM->MVS", "base_no_bridge"),
            ("Ours, full", "base"),
        ),
    ),
)
TABLES = {table.number: table for table in _TABLES}

PICTURE_ROWS = (("MTAN", "mtan"), ("CasMVSNet", "cas_mvsnet"), ("Ours", "base"))
"""Methods of Table 6, whose cells are depth maps, and their rows of `experiments/rows.py`."""

PICTURE_SCENES = ("scene0076_00", "scene0390_00", "scene0449_00") + 3 * ("scene0465_00",)
"""Columns of Table 6 on ScanNet, all of MVS2D's test scenes; the paper does not name the frames."""


def runs_of(number: int) -> list[str]:
    """Rows of `experiments/rows.py` that a table shows, each once, in its order."""
    if number in TABLES:
        return [row.run for row in TABLES[number].rows]
    return [run for _, run in PICTURE_ROWS]
