"""Label numbers of the 20 ScanNet classes in benchmark order, by the names the rooms use."""

(
    WALL, FLOOR, CABINET, BED, CHAIR, SOFA, TABLE, DOOR, WINDOW, BOOKSHELF, PICTURE, COUNTER,
    DESK, CURTAIN, REFRIGERATOR, SHOWER_CURTAIN, TOILET, SINK, BATHTUB, OTHER_FURNITURE,
) = range(20)  # fmt: skip

CLUTTER = 255
"""What belongs to none of the 20 classes, the ceiling included."""
