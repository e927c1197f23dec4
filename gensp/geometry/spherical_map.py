"""The central object: one triangulation with two positions, on a surface and on the sphere."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from gensp.errors import UnreadableMesh
from gensp.files import atomic_path, load_npz, save_npz
from gensp.geometry.certificate import Certificate, certify
from gensp.geometry.distortion import Distortion, distortion
from gensp.geometry.location import SphereLocator
from gensp.geometry.mesh import Mesh
from gensp.geometry.ply import ply_bytes
from gensp.geometry.points import SurfacePoints
from gensp.geometry.predicates import bad_faces, map_degree
from gensp.geometry.sphere import icosphere, unit


@dataclass(frozen=True)
class SphericalMap:
    """A piecewise linear map m between a surface and the unit sphere.

    Attributes
    ----------
    sphere, surface
        Positions (n, 3) of the same vertices: unit vectors, and points of the shape.
    faces
        The shared triangles (m, 3).
    diagnostics
        Plain numbers and texts on how the map was made.
    arrays
        What a method wants kept beside its map, such as the prediction it started from.
    """

    sphere: Float[np.ndarray, "n 3"]
    surface: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    name: str = "mesh"
    diagnostics: Mapping[str, Any] = field(default_factory=dict)
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def mesh(self) -> Mesh:
        """The shape as a mesh."""
        return Mesh(self.surface, self.faces, self.name)

    @cached_property
    def _locator(self) -> SphereLocator:
        return SphereLocator(self.sphere, self.faces)

    def to_sphere(self, points: SurfacePoints) -> Float[np.ndarray, "k 3"]:
        """Image m(x) on the unit sphere of points of the surface."""
        return unit(points.on(self.sphere, self.faces))

    def locate(self, p: Float[np.ndarray, "k 3"]) -> SurfacePoints:
        """Preimage m⁻¹(p) of points of the sphere, as face and barycentric weights."""
        return self._locator.locate(p)

    def to_surface(self, p: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3"]:
        """Preimage m⁻¹(p) as positions on the surface."""
        return self.locate(p).on(self.surface, self.faces)

    def rotated(self, rotation: Float[np.ndarray, "3 3"]) -> "SphericalMap":
        """The map followed by a rotation (or reflection) of the sphere, u → R u."""
        return replace(self, sphere=self.sphere @ rotation.T)

    def bad_faces(self) -> Bool[np.ndarray, " m"]:
        """Faces folded over or without area on the sphere, by exact predicate."""
        return bad_faces(self.sphere, self.faces)

    def degree(self) -> int:
        """Map degree; 1 or -1 together with no bad face means bijective."""
        return map_degree(self.sphere, self.faces)

    def certify(self) -> Certificate:
        """Proof that the map is bijective, or the faces at fault."""
        return certify(self.sphere, self.faces)

    def distortion(self) -> Distortion:
        """Isometric and conformal distortion (paper §5.1)."""
        return distortion(self.surface, self.sphere, self.faces)

    def icosphere_remesh(self, level: int) -> Mesh:
        """The surface sampled at the icosphere's vertices: one connectivity for all shapes."""
        ball = icosphere(level)
        return Mesh(self.to_surface(ball.vertices), ball.faces, self.name)


KEPT = ("reliability",)  # arrays of a map that belong beside it in its file
PLY_FIELDS = ("x", "y", "z", "px", "py", "pz")
PLY_COMMENT = "px py pz: position on the unit sphere"


def save_map(map: SphericalMap, folder: Path | str) -> None:
    """Write `<name>.npz` (vertices, faces, sphere) and `<name>.ply` (x y z px py pz, doubles).

    A map with an array `reliability` (n,) keeps it in the npz.
    """
    folder = Path(folder)
    with atomic_path(folder / f"{map.name}.ply") as temporary:
        values = np.concatenate([map.surface, map.sphere], axis=1)
        temporary.write_bytes(ply_bytes(PLY_FIELDS, values, map.faces, PLY_COMMENT))
    kept = {name: map.arrays[name] for name in KEPT if name in map.arrays}
    arrays = {"vertices": map.surface, "faces": map.faces, "sphere": map.sphere, **kept}
    save_npz(folder / f"{map.name}.npz", **arrays)


def load_map(path: Path | str) -> SphericalMap:
    """Read an npz written by `save_map`.

    Raises
    ------
    UnreadableMesh
        The file lacks one of the arrays.
    """
    path = Path(path)
    arrays = load_npz(path)
    missing = {"vertices", "faces", "sphere"} - arrays.keys()
    if missing:
        raise UnreadableMesh(
            f"{path}: arrays {', '.join(sorted(missing))} are missing; a spherical map has "
            "vertices, faces and sphere; write it again with stage=parameterize"
        )
    kept = {name: arrays[name] for name in KEPT if name in arrays}
    return SphericalMap(
        arrays["sphere"], arrays["vertices"], arrays["faces"], path.stem, arrays=kept
    )
