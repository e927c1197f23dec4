"""A sound mesh of a solid whose own triangles degenerated: winding numbers decide what is inside.

Source of the inside test: Barill et al. 2018, "Fast winding numbers for soups and clouds".
"""

from typing import TYPE_CHECKING

import igl
import numpy as np

from gensp.errors import BadMesh, DegenerateMesh, EmptyLevelSet
from gensp.geometry.distance import ClosestPointTree
from gensp.geometry.folds import folded_faces
from gensp.geometry.mesh import Mesh, require_genus_zero, simplify

if TYPE_CHECKING:
    from torch import Tensor

# Marching cubes on cells of side h leaves about 1.5 area / h² vertices; three times as many as
# asked for are made, so that edge collapses can choose.
_VERTICES_PER_CELL = 1.5
_OVERSAMPLING = 3.0
# Second and third attempt: a finer grid, then a surface moved outwards by half a cell.
_ATTEMPTS = ((1.0, 0.0), (0.7, 0.0), (0.7, 0.5))
# Of the mean triangle area, after edge collapses have evened out the sizes.
_SMALLEST_AREA = 1e-4


def sound_mesh(
    mesh: Mesh, vertices: int, *, smallest_angle: float, unfolded: bool = True
) -> tuple[Mesh, bool]:
    """About `vertices` vertices of a shape, by edge collapses or, if need be, by remeshing.

    Edge collapses remove triangles that have shrunk, so the shape's own triangulation often
    survives; it is given up where a triangle without area, a fold or an angle below
    `smallest_angle` (degrees) is left. A crease that a scan itself has is no fault of it: with
    `unfolded=False` folds are not looked for, unless it has to be remeshed anyway.

    Returns
    -------
    Mesh, bool
        The mesh, and whether it was remeshed.

    Raises
    ------
    DegenerateMesh
        Neither way leads to a closed genus-0 surface without folds.
    """
    try:
        own = simplify(mesh, vertices)
        # Small inputs come back as they are, whatever their triangles.
        require_genus_zero(own, max_faces=len(own.faces))
    except BadMesh:
        return remesh_geometry(mesh, vertices=vertices), True
    level = own.face_areas.min() / own.face_areas.mean()
    shaped = level > _SMALLEST_AREA and smallest_triangle_angle(own) >= smallest_angle
    if shaped and not (unfolded and folded_faces(own).any()):
        return own, False
    return remesh_geometry(mesh, vertices=vertices), True


def smallest_triangle_angle(mesh: Mesh) -> float:
    """Smallest interior angle in degrees."""
    return float(np.degrees(igl.internal_angles(mesh.vertices, mesh.faces).min()))


def remesh_geometry(mesh: Mesh, *, vertices: int) -> Mesh:
    """Surface of the solid that a mesh encloses, as about `vertices` well-shaped triangles.

    Signed distances on a grid near the surface, marching cubes, largest component, edge
    collapses. Parts thinner than the grid (hairs that limbs shrink to) are left out. The grid's
    spacing follows from the area and the number of vertices.

    Raises
    ------
    DegenerateMesh
        No closed genus-0 surface without folds was found on any of the grids.
    """
    if not np.isfinite(mesh.vertices).all() or not mesh.area > 0:
        raise DegenerateMesh(
            f"{mesh.name}: positions are not finite or enclose no area; a solid is required"
        )
    spacing = float(np.sqrt(mesh.area * _VERTICES_PER_CELL / (_OVERSAMPLING * vertices)))
    tree, fault = ClosestPointTree(mesh), ""
    for finer, level in _ATTEMPTS:
        try:
            return _extract(tree, mesh.name, spacing * finer, level * spacing, vertices)
        except EmptyLevelSet as error:
            raise DegenerateMesh(
                f"{mesh.name}: encloses nothing that a grid of {spacing * finer:.3g} can see; a "
                "solid is required; ask for more vertices"
            ) from error
        except BadMesh as error:
            fault = str(error)
    raise DegenerateMesh(f"{mesh.name}: cannot be remeshed as a closed genus-0 surface: {fault}")


def _extract(
    tree: ClosestPointTree, name: str, spacing: float, level: float, vertices: int
) -> Mesh:
    # Most shapes keep their triangles, and torch takes seconds to load in every worker.
    import torch

    from gensp.geometry.isosurface import extract_surface

    def field(points: "Tensor") -> "Tensor":
        return torch.from_numpy(tree.signed_distance(points.numpy()) - level)

    margin = 2 * spacing + level
    corners = np.stack([tree.vertices.min(axis=0) - margin, tree.vertices.max(axis=0) + margin])
    surface = extract_surface(
        field,
        resolution=int(np.ceil(np.ptp(corners, axis=0).max() / spacing)),
        vertices=vertices,
        bounds=corners,
        dtype=torch.float64,
        name=name,
    )
    require_genus_zero(surface, max_faces=len(surface.faces))
    _require_no_folds(surface)
    return surface


def _require_no_folds(mesh: Mesh) -> None:
    folds = int(folded_faces(mesh).sum())
    if folds:
        raise DegenerateMesh(
            f"{mesh.name}: {folds} faces are folded over; none may be; ask for more vertices"
        )
