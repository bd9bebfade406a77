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
    """By metric."""


@dataclass(frozen=True)
class Table:
    """A table of figures."""

    number: int
    title: str
    metrics: tuple[str, ...]
    rows: tuple[TableRow, ...]
    note: str = ""
    """What a reader must know to compare."""


def _row(
    method: str, run: str, views: int = 1, modality: str = "RGB", **printed: float
) -> TableRow:
    """`printed`: as in the paper, cm and percent."""
    published = {name: round(value / 100, 6) for name, value in printed.items()}
    return TableRow(method, run, views, modality, published)


_DEPTH_TABLE = Table(
    1,
    "Multi-view depth estimation",
    ("abs", "rel"),
    (
        _row("MVS2D", "mvs2d", 3, abs=10.8, rel=5.9),
        _row("TransMVSNet", "trans_mvsnet", 3, abs=13.2, rel=8.3),
        _row("CasMVSNet", "cas_mvsnet", 3, abs=10.0, rel=6.0),
        _row("Ours, MVS + UNet feat", "mvs_unet", 3, abs=9.5, rel=5.8),
        _row("Ours, MVS + SAM feat", "mvs_sam", 3, abs=9.3, rel=5.5),
        _row("Ours, full", "base", 3, abs=9.0, rel=5.6),
        _row("Ours, full", "base_5_views", 5, abs=8.3, rel=5.2),
    ),
    "The figures published for MVS2D are those of its authors, under their own protocol.",
)
_MULTI_TASK_TABLE = Table(
    2,
    "Monocular multi-task methods",
    ("miou", "abs", "rel", "rmse"),
    (
        _row("MT RefineNet", "mt_refinenet", miou=42.0, abs=32.4, rel=21.7, rmse=44.3),
        _row("PAD Net", "pad_net", miou=42.2, abs=26.9, rel=17.4, rmse=37.8),
        _row("MTI Net", "mti_net", miou=53.7, abs=22.4, rel=14.0, rmse=32.2),
        _row("MTAN", "mtan", miou=56.1, abs=22.7, rel=14.6, rmse=32.6),
        _row("Ours, 3 views", "base", 3, miou=62.5, abs=9.0, rel=5.6, rmse=14.9),
    ),
)
_SEGMENTATION_TABLE = Table(
    3,
    "2D semantic segmentation",
    ("miou",),
    (
        _row("SegNet", "segnet", miou=27.5),
        _row("DeepLab v2", "deeplab_v2", miou=43.9),
        _row("DeepLab v3", "deeplab_v3", miou=50.1),
        _row("AdapNet++", "adapnet_pp", miou=53.0),
        _row("FuseNet", "fusenet", modality="RGB-D", miou=63.8),
        _row("EMSAFormer", "emsaformer", modality="RGB-D", miou=63.8),
        _row("SSMA", "ssma", modality="RGB-D", miou=67.4),
        _row("Ours", "base_official", 5, miou=62.1),
    ),
    "Published on ScanNet's official validation split. What the paper gives for the others looks "
    "quoted, not trained again: their own sizes, weights and augmentation, which the measured "
    "figures do not share.",
)
_ABLATION_TABLE = Table(
    4,
    "2D semantic segmentation ablations",
    ("miou",),
    (
        _row("UNet (ResNet-34)", "unet_r34", miou=50.9),
        _row("UNet (ResNet-50)", "unet_r50", miou=34.5),
        _row("SAM (frozen) + conv decoder", "sam_conv", miou=27.2),
        _row("SAM (frozen) + our decoder", "sam_frozen", miou=47.2),
        _row("SAM (tuned) + our decoder", "sam_tuned", miou=59.0),
        _row("Our full model", "base", 3, miou=62.5),
        _row(
            "SAM (frozen) + our dec. (GT depth)", "sam_frozen_gt_depth", modality="RGB-D", miou=52.4
        ),
        _row(
            "SAM (tuned) + our dec. (GT depth)", "sam_tuned_gt_depth", modality="RGB-D", miou=63.4
        ),
    ),
)
_PARTS_TABLE = Table(
    5,
    "Model ablations",
    ("abs", "rel", "miou"),
    (
        _row("CasMVSNet", "cas_mvsnet", 3, abs=10.0, rel=6.0),
        _row("MVS + SAM features", "mvs_sam", 3, abs=9.3, rel=5.5),
        _row("Semantic SAM (frozen)", "sam_frozen", miou=47.2),
        _row("Semantic SAM (tuned)", "sam_tuned", miou=59.0),
        _row("Ours, no SAM->MVS", "base_no_bridge", 3, abs=10.0, rel=6.1, miou=60.0),
        _row("Ours, full", "base", 3, abs=9.0, rel=5.6, miou=62.5),
    ),
)
TABLES = {
    table.number: table
    for table in (
        _DEPTH_TABLE,
        _MULTI_TASK_TABLE,
        _SEGMENTATION_TABLE,
        _ABLATION_TABLE,
        _PARTS_TABLE,
    )
}

PICTURE_ROWS = (("MTAN", "mtan"), ("CasMVSNet", "cas_mvsnet"), ("Ours", "base"))
"""Methods of Table 6, whose cells are depth maps, and their rows of `experiments/rows.py`."""

PICTURE_SCENES = ("scene0076_00", "scene0390_00", "scene0449_00") + 3 * ("scene0465_00",)
"""Columns of Table 6 on ScanNet, all of MVS2D's test scenes; the paper does not name the frames."""


def runs_of(number: int) -> list[str]:
    """Rows of `experiments/rows.py` that a table shows, each once, in its order."""
    if number in TABLES:
        return [row.run for row in TABLES[number].rows]
    return [run for _, run in PICTURE_ROWS]
