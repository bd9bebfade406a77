"""Slow twins of the resizing functions: plain loops over the definition."""

import numpy as np


def area_average(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Each new pixel is the mean of the rectangle it covers, [height, width, channel], float64."""
    height, width = image.shape[:2]
    result = np.zeros((size[1], size[0], image.shape[2]))
    for row in range(size[1]):
        for column in range(size[0]):
            top, bottom = row * height / size[1], (row + 1) * height / size[1]
            left, right = column * width / size[0], (column + 1) * width / size[0]
            total = 0.0
            for y in range(height):
                for x in range(width):
                    covered_y = max(0.0, min(bottom, y + 1) - max(top, y))
                    covered_x = max(0.0, min(right, x + 1) - max(left, x))
                    weight = covered_y * covered_x
                    result[row, column] += weight * image[y, x]
                    total += weight
            result[row, column] /= total
    return result


def nearest(values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Each new pixel takes the old pixel whose centre is nearest, the last at a tie."""
    height, width = values.shape
    result = np.zeros((size[1], size[0]), values.dtype)
    for row in range(size[1]):
        for column in range(size[0]):
            y, x = (row + 0.5) * height / size[1], (column + 0.5) * width / size[0]
            nearest_row = min(reversed(range(height)), key=lambda r: abs(r + 0.5 - y))
            nearest_column = min(reversed(range(width)), key=lambda c: abs(c + 0.5 - x))
            result[row, column] = values[nearest_row, nearest_column]
    return result
