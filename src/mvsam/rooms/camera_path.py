"""A hand-held camera that looks about in a room, or walks around one thing in it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .classes import CABINET, CLUTTER, CURTAIN, DOOR, FLOOR, PICTURE, WINDOW
from .dice import Dice, Number
from .mesh import rotation_about
from .render import Camera
from .room import Room

WALL_THINGS = (DOOR, WINDOW, PICTURE, CURTAIN, CABINET)
_ATTEMPTS = 1500
CLEARANCE = 0.4
"""No surface comes closer to the camera, metres."""


_FRAMES = (
    (0.5, 640, 480, 0.74, 1.08),
    (0.12, 640, 360, 0.68, 0.98),
    (0.08, 640, 360, 0.8, 0.84),
    (0.1, 600, 400, 0.62, 0.95),
    (0.13, 480, 640, 0.7, 1.0),
    (0.07, 360, 640, 0.72, 0.95),
)
"""Share, width, height, and the focal length from .. to in longer sides: colour cameras of depth
sensors (ICL-NUIM .75, Kinect .82, ScanNet .9), phones' films, HoloLens, cameras, phones upright."""


def intrinsics(dice: Dice, width: int, height: int) -> Float[np.ndarray, "3 3"]:
    """The whole frame of some usual camera, squeezed to the wanted size as photos are."""
    chosen = dice.weighted([share for share, *_ in _FRAMES])
    _, native_width, native_height, shortest, longest = _FRAMES[chosen]
    focal = max(native_width, native_height) * dice.uniform(shortest, longest)
    squeeze_x, squeeze_y = width / native_width, height / native_height
    centre_x, centre_y = (0.5 + dice.uniform(-0.012, 0.012) for _ in range(2))
    return np.array(
        [
            [focal * squeeze_x, 0, centre_x * width],
            [0, focal * squeeze_y, centre_y * height],
            [0, 0, 1],
        ]
    )


def pose_from_angles(
    position: np.ndarray, yaw_deg: Number, pitch_deg: Number, roll_deg: Number
) -> np.ndarray:
    """world_from_cam: yaw about z from the x axis, positive pitch looks up."""
    forward_x = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], dtype=np.float64)
    tilt = rotation_about("y", -pitch_deg)
    turn = rotation_about("z", yaw_deg)
    pose = np.eye(4)
    pose[:3, :3] = turn @ tilt @ forward_x @ rotation_about("z", roll_deg)
    pose[:3, 3] = position
    return pose


def clearance(room: Room, positions: np.ndarray) -> np.ndarray:
    """Distance from each place to the nearest surface, metres, by 66 rays."""
    directions = _sphere()
    origins = np.repeat(positions.astype(np.float32).T, directions.shape[1], axis=1)
    rays = np.tile(directions, len(positions))
    return room.nearest(origins, rays).reshape(len(positions), -1).min(axis=1)


def _sphere(count: int = 66) -> np.ndarray:
    height = (np.arange(count) + 0.5) / count * 2 - 1
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    out = np.sqrt(1 - height**2)
    return np.stack([out * np.cos(turn), out * np.sin(turn), height]).astype(np.float32)


@dataclass(frozen=True)
class PathStyle:
    """How somebody takes the photos of a room."""

    around: float
    """Share of the paths that go around one thing, of those made to show one (85 % of all)."""
    step_deg: tuple[Number, Number] = (8, 45)
    """The angle between two photos of such a path, from .. to, give or take a third."""
    arc_deg: Number = 110
    """About the farthest that such a path goes around."""
    turn_deg: tuple[Number, Number] | None = None
    """The other paths turn by so much a step; none: a little."""
    plain_costs: float = 2.5
    """How much a view of bare walls and floor is shunned."""
    patience: int = 80
    """Attempts until any short path will do."""


CASUAL = PathStyle(around=0.24)
"""Most photos are 2-60 cm apart and turn a little; some go around one thing, in steps of about 45
degrees and 1.2 m at most, as people photograph a piece of furniture."""
WIDE = PathStyle(around=0.5, turn_deg=(10, 35))
"""As photos do that share little."""
AROUND = PathStyle(around=1.0, step_deg=(20, 70), arc_deg=200, plain_costs=0.3, patience=400)
"""Nearly all around one thing, in wide steps, often with nothing but floor about it."""


def camera_path(
    room: Room, dice: Dice, num_frames: int, width: int, height: int, style: PathStyle = CASUAL
) -> list[Camera]:
    """Poses of neighbouring views, never near a surface."""
    lens = intrinsics(dice, width, height)
    best, best_score = None, -np.inf
    wanted = _rare_point(room, dice) if dice.chance(0.85) else None
    pace = _pace(dice)
    goes_around = wanted is not None and dice.chance(style.around)
    step_deg = dice.uniform(*style.step_deg) if goes_around else None
    turn = None
    if style.turn_deg is not None:
        turn = dice.uniform(*style.turn_deg) * dice.pick([-1, 1])
    for attempt in range(_ATTEMPTS):
        crowded = attempt > style.patience
        target, scale = (None, 0.4) if crowded else (wanted, max(pace * 0.996**attempt, 0.4))
        if step_deg is not None and wanted is not None and not crowded:
            step = min(step_deg * 0.99**attempt, style.arc_deg / max(num_frames - 1, 1))
            poses = _walk_around(room, dice, num_frames, wanted, step)
        else:
            poses = _wander(room, dice, num_frames, target, scale, turn)
        if poses is None:
            continue
        score = _interest(room, Camera(lens, poses[num_frames // 2], width, height), style)
        score += dice.uniform(0, 0.4)
        if score > best_score:
            best, best_score = poses, score
        if attempt > 40 and best is not None:
            break
    assert best is not None, "no free place for the camera in this room"
    return [Camera(lens, pose, width, height) for pose in best]


def _pace(dice: Dice) -> float:
    """How far apart the frames are, times 6-13 cm: often a video's, else up to some strides."""
    return 1.0 if dice.chance(0.3) else 0.4 * 16.0 ** dice.uniform(0, 1)


def _rare_point(room: Room, dice: Dice) -> np.ndarray:
    """A place on some thing; classes that hang on every wall come less often."""
    classes = [label for label in np.unique(room.labels) if FLOOR < label < CLUTTER]
    if not classes:
        return room.triangles[:, 0].mean(axis=0)
    common = (WALL_THINGS.count(label) for label in classes)
    label = classes[dice.weighted([0.25 if is_common else 1.0 for is_common in common])]
    chosen = np.flatnonzero(room.labels == label)
    return room.triangles[chosen[dice.count(0, len(chosen) - 1)]].mean(axis=0).astype(np.float64)


def _wander(room: Room, dice: Dice, num_frames: int, wanted, scale: Number, turn: Number | None):
    """Poses of one short path, or None if it comes too near to something.

    It turns by `turn` degrees a step (None: a few), besides what keeps `wanted` in view.
    """
    start = _stand(room, dice)
    yaw, pitch, roll = dice.uniform(0, 360), dice.uniform(-32, 3), dice.uniform(-4, 4)
    distance = 2.0
    if wanted is not None:
        away = wanted - start
        distance = float(np.hypot(away[0], away[1]))
        if not 1.0 < distance < 3.8:
            return None
        yaw = float(np.degrees(np.arctan2(away[1], away[0]))) + dice.uniform(-14, 14)
        pitch = float(np.degrees(np.arctan2(away[2], distance))) + dice.uniform(-12, 8)
        pitch = float(np.clip(pitch, -35, 5))
    heading = np.radians(yaw + dice.pick([-90, 90, 60, -60, 120, -120, 0]) + dice.uniform(-25, 25))
    direction = np.array([np.cos(heading), np.sin(heading), dice.uniform(-0.3, 0.3)])
    direction *= scale / np.linalg.norm(direction)
    turn = dice.uniform(-4, 4) if turn is None else turn
    pivot = start + distance * pose_from_angles(start, yaw, pitch, 0)[:3, 2]
    attention = dice.uniform(0.3, 1)  # 0: looks straight on while walking, 1: at the same thing
    positions, angles = [start], [(yaw, pitch, roll)]
    for _ in range(num_frames - 1):
        position = positions[-1] + direction * dice.uniform(0.06, 0.13)
        turned, tilted = _bearing(pivot - position) - _bearing(pivot - positions[-1])
        turned = (turned + 180) % 360 - 180
        yaw += attention * turned + turn + dice.uniform(-2, 2)
        pitch = float(np.clip(pitch + attention * tilted + dice.uniform(-2, 2), -38, 8))
        positions.append(position)
        roll += dice.uniform(-1, 1)
        angles.append((yaw, pitch, roll))
    return _free_poses(room, positions, angles)


def _walk_around(room: Room, dice: Dice, num_frames: int, centre: np.ndarray, step_deg: Number):
    """Poses on an arc that look at `centre`; None if something is near."""
    step_deg *= dice.pick([-1, 1])
    bearing, radius, height = dice.uniform(0, 360), dice.uniform(0.8, 2.8), dice.uniform(0.9, 1.8)
    positions, angles = [], []
    for _ in range(num_frames):
        turn, out = np.radians(bearing), radius * dice.uniform(0.88, 1.12)
        position = np.array(
            [
                centre[0] + out * np.cos(turn),
                centre[1] + out * np.sin(turn),
                height + dice.uniform(-0.12, 0.12),
            ]
        )
        yaw, pitch = (angle + dice.uniform(-6, 6) for angle in _bearing(centre - position).tolist())
        positions.append(position)
        angles.append((yaw, float(np.clip(pitch, -65, 10)), dice.uniform(-4, 4)))
        bearing += step_deg * dice.uniform(0.7, 1.3)
    return _free_poses(room, positions, angles)


def _free_poses(room: Room, positions: list[np.ndarray], angles: list[tuple]):
    """The poses, or None if one of them is outside or too near to something."""
    places = np.array(positions)
    if not room.contains(places).all() or (clearance(room, places) < CLEARANCE).any():
        return None
    return [pose_from_angles(p, *a) for p, a in zip(positions, angles, strict=True)]


def _bearing(offset: np.ndarray) -> np.ndarray:
    """(yaw, pitch) towards an offset, degrees."""
    level = np.hypot(offset[0], offset[1])
    return np.degrees([np.arctan2(offset[1], offset[0]), np.arctan2(offset[2], level)])


def _stand(room: Room, dice: Dice) -> np.ndarray:
    left, front, right, back = room.footprint[dice.count(0, len(room.footprint) - 1)]
    x, y = dice.uniform(left + 0.4, right - 0.4), dice.uniform(front + 0.4, back - 0.4)
    return np.array([x, y, dice.uniform(1.05, 1.75)])


def _interest(room: Room, camera: Camera, style: PathStyle) -> float:
    """How much there is to see: many classes, at arm's length to a few metres."""
    column, row = np.meshgrid((np.arange(20) + 0.5) / 20, (np.arange(16) + 0.5) / 16)
    pixels = np.stack([column.ravel() * camera.width, row.ravel() * camera.height])
    hits = room.trace(*camera.rays(pixels))
    labels = room.labels[hits.triangle]
    share = np.bincount(labels, minlength=256) / len(labels)
    seen = np.minimum(share[FLOOR + 1 : CLUTTER] / 0.05, 1).sum()
    near = (hits.distance < 0.7).mean() + max(0.0, (hits.distance > 5).mean() - 0.1)
    plain = max(0.0, share[:2].sum() - 0.45) + max(0.0, share[CLUTTER] - 0.2)
    breadth = min(float(np.median(hits.distance)), 2.4)
    return float(0.35 * seen - 3 * near - style.plain_costs * plain + 0.35 * breadth)
