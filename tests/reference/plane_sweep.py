"""Eq. 1, 2 and 3 as the paper writes them: one pixel, one plane, one view at a time."""

import numpy as np


def project(pixel, depth, intrinsics, world_from_cam, source, reference=0):
    """Eq. 1: (u', v') in the source and the depth there, of a reference pixel (u, v) at a depth.

    By way of the world: out of the reference camera, then into the source camera.
    """
    ray = np.linalg.inv(intrinsics[reference]) @ [pixel[0], pixel[1], 1.0]
    pose = world_from_cam[reference]
    world_point = pose[:3, :3] @ (depth * ray) + pose[:3, 3]
    pose = world_from_cam[source]
    source_point = pose[:3, :3].T @ (world_point - pose[:3, 3])
    image_point = intrinsics[source] @ source_point
    return image_point[:2] / image_point[2], source_point[2]


def read_bilinear(image, u, v):
    """All channels of `image` (channel, row, column) at pixel (u, v); nothing lies outside it."""
    _, height, width = image.shape
    x, y = u - 0.5, v - 0.5  # the first pixel's centre is (0.5, 0.5)
    value = np.zeros(len(image))
    for row in (int(np.floor(y)), int(np.floor(y)) + 1):
        for column in (int(np.floor(x)), int(np.floor(x)) + 1):
            if 0 <= row < height and 0 <= column < width:
                value += (1 - abs(y - row)) * (1 - abs(x - column)) * image[:, row, column]
    return value


def warped_volume(features, intrinsics, world_from_cam, hypotheses, source):
    """V_i: the source's features (channel, row, column) at every hypothesis of the reference."""
    planes, height, width = hypotheses.shape
    volume = np.zeros((features.shape[1], planes, height, width))
    for plane in range(planes):
        for row in range(height):
            for column in range(width):
                (u, v), z = project(
                    (column + 0.5, row + 0.5),
                    hypotheses[plane, row, column],
                    intrinsics,
                    world_from_cam,
                    source,
                )
                if z > 1e-6:
                    volume[:, plane, row, column] = read_bilinear(features[source], u, v)
    return volume


def variance_volume(features, intrinsics, world_from_cam, hypotheses):
    """Eq. 2: features (view, channel, row, column) to (channel, plane, row, column)."""
    num_planes = len(hypotheses)
    volumes = [np.repeat(features[0][:, None], num_planes, axis=1)]
    for source in range(1, len(features)):
        volumes.append(warped_volume(features, intrinsics, world_from_cam, hypotheses, source))
    mean = sum(volumes) / len(volumes)
    return sum((volume - mean) ** 2 for volume in volumes) / len(volumes)


def expected_depth(scores, hypotheses):
    """Eq. 3: softmax over the planes (first axis), then the expectation of depth."""
    _, height, width = scores.shape
    depth = np.zeros((height, width))
    for row in range(height):
        for column in range(width):
            weights = np.exp(scores[:, row, column] - scores[:, row, column].max())
            weights /= weights.sum()
            depth[row, column] = sum(weights * hypotheses[:, row, column])
    return depth


def four_plane_mass(probability):
    """Probability of the plane below the expected index, the plane there and the two above."""
    planes, height, width = probability.shape
    mass = np.zeros((height, width))
    for row in range(height):
        for column in range(width):
            share = probability[:, row, column]
            centre = int(np.floor(sum(share * np.arange(planes))))
            around = [i for i in range(centre - 1, centre + 3) if 0 <= i < planes]
            mass[row, column] = sum(share[i] for i in around)
    return mass
