"""Methods of spherical parameterization, learnt or classical, behind one protocol."""

from typing import Protocol

from gensp.geometry.mesh import Mesh
from gensp.geometry.spherical_map import SphericalMap


class SphericalParameterization(Protocol):
    """Anything that maps genus-0 meshes to the sphere.

    Called with a mesh in its own coordinates; gives the map of the same vertices, in the same
    order, with those coordinates in `surface`.
    """

    @property
    def name(self) -> str:
        """What the method is called in tables."""
        ...

    def __call__(self, mesh: Mesh) -> SphericalMap:
        """Map one mesh."""
        ...


__all__ = ["SphericalParameterization"]
