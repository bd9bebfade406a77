"""What a format says of a scene beside its frames."""

from dataclasses import dataclass, fields

from jaxtyping import Float
from numpy import ndarray

from mvsam.data.labels import SCANNET20, ClassTable
from mvsam.types import Scene


@dataclass(frozen=True)
class About:
    """Attributes that a `Scene` may have; what one lacks is as it is here."""

    classes: ClassTable = SCANNET20
    """Of its labels."""
    points: Float[ndarray, "point 3"] | None = None
    """Sparse points of its surfaces in world axes, in the unit of the poses."""
    num_lost: int = 0
    """Pictures that are left out because they have no pose."""
    has_unit: bool = True
    """Whether its poses are in metres; a COLMAP model's unit is arbitrary."""
    has_poses: bool = True
    """Whether its frames' poses mean anything."""

    @staticmethod
    def of(scene: Scene) -> "About":
        names = [field.name for field in fields(About)]
        return About(**{name: getattr(scene, name) for name in names if hasattr(scene, name)})
