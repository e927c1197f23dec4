"""Random genus-0 meshes that are hard to map."""

import numpy as np

from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.sphere import icosphere, unit


def slivers(seed: int, crowd: float, spread: float) -> Mesh:
    """An icosphere whose vertices are crowded and scattered: area ratios up to about a million."""
    rng = np.random.default_rng(seed)
    ball = icosphere(3)
    pole = unit(rng.standard_normal(3))
    near = ball.vertices @ pole
    shrunk = unit(ball.vertices + 0.99 * crowd * near[:, None] * pole)
    radius = np.exp(spread * np.sin(3 * ball.vertices @ rng.standard_normal((3, 3))).sum(axis=1))
    return normalize(Mesh(shrunk * radius[:, None], ball.faces, f"seed {seed}"))
