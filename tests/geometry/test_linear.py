import numpy as np
import pytest
import scipy.sparse as sp

from gensp.geometry import linear
from gensp.geometry.linear import SPDSolver, nested_dissection
from gensp.geometry.mesh import Mesh
from gensp.geometry.operators import adjacency, cotangent_laplacian, lumped_mass


def heat_matrix(mesh: Mesh, step: float) -> sp.csc_matrix:
    mass = sp.diags(lumped_mass(mesh.vertices, mesh.faces))
    return sp.csc_matrix(mass + step * cotangent_laplacian(mesh))


@pytest.fixture(params=["simplicial", "supernodal"])
def factor(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(linear, "SUPERNODAL_FROM", 0 if request.param == "supernodal" else 10**9)
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


def test_dissection_orders_every_vertex_once_and_saves_fill(bumpy):
    graph = adjacency(bumpy.faces)
    order = nested_dissection(graph, bumpy.vertices)
    assert sorted(order) == list(range(642))

    def fill(permutation: np.ndarray) -> int:
        matrix = (sp.eye(642) * 10 + graph).tocsc()[permutation][:, permutation]
        factor = sp.linalg.splu(matrix.tocsc(), permc_spec="NATURAL", diag_pivot_thresh=0.0)
        return int(factor.L.nnz)

    assert fill(order) < 0.5 * fill(np.random.default_rng(0).permutation(642))
