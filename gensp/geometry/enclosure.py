"""What a mesh encloses, whatever its faces look like: a flood from the corner of a grid.

Nodes further than half a cell from every triangle are free. Of two neighbours on either side of a
triangle one is nearer, so the flood over free nodes passes no wall, however thin, turned or
doubled, and no crack narrower than a cell. Nodes at a wall belong to the side from which a grid
edge reaches them without meeting a triangle.
"""

from dataclasses import dataclass, replace

import igl
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from torch import Tensor

from gensp.compiled.crossings import crossed_edges
from gensp.geometry.distance import ClosestPoints, ClosestPointTree
from gensp.geometry.isosurface import Grid, sampled
from gensp.geometry.mesh import Mesh
from gensp.geometry.repair import repair

INSIDE, UNKNOWN, OUTSIDE = -1, 0, 1
# Cells.
_ON, _WALL, _SEEN, _NEAR = 0.05, 0.5, 1.5, 2.5
_THICKNESS = 3**0.5 / 2  # of what is thinner than a cell, to either side: any such ball has a node
_CLEAR = 0.2  # share of the votes by which one side of a patch is the outer one
_BLOCK = np.ones((3, 3, 3), dtype=bool)


@dataclass(frozen=True)
class Enclosure:
    """The inside of a mesh on a grid.

    Attributes
    ----------
    side
        INSIDE or OUTSIDE for every node where the flood decides; UNKNOWN where winding numbers do.
    thin
        Cells around parts that no node lies in, and those that were `thickened`.
    thick
        Cells near an inner node that is free.
    seen
        Points of the mesh that are seen from outside.
    """

    grid: Grid
    tree: ClosestPointTree
    winding: igl.FastWindingNumberBVH
    side: Int[np.ndarray, "a b c"]
    thin: Bool[np.ndarray, "u v w"]
    thick: Bool[np.ndarray, "u v w"]
    seen: Float[np.ndarray, "k 3"]

    def field(self, points: Float[np.ndarray, "k 3"], sheet: float) -> Float[np.ndarray, " k"]:
        """Distances, negative inside; thin parts are thickened.

        Across a hole winding numbers carry the surface on; they place it up to `sheet` away.
        """
        found = self.tree.query(points)
        side = self.side[tuple(self.grid.nearest(points).T)]
        out = np.where(side == UNKNOWN, 0.5 - _numbers(self.winding, points), side / 2)
        # Near the surface the distance is smaller, in the middle of a hole the other is.
        free = (side == UNKNOWN) & np.isfinite(sheet)
        near = np.where(free, sheet * np.abs(out), np.inf) if free.any() else np.inf
        signed = np.sign(out) * np.minimum(found.distance, near)
        grown = found.distance - _THICKNESS * self.grid.cell
        thin = self.thin[tuple(self.grid.cells_of(found.points).T)]
        return np.where(thin, np.minimum(signed, grown), signed)

    def thickened(self, lost: Float[np.ndarray, "k 3"]) -> "Enclosure":
        """The same with parts thickened that were lost at these points, where they are thin."""
        more = np.zeros_like(self.thin)
        more[tuple(self.grid.cells_of(lost).T)] = True
        return replace(self, thin=self.thin | _around(more & ~self.thick))


@dataclass(frozen=True)
class _Nodes:
    """Nodes near a mesh: indices, places, closest points, whether they are free and flooded."""

    at: tuple[Int[np.ndarray, " k"], ...]
    points: Float[np.ndarray, "k 3"]
    found: ClosestPoints
    free: Bool[np.ndarray, " k"]
    flooded: Bool[np.ndarray, " k"]


def enclosure(mesh: Mesh, grid: Grid) -> Enclosure:
    """Flood a grid around a mesh, and take winding numbers where they tell the same.

    Parameters
    ----------
    mesh
        Finite vertices and valid faces with an area; nothing else is required.
    grid
        Two cells or more wider than the mesh on every side.
    """
    mesh, patch = _patches(mesh)
    tree = ClosestPointTree(mesh)
    distance = _distances(tree, grid)
    free = distance > _WALL * grid.cell
    label, _ = ndimage.label(free)
    flooded = label == label[0, 0, 0]
    nodes = _near(tree, grid, distance, free, flooded)
    winding = igl.FastWindingNumberBVH()
    winding.init(mesh.vertices, _outward(mesh, patch, nodes), 2)
    full = _numbers(winding, nodes.points) > 0.5
    side = np.full(free.shape, UNKNOWN, dtype=np.int8)
    if (full == nodes.flooded)[nodes.free].any():  # cavities, holes, patches without neighbours
        crossed = crossed_edges((mesh.vertices - grid.lower)[mesh.faces] / grid.cell, free.shape)
        side = _sides(free, flooded, nodes.at, full, crossed)
    inside = np.where(side[nodes.at] == UNKNOWN, full, side[nodes.at] == INSIDE)
    clear = nodes.free & nodes.flooded & ~inside & (nodes.found.distance < _SEEN * grid.cell)
    distance = nodes.found.distance
    touched = np.zeros(grid.cells, dtype=bool)
    touched[tuple(grid.cells_of(nodes.found.points[distance < grid.cell]).T)] = True
    held = _beside(grid, nodes.at, inside & (distance > _ON * grid.cell))
    thick = _beside(grid, nodes.at, inside & nodes.free)
    thin = _around(touched & ~held)
    return Enclosure(grid, tree, winding, side, thin, thick, nodes.found.points[clear])


def _numbers(
    winding: igl.FastWindingNumberBVH, points: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, " k"]:
    return winding.winding_number(np.ascontiguousarray(points)).reshape(-1)


def _patches(mesh: Mesh) -> tuple[Mesh, Int[np.ndarray, " m"]]:
    """Every triangle once, turned like its neighbours, and its patch."""
    mesh = repair(mesh, steps=("unused", "merge")).mesh
    _, first = np.unique(np.sort(mesh.faces, axis=1), axis=0, return_index=True)
    mesh = Mesh(mesh.vertices, mesh.faces[np.sort(first)], mesh.name)
    faces, patch = igl.bfs_orient(mesh.faces)
    turned = Mesh(mesh.vertices, np.asarray(faces, dtype=np.int64), mesh.name)
    return turned, np.asarray(patch, dtype=np.int64).reshape(-1)


def _distances(tree: ClosestPointTree, grid: Grid) -> Float[np.ndarray, "a b c"]:
    def unsigned(points: Tensor) -> Tensor:
        return torch.from_numpy(tree.query(points.numpy()).distance)

    return sampled(unsigned, grid)


def _near(
    tree: ClosestPointTree,
    grid: Grid,
    distance: Float[np.ndarray, "a b c"],
    free: Bool[np.ndarray, "a b c"],
    flooded: Bool[np.ndarray, "a b c"],
) -> _Nodes:
    at = np.nonzero(distance < _NEAR * grid.cell)
    points = grid.points(np.stack(at, axis=1))
    return _Nodes(at, points, tree.query(points), free[at], flooded[at])


def _outward(mesh: Mesh, patch: Int[np.ndarray, " m"], nodes: _Nodes) -> Int[np.ndarray, "m 3"]:
    """The faces, every patch with the side outwards on which more of the flood is."""
    seen = nodes.free & nodes.flooded
    face = nodes.found.at.faces[seen]
    away = nodes.points[seen] - nodes.found.points[seen]
    vote = np.sign(np.einsum("kj,kj->k", away, mesh.face_normals[face]))
    count = patch.max() + 1
    votes = np.bincount(patch[face], weights=vote, minlength=count)
    total = np.bincount(patch[face], minlength=count)
    # A shell with a hole is flooded on both sides: its hollow side is the inner one.
    volume = np.bincount(patch, weights=_volumes(mesh, patch), minlength=count)
    wrong = np.where(np.abs(votes) > _CLEAR * total, votes < 0, volume < 0)
    return np.where(wrong[patch][:, None], mesh.faces[:, ::-1], mesh.faces)


def _volumes(mesh: Mesh, patch: Int[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """Volume of the cone from the centre of its patch to each face."""
    corners = mesh.vertices[mesh.faces]
    size = np.bincount(patch, weights=mesh.face_areas)
    moment = mesh.face_areas[:, None] * corners.mean(axis=1)
    total = np.stack([np.bincount(patch, weights=moment[:, k]) for k in range(3)], axis=1)
    centre = total / np.where(size > 0, size, 1)[:, None]
    return np.linalg.det(corners - centre[patch][:, None]) / 6


def _sides(
    free: Bool[np.ndarray, "a b c"],
    flooded: Bool[np.ndarray, "a b c"],
    near: tuple[Int[np.ndarray, " k"], ...],
    full: Bool[np.ndarray, " k"],
    crossed: Bool[np.ndarray, "3 a b c"],
) -> Int[np.ndarray, "a b c"]:
    """The side of every node but the flooded ones, of which winding numbers may fill some.

    Both sides spread from free nodes to walls along edges that meet no triangle, a node at a
    time, so that neither comes far through a crack. What neither reaches is within a wall.
    """
    known = np.where(free, np.where(flooded, OUTSIDE, INSIDE), UNKNOWN).astype(np.int8)
    known[near] = np.where(free[near] & full, INSIDE, known[near])
    while (found := _spread(known, crossed)).any():
        known += found
    return np.where(free & flooded, UNKNOWN, np.where(known == UNKNOWN, INSIDE, known))


def _spread(
    known: Int[np.ndarray, "a b c"], crossed: Bool[np.ndarray, "3 a b c"]
) -> Int[np.ndarray, "a b c"]:
    """Sides that nodes of unknown side take from their neighbours; INSIDE where both come."""
    found = np.zeros_like(known)
    for axis in range(3):
        first = (slice(None),) * axis + (slice(None, -1),)
        second = (slice(None),) * axis + (slice(1, None),)
        for here, there in ((first, second), (second, first)):
            new = np.where(crossed[axis][first] | (known[here] != UNKNOWN), UNKNOWN, known[there])
            found[here] = np.where(found[here] == INSIDE, INSIDE, np.where(new, new, found[here]))
    return found


def _beside(
    grid: Grid, at: tuple[Int[np.ndarray, " k"], ...], marked: Bool[np.ndarray, " k"]
) -> Bool[np.ndarray, "u v w"]:
    """Cells no further than a cell from a marked node."""
    nodes = np.zeros(tuple(count + 1 for count in grid.cells), dtype=bool)
    nodes[at] = marked
    for axis in range(3):
        nodes = np.delete(nodes, -1, axis) | np.delete(nodes, 0, axis)
    return ndimage.binary_dilation(nodes, _BLOCK)


def _around(cells: Bool[np.ndarray, "u v w"]) -> Bool[np.ndarray, "u v w"]:
    """Cells and those two from them: they overlap with what is there, so that parts hold on."""
    return ndimage.binary_dilation(cells, _BLOCK, iterations=2) if cells.any() else cells
