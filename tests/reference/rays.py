"""Ray casting by trying every triangle, float64."""

import numpy as np


def first_hit(
    triangles: np.ndarray, origin: np.ndarray, direction: np.ndarray
) -> tuple[int, float]:
    """Number of the first triangle the ray meets (-1: none) and the distance in ray lengths."""
    best, best_distance = -1, np.inf
    for number, (a, b, c) in enumerate(triangles.astype(np.float64)):
        # origin + t direction = a + u (b - a) + v (c - a)
        system = np.column_stack([-direction, b - a, c - a])
        if abs(np.linalg.det(system)) < 1e-14:
            continue
        t, u, v = np.linalg.solve(system, origin - a)
        if u >= 0 and v >= 0 and u + v <= 1 and 1e-9 < t < best_distance:
            best, best_distance = number, t
    return best, float(best_distance)
