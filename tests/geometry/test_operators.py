import igl
import numpy as np

from gensp.geometry.mesh import Mesh
from gensp.geometry.operators import (
    FullMass,
    adjacency,
    clamped_laplacian,
    cotangent_laplacian,
    delaunay_laplacian,
    lumped_mass,
    weighted_laplacian,
)


def test_dirichlet_energy_of_coordinates_is_twice_the_area(bumpy):
    # Σ_c ∫‖∇x_c‖² over a surface is two per unit of area.
    laplacian = cotangent_laplacian(bumpy)
    energy = np.sum(bumpy.vertices * (laplacian @ bumpy.vertices))
    np.testing.assert_allclose(energy, 2 * bumpy.area, rtol=1e-12)


def test_laplacians_are_symmetric_semidefinite_with_constants_in_the_kernel(bumpy):
    for laplacian in (cotangent_laplacian(bumpy), clamped_laplacian(bumpy)):
        dense = laplacian.toarray()
        np.testing.assert_allclose(dense, dense.T, atol=1e-14)
        np.testing.assert_allclose(dense.sum(axis=1), 0, atol=1e-12)
        spectrum = np.linalg.eigvalsh(dense)
        assert spectrum[0] > -1e-12
        assert spectrum[1] > 1e-4


def test_clamped_weights_are_positive_where_triangles_are_obtuse(dumbbell):
    flat = Mesh(dumbbell.vertices * np.array([3.0, 1.0, 1.0]), dumbbell.faces)
    plain, clamped = cotangent_laplacian(flat).tocoo(), clamped_laplacian(flat).tocoo()
    assert (-plain.data[plain.row != plain.col]).min() < 0
    assert (-clamped.data[clamped.row != clamped.col]).min() > 0


def test_intrinsic_delaunay_weights_are_never_negative(dumbbell):
    flat = Mesh(dumbbell.vertices * np.array([3.0, 1.0, 1.0]), dumbbell.faces)
    intrinsic = delaunay_laplacian(flat)
    theirs = igl.intrinsic_delaunay_cotmatrix(flat.vertices, flat.faces)[0]
    assert abs(intrinsic + theirs).max() < 1e-9
    off = intrinsic.tocoo()
    assert (-off.data[off.row != off.col]).min() > -1e-12


def test_intrinsic_delaunay_ends_on_triangles_without_area(bumpy):
    vertices = bumpy.vertices.copy()
    vertices[bumpy.faces[0]] = vertices[bumpy.faces[0, 0]]
    a, b, c = bumpy.faces[700]
    vertices[a] = (vertices[b] + vertices[c]) / 2
    assert np.isfinite(delaunay_laplacian(bumpy.with_vertices(vertices)).data).all()


def test_weighted_laplacian_of_a_path():
    i, j = np.array([0, 1, 1, 2]), np.array([1, 0, 2, 1])
    laplacian = weighted_laplacian(i, j, np.array([2.0, 2.0, 3.0, 3.0]))
    np.testing.assert_array_equal(laplacian.toarray(), [[2, -2, 0], [-2, 5, -3], [0, -3, 3]])


def test_lumped_mass_equals_libigl_and_sums_to_the_area(bumpy):
    mass = lumped_mass(bumpy.vertices, bumpy.faces)
    theirs = igl.massmatrix(bumpy.vertices, bumpy.faces, igl.MASSMATRIX_TYPE_BARYCENTRIC)
    np.testing.assert_allclose(mass, theirs.diagonal(), rtol=1e-12)
    np.testing.assert_allclose(mass.sum(), bumpy.area, rtol=1e-12)


def test_full_mass_equals_libigl_wherever_the_vertices_are(bumpy, rng):
    mass = FullMass(bumpy.faces, len(bumpy.vertices))
    for vertices in (bumpy.vertices, bumpy.vertices + 0.1 * rng.standard_normal((642, 3))):
        theirs = igl.massmatrix(vertices, bumpy.faces, igl.MASSMATRIX_TYPE_FULL)
        np.testing.assert_allclose((mass(vertices, bumpy.faces) - theirs).toarray(), 0, atol=1e-15)


def test_adjacency_has_each_edge_in_both_directions(bumpy):
    graph = adjacency(bumpy.faces)
    assert graph.nnz == 2 * len(bumpy.edges)
    assert set(graph.data) == {1.0}
    assert (graph != graph.T).nnz == 0
