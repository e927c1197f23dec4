"""A closed surface around anything that has an inside: soups, several parts, handles (torch).

What is inside is decided by winding numbers (Barill et al. 2018, "Fast winding numbers for soups
and clouds"); handles are closed by growing the solid and shrinking it again (morphological
closing, Serra 1982), which fills whatever a ball of that radius cannot enter.
"""

from collections.abc import Callable
from dataclasses import dataclass

import igl
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gensp.errors import DegenerateMesh, EmptyLevelSet, NotGenusZero
from gensp.geometry.distance import ClosestPointTree
from gensp.geometry.isosurface import extract_surface
from gensp.geometry.mesh import Mesh
from gensp.geometry.progress import tell
from gensp.geometry.repair import bounding_diagonal

Field = Callable[[Float[np.ndarray, "k 3"]], Float[np.ndarray, " k"]]

# Radii of the closing in diagonals, tried in turn; the first is none.
RADII = (0.0, 0.01, 0.02, 0.04, 0.07, 0.11, 0.16, 0.24, 0.35, 0.55, 0.9)
_COARSE = 40
# Vertices of the grown solid: it is nowhere rounder than its radius, and points at the centre of a
# ball are as near to all of its triangles.
_GROWN = 10_000
_SHEET = 8.0  # cells: how far the winding number alone places the surface


@dataclass(frozen=True)
class Solid:
    """A closed genus-0 surface, and the radius of the closing that led to it (0: none)."""

    mesh: Mesh
    radius: float


def solid_surface(
    mesh: Mesh,
    *,
    resolution: int = 128,
    vertices: int | None = 5000,
    largest_radius: float = RADII[-1],
) -> Solid:
    """Outer surface of what a mesh encloses, without handles, by winding-number remeshing.

    Parameters
    ----------
    mesh
        Finite vertices and valid faces; nothing else is required.
    resolution
        Cells along the longest side of the grid; thinner parts are lost.
    vertices
        About so many are kept by edge collapses; None keeps all.
    largest_radius
        Largest radius of the closing, in diagonals; 0 refuses what has handles.

    Raises
    ------
    NotGenusZero
        Handles are left at the largest radius.
    DegenerateMesh
        The surface has no area.
    EmptyLevelSet
        Nothing is enclosed.
    """
    if not mesh.area > 0:
        raise DegenerateMesh(f"{mesh.name}: has no area; a surface is required; export it again")
    radii = iter(radius for radius in RADII if radius <= largest_radius)
    surface = _surface(mesh, next(radii), resolution, vertices)
    if surface.euler == 2:
        return Solid(surface, 0.0)
    least = _least_radius(mesh, min(resolution, _COARSE)) if largest_radius > 0 else 0.0
    for radius in (r for r in radii if r >= least):
        surface = _surface(mesh, radius, resolution, vertices)
        if surface.euler == 2:
            return Solid(surface, radius)
    largest = min(largest_radius, RADII[-1])
    raise NotGenusZero(
        f"{mesh.name}: genus {1 - surface.euler // 2} is left after remeshing and closing handles "
        f"up to a radius of {largest:g} diagonals; genus 0 is required; cut the handles by hand"
    )


def _least_radius(mesh: Mesh, resolution: int) -> float:
    """The radius before the first that closes all handles on a coarse grid.

    A level set costs a tenth there; what the coarse grid misjudges is found by the fine one.
    """
    before = 0.0
    for radius in RADII[1:]:
        try:
            if _surface(mesh, radius, resolution, None).euler == 2:
                break
        except EmptyLevelSet:
            break
        before = radius
    return before


def _surface(mesh: Mesh, radius: float, resolution: int, vertices: int | None) -> Mesh:
    """Outer surface of the solid, closed by a radius in diagonals."""
    closing = f", handles closed by a ball of {radius:g} diagonals" if radius else ""
    tell(f"surface on a grid of {resolution} cells{closing}")
    cell = float(np.ptp(mesh.vertices, axis=0).max()) / resolution
    field = _enclosed(mesh, _SHEET * cell)
    if radius > 0:
        size = radius * bounding_diagonal(mesh)
        field = _closed(field, _grown(_enclosed(mesh, np.inf), mesh, size, resolution), size)
    return _level_set(field, mesh, resolution, vertices, margin=0.0)


def _enclosed(mesh: Mesh, sheet: float) -> Field:
    """Distances, negative inside; across a hole the winding number carries the surface on."""
    tree = ClosestPointTree(mesh)
    winding = igl.FastWindingNumberBVH()
    winding.init(tree.vertices, tree.faces, 2)

    def field(points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        number = winding.winding_number(np.ascontiguousarray(points)).reshape(-1)
        out = 0.5 - number
        distance = tree.query(points).distance
        # Near the surface the distance is smaller, in the middle of a hole the other is.
        near = np.minimum(distance, sheet * np.abs(out)) if np.isfinite(sheet) else distance
        return np.sign(out) * near

    return field


def _grown(distance: Field, mesh: Mesh, radius: float, resolution: int) -> ClosestPointTree:
    """Outer surface of the solid grown by a radius."""

    def field(points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        return distance(points) - radius

    surface = _level_set(field, mesh, resolution, _GROWN, margin=1.2 * radius)
    return ClosestPointTree(surface)


def _closed(inside: Field, grown: ClosestPointTree, radius: float) -> Field:
    """The solid together with what a ball of this radius cannot enter from outside."""

    def field(points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        return np.minimum(inside(points), grown.signed_distance(points) + radius)

    return field


def _level_set(
    field: Field, mesh: Mesh, resolution: int, vertices: int | None, *, margin: float
) -> Mesh:
    """Largest part of a field's zero level set near a mesh."""

    def sampled(points: Tensor) -> Tensor:
        return torch.from_numpy(field(points.numpy()))

    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    around = margin + 2 * float((high - low).max()) / resolution
    try:
        return extract_surface(
            sampled,
            resolution=resolution,
            vertices=vertices,
            bounds=np.stack([low - around, high + around]),
            require_genus_zero=False,
            dtype=torch.float64,
            name=mesh.name,
        )
    except EmptyLevelSet as error:
        raise EmptyLevelSet(
            f"{mesh.name}: encloses nothing that a grid of {resolution} cells can see; a solid is "
            "required; ask for a finer grid"
        ) from error
