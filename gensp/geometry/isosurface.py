"""The surface of an implicit field: marching cubes on a grid that is fine only near it (torch)."""

from collections.abc import Callable
from dataclasses import dataclass
from math import floor, log2
from typing import Any

import igl
import numpy as np
import torch
import torch.nn.functional as functional
from jaxtyping import Bool, Float, Int
from skimage.measure import marching_cubes
from torch import Tensor

from gensp.errors import EmptyLevelSet, NotGenusZero
from gensp.geometry.mesh import Mesh, simplify

Field = Callable[[Tensor], Tensor]

COARSEST = 8  # cells along the longest side of the first grid, doubled until the resolution


def extract_surface(
    field: Field,
    *,
    resolution: int,
    vertices: int | None,
    bounds: float | Float[np.ndarray, "2 3"],
    require_genus_zero: bool = True,
    chunk: int = 65_536,
    device: torch.device | str = "cpu",
    dtype: torch.dtype = torch.float32,
    name: str = "level set",
) -> Mesh:
    """Largest component of the zero level set, by marching cubes, simplified (Stage II, III).

    Parameters
    ----------
    field
        Signed distances, or the like, (k,) at points (k, 3); negative inside, of slope near 1: a
        finer grid is laid only where they are small against a coarse cell.
    resolution
        Cells along the longest side, rounded up to a power of two times at least 8.
    vertices
        Size of the mesh after edge collapses; None keeps the marching-cubes mesh.
    bounds
        Half side of a cube around the origin, or two opposite corners.
    require_genus_zero
        Refuse other topologies; where only the points count they may be allowed.
    chunk
        Points per evaluation of the field, on `device` and in `dtype`.

    Raises
    ------
    EmptyLevelSet
        No sign change in the box, or the surface leaves the box.
    NotGenusZero
        The Euler characteristic is not 2.
    """
    grid = Grid.over(_corners(bounds), resolution)
    values = sampled(field, grid, chunk=chunk, device=device, dtype=dtype)
    mesh = _largest_component(_marched(values, grid, name), grid)
    if require_genus_zero:
        _require_euler_of_sphere(mesh)
    return mesh if vertices is None else _decimated(mesh, vertices)


def _corners(bounds: float | Float[np.ndarray, "2 3"]) -> Float[np.ndarray, "2 3"]:
    corners = bounds * np.array([[-1.0], [1.0]]) * np.ones(3) if np.isscalar(bounds) else bounds
    return np.asarray(corners, dtype=np.float64)


def _require_euler_of_sphere(mesh: Mesh) -> None:
    if mesh.euler != 2:
        raise NotGenusZero(
            f"{mesh.name}: the level set has Euler characteristic {mesh.euler}; 2 is required; "
            "raise the grid resolution or train the implicit stage longer"
        )


@dataclass(frozen=True)
class Grid:
    """A box of cubic cells: lower corner, cell side, cells per axis, number of halvings."""

    lower: Float[np.ndarray, " 3"]
    cell: float
    cells: tuple[int, int, int]
    halvings: int

    @classmethod
    def over(cls, corners: Float[np.ndarray, "2 3"], resolution: int) -> "Grid":
        """A box around two corners with about `resolution` cells along its longest side."""
        sides = corners[1] - corners[0]
        halvings = max(floor(log2(resolution / COARSEST)), 0)
        coarse = -(-resolution // 2**halvings)
        counts = np.ceil(coarse * sides / sides.max() - 1e-9).astype(int) * 2**halvings
        cell = sides.max() / (coarse * 2**halvings)
        lower = corners.mean(axis=0) - cell * counts / 2
        return cls(lower, float(cell), (int(counts[0]), int(counts[1]), int(counts[2])), halvings)

    def points(self, indices: Int[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3"]:
        """Where the corners of cells with these indices lie."""
        return self.lower + self.cell * indices

    def cells_of(self, points: Float[np.ndarray, "k 3"]) -> Int[np.ndarray, "k 3"]:
        """Indices of the cells that points lie in, or of the nearest ones."""
        found = np.floor((points - self.lower) / self.cell).astype(np.int64)
        return np.clip(found, 0, np.array(self.cells) - 1)

    def nearest(self, points: Float[np.ndarray, "k 3"]) -> Int[np.ndarray, "k 3"]:
        """Indices of the nearest corners of cells."""
        found = np.rint((points - self.lower) / self.cell).astype(np.int64)
        return np.clip(found, 0, self.cells)


def _evaluator(
    field: Field, grid: Grid, chunk: int, device: torch.device | str, dtype: torch.dtype
) -> Field:
    """The field at grid points, given by their indices, a chunk at a time."""

    def evaluate(indices: Int[Tensor, "k 3"]) -> Float[Tensor, " k"]:
        points = torch.from_numpy(grid.lower) + grid.cell * indices
        parts = [field(part.to(device, dtype)).reshape(-1) for part in torch.split(points, chunk)]
        return torch.cat(parts).to("cpu", torch.float64)

    return evaluate


def sampled(
    field: Field,
    grid: Grid,
    *,
    chunk: int = 65_536,
    device: torch.device | str = "cpu",
    dtype: torch.dtype = torch.float64,
) -> Float[np.ndarray, "a b c"]:
    """Values on the finest grid, evaluated where they are small and interpolated elsewhere."""
    with torch.no_grad():
        return _refined(_evaluator(field, grid, chunk, device, dtype), grid).numpy()


def _refined(evaluate: Callable[[Tensor], Tensor], grid: Grid) -> Float[Tensor, "a b c"]:
    step = 2**grid.halvings
    shape = [count // step + 1 for count in grid.cells]
    values = evaluate(step * torch.ones(shape).nonzero()).reshape(shape)
    while step > 1:
        active = _near_surface(values, reach=0.75 * 3**0.5 * grid.cell * step)
        step //= 2
        shape = [count // step + 1 for count in grid.cells]
        values = functional.interpolate(
            values[None, None], size=shape, mode="trilinear", align_corners=True
        )[0, 0]
        touched = _corners_of_halves(active)
        values[touched] = evaluate(step * touched.nonzero())
    return values


def _near_surface(values: Float[Tensor, "a b c"], reach: float) -> Bool[Tensor, "i j k"]:
    """Cells that the surface may cross: corners of both signs, or one nearer than `reach`.

    Some corner is within half a diagonal of any point of the cell, so a reach of three quarters
    holds for fields half as steep again as a distance.
    """

    def largest(corners: Float[Tensor, "a b c"]) -> Float[Tensor, "i j k"]:
        return functional.max_pool3d(corners[None, None], kernel_size=2, stride=1)[0, 0]

    crossed = (largest(values) >= 0) & (largest(-values) > 0)
    return crossed | (-largest(-values.abs()) < reach)


def _corners_of_halves(active: Bool[Tensor, "a b c"]) -> Bool[Tensor, "i j k"]:
    """Grid points on the active cells after every cell is halved along each axis."""
    fine = active.double()[None, None]
    for axis in (2, 3, 4):
        fine = fine.repeat_interleave(2, dim=axis)
    return functional.max_pool3d(fine, kernel_size=2, stride=1, padding=1)[0, 0] > 0


def _marched(values: Float[np.ndarray, "a b c"], grid: Grid, name: str) -> Mesh:
    # A vertex exactly on a grid point would give triangles without area.
    values = np.where(np.abs(values) < 1e-4 * grid.cell, 1e-4 * grid.cell, values)
    if not np.isfinite(values).all() or (values > 0).all() or (values < 0).all():
        raise EmptyLevelSet(
            f"{name}: the field is between {values.min():.3g} and {values.max():.3g} on the grid; "
            "a change of sign is required; widen the bounds or train the implicit stage longer"
        )
    # Outside the box counts as outside the shape, so that the surface is closed.
    padded = np.pad(values, 1, constant_values=np.abs(values).max())
    surface: Any = marching_cubes  # has no annotations
    positions, faces, *_ = surface(padded, 0.0, gradient_direction="descent")
    positions = grid.lower + grid.cell * (positions.astype(np.float64) - 1)
    return Mesh(positions, faces.astype(np.int64), name)


def _largest_component(mesh: Mesh, grid: Grid) -> Mesh:
    _, label = igl.facet_components(mesh.faces)
    area = np.bincount(np.asarray(label).reshape(-1), weights=mesh.face_areas)
    kept = mesh.faces[np.asarray(label).reshape(-1) == area.argmax()]
    used, faces = np.unique(kept, return_inverse=True)
    positions = mesh.vertices[used]
    upper = grid.lower + grid.cell * np.array(grid.cells)
    outside = int(((positions < grid.lower) | (positions > upper)).any(axis=1).sum())
    if outside:
        raise EmptyLevelSet(
            f"{mesh.name}: the level set leaves the box at {outside} places; a surface inside it "
            "is required; widen the bounds or train the implicit stage longer"
        )
    return Mesh(positions, faces.reshape(-1, 3).astype(np.int64), mesh.name)


def _decimated(mesh: Mesh, vertices: int) -> Mesh:
    if mesh.euler == 2 or len(mesh.vertices) <= vertices:
        return simplify(mesh, vertices)
    positions, faces, *_ = igl.decimate(mesh.vertices, mesh.faces, 2 * (vertices - mesh.euler))
    return Mesh(np.asarray(positions), np.asarray(faces, dtype=np.int64), mesh.name)
