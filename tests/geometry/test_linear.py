import numpy as np
import pytest
import scipy.sparse as sp

from gensp.geometry import linear
from gensp.geometry.dissection import nested_dissection
from gensp.geometry.linear import SPDSolver
from gensp.geometry.mesh import Mesh
from gensp.geometry.operators import adjacency, cotangent_laplacian, lumped_mass


def heat_matrix(mesh: Mesh, step: float) -> sp.csc_matrix:
    mass = sp.diags(lumped_mass(mesh.vertices, mesh.faces))
    return sp.csc_matrix(mass + step * cotangent_laplacian(mesh))


@pytest.fixture(params=["simplicial", "multifrontal"])
def factor(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(
        linear, "MULTIFRONTAL_FROM", 0 if request.param == "multifrontal" else 10**9
    )
    return request.param


@pytest.mark.parametrize("ordered", [True, False])
def test_solution_equals_dense_solve(factor, ordered, bumpy, rng):
    matrix = heat_matrix(bumpy, 0.3)
    solver = SPDSolver(matrix, bumpy.vertices if ordered else None)
    for rhs in (rng.standard_normal(642), rng.standard_normal((642, 3))):
        expected = np.linalg.solve(matrix.toarray(), rhs)
        np.testing.assert_allclose(solver.solve(rhs), expected, atol=1e-10)


def test_refactored_values_are_used(factor, bumpy, rng):
    solver = SPDSolver(heat_matrix(bumpy, 0.3), bumpy.vertices)
    other = heat_matrix(bumpy, 7.0)
    solver.refactor(other)
    rhs = rng.standard_normal((642, 2))
    np.testing.assert_allclose(other @ solver.solve(rhs), rhs, atol=1e-10)


def test_two_unknowns_at_every_vertex(factor, bumpy, rng):
    graph = adjacency(bumpy.faces)
    blocks = sp.kron(graph, rng.standard_normal((2, 2)))
    matrix = blocks + blocks.T
    matrix = sp.csc_matrix(matrix + sp.diags(np.abs(matrix).sum(axis=1).A1 + 1))
    rhs = rng.standard_normal(2 * 642)
    solution = SPDSolver(matrix, bumpy.vertices).solve(rhs)
    np.testing.assert_allclose(solution, np.linalg.solve(matrix.toarray(), rhs), atol=1e-10)


def test_another_pattern_is_refused(factor, bumpy):
    solver = SPDSolver(heat_matrix(bumpy, 0.3), bumpy.vertices)
    with pytest.raises(ValueError, match="pattern"):
        solver.refactor(sp.eye(642, format="csc"))


def test_values_that_are_not_finite_are_refused(factor, bumpy):
    matrix = heat_matrix(bumpy, 0.3)
    solver = SPDSolver(matrix, bumpy.vertices)
    matrix.data[5] = np.nan
    with pytest.raises(np.linalg.LinAlgError, match="finite"):
        solver.refactor(matrix)
    with pytest.raises(np.linalg.LinAlgError, match="finite"):
        SPDSolver(matrix, bumpy.vertices)


def test_a_zero_matrix_cannot_be_solved(factor, bumpy):
    matrix = heat_matrix(bumpy, 0.3)
    matrix.data[:] = 0
    with pytest.raises(np.linalg.LinAlgError):
        SPDSolver(matrix, bumpy.vertices).solve(np.ones(642))


def test_an_indefinite_matrix_is_refused(bumpy, monkeypatch):
    monkeypatch.setattr(linear, "MULTIFRONTAL_FROM", 0)
    matrix = heat_matrix(bumpy, 0.3)
    matrix[100, 100] = -1.0
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        SPDSolver(matrix, bumpy.vertices)


def test_parts_that_do_not_touch_are_solved_apart(factor, bumpy, rng):
    matrix = sp.block_diag([heat_matrix(bumpy, 0.3)] * 2, format="csc")
    points = np.concatenate([bumpy.vertices, bumpy.vertices + 9])
    rhs = rng.standard_normal(2 * 642)
    solution = SPDSolver(matrix, points).solve(rhs)
    np.testing.assert_allclose(matrix @ solution, rhs, atol=1e-10)


def test_dissection_takes_every_vertex_once_and_children_first(bumpy):
    graph = adjacency(bumpy.faces)
    parts = nested_dissection(graph, bumpy.vertices)
    order = np.concatenate([part.vertices for part in parts])
    assert sorted(order) == list(range(642))
    handed_on = [child for part in parts for child in part.children]
    assert sorted(handed_on) == list(range(len(parts) - 1))
    assert all(child < place for place, part in enumerate(parts) for child in part.children)


def test_dissection_saves_fill(bumpy):
    graph = adjacency(bumpy.faces)
    order = np.concatenate([p.vertices for p in nested_dissection(graph, bumpy.vertices)])

    def fill(permutation: np.ndarray) -> int:
        matrix = (sp.eye(642) * 10 + graph).tocsc()[permutation][:, permutation]
        factor = sp.linalg.splu(matrix.tocsc(), permc_spec="NATURAL", diag_pivot_thresh=0.0)
        return int(factor.L.nnz)

    assert fill(order) < 0.5 * fill(np.random.default_rng(0).permutation(642))
