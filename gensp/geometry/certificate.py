"""The proof that a spherical map is bijective, or what is at fault."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from gensp.errors import NotEmbeddable
from gensp.geometry.mesh import Mesh
from gensp.geometry.predicates import require_unit, signed_preimages, spherical_orientation
from gensp.geometry.topology import known_faces, sphere_fault


@dataclass(frozen=True)
class Certificate:
    """What indices and exact predicates say about a map.

    Attributes
    ----------
    orientation
        1 where the map keeps orientation, -1 where it mirrors; that of most faces.
    degree
        How often the map winds around the sphere, with its orientation's sign; None if the faces
        are no closed surface of genus 0.
    faults
        Indices (k,) of faces that are folded over or without area.
    faces
        Number of faces that were tested.
    topology
        What keeps the faces from being one closed surface of genus 0; empty if they are.
    """

    orientation: int
    degree: int | None
    faults: Int[np.ndarray, " k"]
    faces: int
    topology: str = ""

    @property
    def bijective(self) -> bool:
        """A closed surface, no face at fault and degree ±1: the map is one to one and onto."""
        return not self.topology and len(self.faults) == 0 and self.degree == self.orientation

    def __bool__(self) -> bool:
        return self.bijective

    def __str__(self) -> str:
        if self.bijective:
            kept = "kept" if self.orientation > 0 else "mirrored"
            return (
                f"bijective: {self.faces} faces by exact predicate, degree {self.degree}, "
                f"orientation {kept}"
            )
        first = f" (first: {self.faults[:5].tolist()})" if len(self.faults) else ""
        wound = f"not closed, {self.topology}" if self.topology else f"degree {self.degree}"
        return (
            f"not bijective: {len(self.faults)} of {self.faces} faces folded or without area"
            f"{first}, {wound}"
        )

    def complaint(self, mesh: Mesh) -> str:
        """What is at fault and where on the mesh, for a message."""
        if self.topology:
            return self.topology
        if len(self.faults):
            return (
                f"{len(self.faults)} of {self.faces} faces are folded or without area on the "
                f"sphere (first: {place_of(mesh, int(self.faults[0]))})"
            )
        return f"the map has degree {self.degree}"


def certify(sphere: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> Certificate:
    """Certify a piecewise linear map of a triangulation to the unit sphere.

    The triangulation counts as closed and of genus 0 by its indices (`topology.sphere_fault`), a
    face by the exact sign of det(u_a, u_b, u_c), the orientation of its *spherical* triangle, and
    the degree by the faces that hold one direction, by the same predicate. A map of a closed
    surface without faults is locally injective around every vertex up to its winding, and of
    degree one it covers the sphere exactly once.

    Raises
    ------
    NotEmbeddable
        Positions that are not finite or not unit vectors.
    """
    require_unit(sphere)
    fault = sphere_fault(faces, len(sphere))
    known = known_faces(faces, len(sphere))
    signs = np.zeros(len(faces), dtype=np.int64)
    signs[known] = spherical_orientation(sphere, faces[known])
    orientation = 1 if signs.sum() >= 0 else -1
    return Certificate(
        orientation=orientation,
        degree=None if fault else signed_preimages(sphere, faces, signs),
        faults=np.flatnonzero(signs * orientation <= 0),
        faces=len(faces),
        topology=fault.found if fault else "",
    )


def require_bijective(mesh: Mesh, sphere: Float[np.ndarray, "n 3"], *, remedy: str) -> None:
    """Refuse a map of a mesh that is not certified with degree 1.

    Raises
    ------
    NotEmbeddable
        What is at fault, the first face and its position; `remedy` is what to do.
    """
    found = certify(sphere, mesh.faces)
    if not found.bijective or found.degree != 1:
        raise NotEmbeddable(
            f"{mesh.name}: {found.complaint(mesh)}; a bijective map of degree 1 is required; "
            f"{remedy}"
        )


def place_of(mesh: Mesh, face: int) -> str:
    """A face and its position, for a message."""
    middle = mesh.vertices[mesh.faces[face]].mean(axis=0)
    return f"face {face} near {[float(f'{x:.4g}') for x in middle]}"
