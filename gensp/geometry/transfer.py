"""Carrying what is known on one shape to another through the sphere."""

import numpy as np
from jaxtyping import Float

from gensp.errors import Unsupported
from gensp.geometry.spherical_map import SphericalMap


def transfer(
    values: np.ndarray,
    source: SphericalMap,
    target: SphericalMap,
    rotation: Float[np.ndarray, "3 3"] | None = None,
) -> np.ndarray:
    """Values at the target's vertices of what is given at the source's vertices.

    Every target vertex x takes the value at m_a⁻¹(Rᵀ m_b(x)). Floats and bytes (colours) are
    interpolated; other integers and truth values are labels, of which the nearest corner's is
    taken.

    Parameters
    ----------
    values
        (n,) or (n, c), one row for every vertex of the source.
    rotation
        R, from the source's sphere to the target's; none is the identity.

    Raises
    ------
    Unsupported
        Not one row for every vertex, or no numbers.
    """
    fits = values.ndim in (1, 2) and len(values) == len(source.sphere)
    if not fits or values.dtype.kind not in "fiub":
        raise Unsupported(
            f"{source.name}: values {values.shape} of {values.dtype}; a number or a row of "
            f"numbers for each of its {len(source.sphere)} vertices is required; name others"
        )
    p = target.sphere if rotation is None else target.sphere @ rotation
    at = source.locate(p)
    if values.dtype.kind == "f" or values.dtype == np.uint8:
        columns = values.reshape(len(values), -1).astype(np.float64)
        carried = at.on(columns, source.faces).reshape(-1, *values.shape[1:])
        return np.rint(carried).astype(np.uint8) if values.dtype == np.uint8 else carried
    corner = source.faces[at.faces, at.barycentric.argmax(axis=1)]
    return values[corner]
