"""From one shape to another: both on the icosphere's triangles, positions blended."""

import numpy as np
from jaxtyping import Float

from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere import icosphere
from gensp.geometry.spherical_map import SphericalMap


def morphed(
    source: SphericalMap,
    target: SphericalMap,
    frames: int,
    *,
    level: int,
    rotation: Float[np.ndarray, "3 3"] | None = None,
) -> list[Mesh]:
    """Meshes on a straight line between the remeshes of two shapes, both ends included.

    Parameters
    ----------
    level
        Of the icosphere whose vertices are sampled in both maps.
    rotation
        R, from the source's sphere to the target's; none is the identity.
    """
    ball = icosphere(level)
    p = ball.vertices if rotation is None else ball.vertices @ rotation.T
    start, end = source.to_surface(ball.vertices), target.to_surface(p)
    return [
        Mesh((1 - t) * start + t * end, ball.faces, f"{source.name}_{target.name}")
        for t in np.linspace(0, 1, frames)
    ]
