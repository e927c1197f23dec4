import numpy as np
import pytest

from gensp.errors import DegenerateMesh
from gensp.geometry.distance import hausdorff
from gensp.geometry.mesh import Mesh, require_genus_zero
from gensp.geometry.remesh import remesh_geometry, smallest_triangle_angle, sound_mesh
from gensp.geometry.sphere import icosphere


@pytest.fixture
def needle() -> Mesh:
    """A ball with a hair: one vertex drawn far out."""
    ball = icosphere(3)
    vertices = ball.vertices.copy()
    vertices[0] *= 3
    return Mesh(vertices, ball.faces, "needle")


def test_remeshed_sphere_is_a_sphere():
    mesh = remesh_geometry(icosphere(4), vertices=600)
    require_genus_zero(mesh)
    assert len(mesh.vertices) == 600
    assert hausdorff(mesh, icosphere(4)) < 0.03
    np.testing.assert_allclose(mesh.area, 4 * np.pi, rtol=0.01)


def test_folded_triangles_do_not_matter_where_the_solid_is_the_same():
    ball = icosphere(4)
    broken = ball.vertices.copy()
    # Neighbours change places: the faces around them fold, the shape hardly changes.
    first, second = ball.faces[0, :2]
    broken[[first, second]] = broken[[second, first]]
    mesh = remesh_geometry(Mesh(broken, ball.faces), vertices=600)
    assert hausdorff(mesh, ball) < 0.1
    assert smallest_triangle_angle(mesh) > 1


def test_hairs_are_left_out(needle):
    mesh = remesh_geometry(needle, vertices=600)
    require_genus_zero(mesh)
    assert np.linalg.norm(mesh.vertices, axis=1).max() < 2.5


def test_own_triangles_are_kept_where_they_are_sound(bumpy):
    mesh, remeshed = sound_mesh(bumpy, 300, smallest_angle=5.0)
    assert not remeshed
    assert len(mesh.vertices) == 300
    same, remeshed = sound_mesh(bumpy, 10_000, smallest_angle=5.0)
    assert not remeshed
    assert same is bumpy


def test_slivers_are_remeshed(bumpy):
    vertices = bumpy.vertices.copy()
    a, b, c = bumpy.faces[0]
    vertices[a] = 0.5 * (vertices[b] + vertices[c]) + 1e-6 * vertices[a]
    mesh, remeshed = sound_mesh(bumpy.with_vertices(vertices), 642, smallest_angle=0.5)
    assert remeshed
    assert smallest_triangle_angle(mesh) > 0.5


def test_triangles_without_area_are_remeshed(bumpy):
    vertices = bumpy.vertices.copy()
    vertices[bumpy.faces[0]] = vertices[bumpy.faces[0, 0]]
    broken = bumpy.with_vertices(vertices)
    # As many vertices as there are: edge collapses have nothing to do.
    mesh, remeshed = sound_mesh(broken, 642, smallest_angle=0.5)
    assert remeshed
    require_genus_zero(mesh)
    mesh, remeshed = sound_mesh(broken, 300, smallest_angle=0.5)
    assert not remeshed
    require_genus_zero(mesh)


@pytest.mark.parametrize("scale", [(np.nan, 1, 1), (0, 0, 0), (1, 1, 0)])
def test_what_encloses_nothing_is_an_error(bumpy, scale):
    flat = bumpy.with_vertices(bumpy.vertices * np.array(scale, dtype=float))
    with pytest.raises(DegenerateMesh, match="bumpy"):
        remesh_geometry(flat, vertices=300)


def test_smallest_angle_of_an_icosahedron():
    np.testing.assert_allclose(smallest_triangle_angle(icosphere(0)), 60)
