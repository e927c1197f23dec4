"""Walking through a spherical triangulation to the triangle that a direction passes through."""

import numpy as np
from numba import njit


@njit(cache=True)
def _triple(a, b, c):  # fmt: skip
    """Determinant of three vectors."""
    x = b[1] * c[2] - b[2] * c[1]
    y = b[2] * c[0] - b[0] * c[2]
    z = b[0] * c[1] - b[1] * c[0]
    return a[0] * x + a[1] * y + a[2] * z


@njit(cache=True)
def _weigh(p, face, u, weights):  # fmt: skip
    """Put into `weights` those with Σ w_j u_j parallel to p and Σ |w_j| = 1; their least."""
    a, b, c = u[face[0]], u[face[1]], u[face[2]]
    weights[0], weights[1], weights[2] = _triple(p, b, c), _triple(a, p, c), _triple(a, b, p)
    total = abs(weights[0]) + abs(weights[1]) + abs(weights[2])
    if total > 0:
        weights /= total
    return weights.min()


@njit(cache=True)
def walk(p, start, u, faces, across, steps):  # fmt: skip
    """From a face for every point, across the edge that separates most, to the face that holds it.

    Parameters
    ----------
    across
        (m, 3): the face beyond edge k of a face, which joins its corners k and k + 1.
    steps
        After so many the best face that was met is taken.

    Returns
    -------
    faces, weights
        (k,) and (k, 3); all weights are positive or zero where the point was found.
    """
    found, best = start.copy(), np.empty((len(p), 3))
    weights = np.empty(3)
    for i in range(len(p)):
        at = start[i]
        least = _weigh(p[i], faces[at], u, weights)
        best[i] = weights
        for _ in range(steps):
            if least >= 0.0:
                break
            at = across[at, (weights.argmin() + 1) % 3]
            here = _weigh(p[i], faces[at], u, weights)
            if here > least:
                least, found[i] = here, at
                best[i] = weights
    return found, best
