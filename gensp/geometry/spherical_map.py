"""The central object: one triangulation with two positions, on a surface and on the sphere."""

from collections.abc import Iterable, Mapping
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
from gensp.geometry.topology import sphere_fault


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

    def __repr__(self) -> str:
        sizes = f"{len(self.sphere)} vertices, {len(self.faces)} faces"
        return f"{type(self).__name__}({self.name!r}, {sizes})"

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

    def locate(
        self, p: Float[np.ndarray, "k 3"], near: Int[np.ndarray, " k"] | None = None
    ) -> SurfacePoints:
        """Preimage m⁻¹(p) of points of the sphere, as face and barycentric weights.

        Faces `near` the points, where they are known, save the search for them.
        """
        return self._locator.locate(p, near)

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
        """Map degree of a closed surface; `certify` tells whether the map is bijective."""
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
TOLD = ("rung",)  # diagnostics that do, as texts
PLY_FIELDS = ("x", "y", "z", "px", "py", "pz")
PLY_COMMENT = "px py pz: position on the unit sphere"


def save_map(map: SphericalMap, folder: Path | str) -> None:
    """Write `<name>.npz` (vertices, faces, sphere) and `<name>.ply` (x y z px py pz, doubles).

    An array `reliability` (n,) of the map, and a text `rung` of its diagnostics, are kept in the
    npz.
    """
    folder = Path(folder)
    with atomic_path(folder / f"{map.name}.ply") as temporary:
        values = np.concatenate([map.surface, map.sphere], axis=1)
        temporary.write_bytes(ply_bytes(PLY_FIELDS, values, map.faces, PLY_COMMENT))
    kept = {name: map.arrays[name] for name in KEPT if name in map.arrays}
    told = {name: np.array(map.diagnostics[name]) for name in TOLD if name in map.diagnostics}
    arrays = {"vertices": map.surface, "faces": map.faces, "sphere": map.sphere}
    save_npz(folder / f"{map.name}.npz", **arrays, **kept, **told)


def load_map(path: Path | str) -> SphericalMap:
    """Read an npz written by `save_map`.

    Raises
    ------
    UnreadableMesh
        The file's arrays are no map of a closed surface of genus 0.
    """
    path = Path(path)
    arrays = load_npz(path)
    missing = {"vertices", "faces", "sphere"} - arrays.keys()
    if missing:
        raise UnreadableMesh(
            f"{path}: arrays {', '.join(sorted(missing))} are missing; a spherical map has "
            "vertices, faces and sphere; write it again with stage=parameterize"
        )
    fault = map_fault(arrays)
    if fault:
        raise UnreadableMesh(f"{path}: {fault}; write it again with stage=parameterize")
    return map_from(arrays, path.stem, kept=KEPT)


def map_from(arrays: Mapping[str, np.ndarray], name: str, *, kept: Iterable[str]) -> SphericalMap:
    """The map that sound arrays of a file are, with those named in `kept` beside it."""
    sphere, surface = (np.asarray(arrays[key], np.float64) for key in ("sphere", "vertices"))
    told = {key: str(arrays[key]) for key in TOLD if key in arrays}
    beside = {key: arrays[key] for key in kept if key in arrays}
    return SphericalMap(sphere, surface, np.asarray(arrays["faces"], np.int64), name, told, beside)


def map_fault(arrays: Mapping[str, np.ndarray]) -> str:
    """What keeps arrays of a file from being a spherical map, and what is required; else empty.

    They can be folded: `SphericalMap.certify` tells.
    """
    fault = _array_fault(arrays)
    if fault:
        required = "vertices (n, 3), faces (m, 3) and unit vectors sphere (n, 3) are required"
        return f"{fault}; {required}"
    faces = np.asarray(arrays["faces"], np.int64)
    broken = sphere_fault(faces, len(arrays["sphere"]))
    return f"{broken.found}; a map of one closed surface of genus 0 is required" if broken else ""


def _array_fault(arrays: Mapping[str, np.ndarray]) -> str:
    missing = {"vertices", "faces", "sphere"} - arrays.keys()
    if missing:
        return f"has no {', '.join(sorted(missing))}"
    surface, sphere, faces = (arrays[name] for name in ("vertices", "sphere", "faces"))
    flat = any(x.ndim != 2 or x.shape[1] != 3 or len(x) == 0 for x in (surface, sphere, faces))
    if flat or len(surface) != len(sphere):
        return f"arrays of the shapes {surface.shape}, {sphere.shape} and {faces.shape}"
    if faces.dtype.kind not in "iu" or {surface.dtype.kind, sphere.dtype.kind} != {"f"}:
        return f"arrays of {surface.dtype}, {sphere.dtype} and {faces.dtype}"
    if faces.min() < 0 or faces.max() >= len(sphere):
        return f"faces that name vertices outside the {len(sphere)}"
    return _value_fault(arrays)


def _value_fault(arrays: Mapping[str, np.ndarray]) -> str:
    sphere = arrays["sphere"]
    if not np.isfinite(arrays["vertices"]).all():
        return "vertices that are not numbers"
    length = np.linalg.norm(sphere, axis=1)
    if not np.isfinite(length).all() or np.abs(length - 1).max() > 1e-6:
        return "sphere positions that are not unit vectors"
    known = arrays.get("reliability", np.ones(len(sphere)))
    if known.shape != (len(sphere),) or not ((known >= 0) & (known <= 1)).all():
        return f"a reliability {known.shape} that is not a number in [0, 1] for every vertex"
    return ""
