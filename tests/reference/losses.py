"""The losses of Eq. 4, one pixel at a time."""

import math


def smooth_l1(error, beta):
    """Square below beta, straight above, both value and slope continuous."""
    if abs(error) < beta:
        return 0.5 * error * error / beta
    return abs(error) - 0.5 * beta


def stage_depth_loss(predicted, target, near, far, beta):
    """Mean over the pixels whose true depth lies in [near, far]; 0 where there are none."""
    errors = []
    for row in range(len(target)):
        for column in range(len(target[0])):
            if near <= target[row][column] <= far and target[row][column] > 0:
                errors.append(smooth_l1(predicted[row][column] - target[row][column], beta))
    return sum(errors) / len(errors) if errors else 0.0


def cross_entropy(logits, labels, ignore):
    """Mean over labelled pixels of -log softmax; logits are [class][row][column]."""
    errors = []
    for row in range(len(labels)):
        for column in range(len(labels[0])):
            if labels[row][column] != ignore:
                scores = [plane[row][column] for plane in logits]
                total = math.log(sum(math.exp(s) for s in scores))
                errors.append(total - scores[labels[row][column]])
    return sum(errors) / len(errors) if errors else 0.0
