"""Curless and Levoy's fusion as they write it: one voxel, one depth map at a time."""

import numpy as np


def depth_at_place(depth, u, v, most_apart):
    """Bilinear in inverse depth between four known pixels that lie close together, else nearest."""
    height, width = depth.shape
    x, y = u - 0.5, v - 0.5  # the first pixel's centre is (0.5, 0.5)
    inverse, seen = 0.0, []
    for row in (int(np.floor(y)), int(np.floor(y)) + 1):
        for column in (int(np.floor(x)), int(np.floor(x)) + 1):
            value = depth[min(max(row, 0), height - 1), min(max(column, 0), width - 1)]
            seen.append(value)
            if value > 0:
                inverse += (1 - abs(y - row)) * (1 - abs(x - column)) / value
    if min(seen) > 0 and max(seen) - min(seen) <= most_apart:
        return 1 / inverse
    return depth[int(np.floor(v)), int(np.floor(u))]


def fused_distance(point, cameras, depths, weights, truncation):
    """Weighted mean of a world point's truncated signed distances, and the sum of the weights.

    Distances along the optical axis, in units of the truncation; None where nobody measured any.
    """
    total = total_weight = 0.0
    for camera, depth, weight in zip(cameras, depths, weights, strict=True):
        x, y, z = np.linalg.inv(camera.world_from_cam)[:3] @ [*point, 1.0]
        if z <= 0:
            continue
        u, v, _ = camera.intrinsics @ [x / z, y / z, 1.0]
        if not (0 <= v < depth.shape[0] and 0 <= u < depth.shape[1]):
            continue
        measured = depth_at_place(depth, u, v, truncation)
        signed = (measured - z) / truncation
        if measured == 0 or signed <= -1:
            continue
        here = weight[int(np.floor(v)), int(np.floor(u))]
        total += here * min(signed, 1.0)
        total_weight += here
    return (total / total_weight if total_weight else None), total_weight
