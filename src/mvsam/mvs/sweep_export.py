"""The plane sweep for graphs that leave PyTorch: plain operations, and no loop over the views.

A loop would be unrolled into the graph and fix how many views it takes.
"""

from jaxtyping import Float
from torch import Tensor

from mvsam.geometry.warp import warp_to_reference


def sweep_variance(
    features: Float[Tensor, "batch view channel height width"],
    projections: Float[Tensor, "batch view 12"],
    hypotheses: Float[Tensor, "batch plane height width"],
) -> Float[Tensor, "batch channel plane height width"]:
    """Variance volume (Eq. 2) of float32 features; holds the warped volumes of all views at once.

    `projections` as `cost_volume.variance_volume` makes them: A row by row, then b; the
    reference's are not read.
    """
    batch, num_views = features.shape[:2]
    sources = projections[:, 1:].flatten(0, 1)
    planes = hypotheses[:, None].expand(-1, num_views - 1, -1, -1, -1).flatten(0, 1)
    warped = warp_to_reference(
        features[:, 1:].flatten(0, 1), sources[:, :9].unflatten(1, (3, 3)), sources[:, 9:], planes
    ).unflatten(0, (batch, num_views - 1))
    reference = features[:, 0, :, None]
    mean = (reference + warped.sum(dim=1)) / num_views
    mean_of_squares = (reference.square() + warped.square().sum(dim=1)) / num_views
    return mean_of_squares - mean.square()
