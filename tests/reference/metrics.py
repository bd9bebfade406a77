"""Slow twins of the scores: one pixel after the other, Python floats."""

import math

import numpy as np


def depth_scores(images: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> dict[str, float]:
    """Scores of (predicted, truth, valid) maps, each the mean over images with a valid pixel."""
    per_image = []
    all_squares = []
    for predicted, truth, valid in images:
        absolute, relative, squares, ratios = [], [], [], []
        for p, t, v in zip(predicted.flat, truth.flat, valid.flat, strict=True):
            if not v:
                continue
            p, t = float(p), float(t)
            absolute.append(abs(p - t))
            relative.append(abs(p - t) / t)
            squares.append((p - t) ** 2)
            ratios.append(math.inf if p <= 0 else max(p / t, t / p))
        if not absolute:
            continue
        count = len(absolute)
        all_squares += squares
        scores = {
            "abs": sum(absolute) / count,
            "rel": sum(relative) / count,
            "rmse": math.sqrt(sum(squares) / count),
        }
        for threshold in (1.03, 1.05, 1.25):
            scores[f"delta_{threshold}"] = sum(r < threshold for r in ratios) / count
        per_image.append(scores)
    means = {key: sum(s[key] for s in per_image) / len(per_image) for key in per_image[0]}
    return means | {"rmse_pooled": math.sqrt(sum(all_squares) / len(all_squares))}


def iou_of_class(predicted: np.ndarray, truth: np.ndarray, wanted: int) -> float | None:
    """TP / (TP + FP + FN) over pixels whose truth is not 255; None if the class is nowhere."""
    hits = false_alarms = misses = 0
    for p, t in zip(predicted.flat, truth.flat, strict=True):
        if t == 255:
            continue
        hits += p == wanted and t == wanted
        false_alarms += p == wanted and t != wanted
        misses += p != wanted and t == wanted
    union = hits + false_alarms + misses
    return hits / union if union else None


def ause(predicted: np.ndarray, confidence: np.ndarray, truth: np.ndarray) -> float:
    """Area between the mean Rel of the k most confident and of the k best pixels, k = 1 .. all."""
    pixels = [
        (abs(float(p) - float(t)) / float(t), float(c))
        for p, c, t in zip(predicted.flat, confidence.flat, truth.flat, strict=True)
    ]
    by_confidence = [error for error, _ in sorted(pixels, key=lambda pixel: -pixel[1])]
    by_error = sorted(error for error, _ in pixels)
    gaps = [sum(by_confidence[:k]) / k - sum(by_error[:k]) / k for k in range(1, len(pixels) + 1)]
    return sum(gaps) / len(gaps)
