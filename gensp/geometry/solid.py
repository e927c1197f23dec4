"""A closed surface around anything: soups, several parts, turned faces, sheets, handles (torch).

What is inside is decided by a flood from outside and by winding numbers (Barill et al. 2018,
"Fast winding numbers for soups and clouds"), see `gensp.geometry.enclosure`; handles are closed by
growing the solid and shrinking it again (morphological closing, Serra 1982), which fills whatever
a ball of that radius cannot enter.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gensp.errors import DegenerateMesh, EmptyLevelSet, NotGenusZero
from gensp.geometry.distance import ClosestPointTree, closest_point
from gensp.geometry.enclosure import Enclosure, enclosure
from gensp.geometry.isosurface import Grid, extract_surface
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
_TRIES = 3  # to hold what is thinner than a cell
_LOST = 1.5  # cells from the surface
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
    largest_distance: float = 0.03,
) -> Solid:
    """Outer surface of what a mesh encloses, without handles, on a grid.

    Cavities are closed; what is thinner than a cell is thickened to about two.

    Parameters
    ----------
    mesh
        Finite vertices and valid faces; nothing else is required.
    resolution
        Cells along the longest side of the grid.
    vertices
        About so many are kept by edge collapses; None keeps all.
    largest_radius
        Largest radius of the closing, in diagonals; 0 refuses what has handles.
    largest_distance
        How far, in diagonals, the surface may be from what is seen of the mesh from outside. A
        closing may move it further by its radius.

    Raises
    ------
    NotGenusZero
        Handles are left at the largest radius.
    DegenerateMesh
        The mesh has no area, or the surface lacks a part of what is seen of it.
    EmptyLevelSet
        Nothing is enclosed.
    """
    if not mesh.area > 0:
        raise DegenerateMesh(f"{mesh.name}: has no area; a surface is required; export it again")
    fine, surface = _whole(mesh, _Sampled.of(mesh, resolution), vertices)
    found = _without_handles(mesh, fine, surface, vertices, largest_radius)
    _require_near(found, fine.enclosed.seen, mesh, largest_distance)
    return found


@dataclass(frozen=True)
class _Sampled:
    """What a mesh encloses on a grid of so many cells."""

    enclosed: Enclosure
    resolution: int

    @classmethod
    def of(cls, mesh: Mesh, resolution: int) -> "_Sampled":
        tell(f"flood of a grid of {resolution} cells")
        return cls(enclosure(mesh, Grid.over(_box(mesh, resolution, 0.0), resolution)), resolution)


def _whole(mesh: Mesh, fine: _Sampled, vertices: int | None) -> tuple[_Sampled, Mesh]:
    """The surface without any closing, its thin parts thickened where they were lost."""
    surface = None
    for left in reversed(range(_TRIES)):
        seen, cell = fine.enclosed.seen, fine.enclosed.grid.cell
        with suppress(EmptyLevelSet):
            surface = _surface(mesh, 0.0, fine, vertices)
            seen = seen[closest_point(seen, surface).distance > _LOST * cell]
        grown = fine.enclosed.thickened(seen)
        if not left or np.array_equal(grown.thin, fine.enclosed.thin):
            break
        fine = replace(fine, enclosed=grown)
    return fine, surface or _surface(mesh, 0.0, fine, vertices)


def _without_handles(
    mesh: Mesh, fine: _Sampled, surface: Mesh, vertices: int | None, largest_radius: float
) -> Solid:
    """The surface after the least closing that leaves no handle."""
    radii = [radius for radius in RADII[1:] if radius <= largest_radius]
    if surface.euler == 2:
        return Solid(surface, 0.0)
    least = _least_radius(mesh, _coarse(mesh, fine)) if largest_radius > 0 else 0.0
    for radius in (r for r in radii if r >= least):
        surface = _surface(mesh, radius, fine, vertices)
        if surface.euler == 2:
            return Solid(surface, radius)
    largest = min(largest_radius, RADII[-1])
    raise NotGenusZero(
        f"{mesh.name}: genus {1 - surface.euler // 2} is left after remeshing and closing handles "
        f"up to a radius of {largest:g} diagonals; genus 0 is required; cut the handles by hand"
    )


def _coarse(mesh: Mesh, fine: _Sampled) -> _Sampled:
    return fine if fine.resolution <= _COARSE else _Sampled.of(mesh, _COARSE)


def _require_near(
    solid: Solid, seen: Float[np.ndarray, "k 3"], mesh: Mesh, largest: float
) -> None:
    """Refuse a surface that lacks parts of the mesh."""
    diagonal = bounding_diagonal(mesh)
    far = closest_point(seen, solid.mesh).distance.max(initial=0.0) / diagonal
    if far > largest + solid.radius:
        raise DegenerateMesh(
            f"{mesh.name}: parts that are seen from outside lie {far:.3g} diagonals from the new "
            f"surface; at most {largest + solid.radius:g} are allowed; join loose parts, or raise "
            "recipe.prepare.solid.largest_distance"
        )


def _least_radius(mesh: Mesh, coarse: _Sampled) -> float:
    """The radius before the first that closes all handles on a coarse grid.

    A level set costs a tenth there; what the coarse grid misjudges is found by the fine one.
    """
    before = 0.0
    for radius in RADII[1:]:
        try:
            if _surface(mesh, radius, coarse, None).euler == 2:
                break
        except EmptyLevelSet:
            break
        before = radius
    return before


def _surface(mesh: Mesh, radius: float, on: _Sampled, vertices: int | None) -> Mesh:
    """Outer surface of the solid, closed by a radius in diagonals."""
    closing = f", handles closed by a ball of {radius:g} diagonals" if radius else ""
    tell(f"surface on a grid of {on.resolution} cells{closing}")
    field: Field = partial(on.enclosed.field, sheet=_SHEET * on.enclosed.grid.cell)
    if radius > 0:
        size = radius * bounding_diagonal(mesh)
        whole = partial(on.enclosed.field, sheet=np.inf)
        field = _closed(field, _grown(whole, mesh, size, on.resolution), size)
    return _level_set(field, mesh, on.resolution, vertices, margin=0.0)


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

    try:
        return extract_surface(
            sampled,
            resolution=resolution,
            vertices=vertices,
            bounds=_box(mesh, resolution, margin),
            require_genus_zero=False,
            dtype=torch.float64,
            name=mesh.name,
        )
    except EmptyLevelSet as error:
        raise EmptyLevelSet(
            f"{mesh.name}: encloses nothing that a grid of {resolution} cells can see; a solid is "
            "required; ask for a finer grid"
        ) from error


def _box(mesh: Mesh, resolution: int, margin: float) -> Float[np.ndarray, "2 3"]:
    """Two corners around a mesh, two cells and a margin away."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    around = margin + 2 * float((high - low).max()) / resolution
    return np.stack([low - around, high + around])
