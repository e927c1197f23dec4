"""The proof that a spherical map is bijective, or the faces at fault."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from gensp.geometry.predicates import map_degree, spherical_orientation


@dataclass(frozen=True)
class Certificate:
    """What the exact predicates say about a map of a closed genus-0 surface.

    Attributes
    ----------
    orientation
        1 where the map keeps orientation, -1 where it mirrors; that of most faces.
    degree
        How often the map winds around the sphere, with its orientation's sign.
    faults
        Indices (k,) of faces that are folded over or without area.
    faces
        Number of faces that were tested.
    """

    orientation: int
    degree: int
    faults: Int[np.ndarray, " k"]
    faces: int

    @property
    def bijective(self) -> bool:
        """No face at fault and degree ±1: the map is one to one and onto."""
        return len(self.faults) == 0 and self.degree == self.orientation

    def __bool__(self) -> bool:
        return self.bijective

    def __str__(self) -> str:
        if self.bijective:
            kept = "kept" if self.orientation > 0 else "mirrored"
            return (
                f"bijective: {self.faces} faces by exact predicate, degree 1, orientation {kept}"
            )
        return (
            f"not bijective: {len(self.faults)} of {self.faces} faces folded or without area "
            f"(first: {self.faults[:5].tolist()}), degree {self.degree}"
        )


def certify(sphere: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> Certificate:
    """Certify a piecewise linear map of a closed genus-0 triangulation to the unit sphere.

    A face counts by the exact sign of det(u_a, u_b, u_c), the orientation of its *spherical*
    triangle. A map without faults is locally injective around every vertex up to its winding,
    and of degree one it covers the sphere exactly once.

    Raises
    ------
    NotEmbeddable
        Positions that are not finite or not unit vectors.
    """
    degree = map_degree(sphere, faces)
    signs = spherical_orientation(sphere, faces)
    orientation = 1 if signs.sum() >= 0 else -1
    return Certificate(
        orientation=orientation,
        degree=degree,
        faults=np.flatnonzero(signs * orientation <= 0),
        faces=len(faces),
    )
