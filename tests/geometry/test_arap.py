import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gensp.geometry.arap import ArapSystem, deformation_energy
from gensp.geometry.operators import adjacency

TURN = Rotation.from_rotvec([0.4, -1.1, 2.0]).as_matrix()


def directed_edge_energy(mesh):
    """Σ_i Σ_{j ∈ N_i} ‖p_i − p_j‖²."""
    edges = mesh.vertices[mesh.edges[:, 0]] - mesh.vertices[mesh.edges[:, 1]]
    return 2 * np.sum(edges**2)


def test_rigid_motion_costs_nothing(bumpy):
    moved = bumpy.vertices @ TURN.T + np.array([1.0, -2.0, 0.5])
    assert deformation_energy(bumpy.vertices, moved, bumpy.faces) < 1e-24


@pytest.mark.parametrize("s", [0.3, 1.7])
def test_scaling_costs_its_square_times_the_edge_energy(bumpy, s):
    energy = deformation_energy(bumpy.vertices, s * bumpy.vertices @ TURN.T, bumpy.faces)
    expected = (s - 1) ** 2 * directed_edge_energy(bumpy)
    np.testing.assert_allclose(energy, expected, rtol=1e-12)
    np.testing.assert_allclose(
        ArapSystem(bumpy, weights="uniform").edge_energy, directed_edge_energy(bumpy), rtol=1e-12
    )


def test_energy_equals_ring_by_ring_procrustes(ellipsoid, bumpy):
    p, q, graph = ellipsoid.vertices, bumpy.vertices, adjacency(ellipsoid.faces)
    expected = 0.0
    for i in range(len(p)):
        ring = graph.indices[graph.indptr[i] : graph.indptr[i + 1]]
        _, residual = Rotation.align_vectors(q[i] - q[ring], p[i] - p[ring])
        expected += residual**2
    np.testing.assert_allclose(deformation_energy(p, q, ellipsoid.faces), expected, rtol=1e-9)


def test_energy_does_not_depend_on_the_pose_of_either_mesh(ellipsoid, bumpy):
    energy = deformation_energy(ellipsoid.vertices, bumpy.vertices, bumpy.faces)
    turned = deformation_energy(ellipsoid.vertices @ TURN.T, bumpy.vertices + 3, bumpy.faces)
    np.testing.assert_allclose(turned, energy, rtol=1e-10)


@pytest.mark.parametrize("weights", ["cotangent", "uniform"])
def test_rotations_are_recovered(bumpy, weights):
    rotations = ArapSystem(bumpy, weights).rotations(bumpy.vertices @ TURN.T)
    np.testing.assert_allclose(rotations, np.broadcast_to(TURN, rotations.shape), atol=1e-11)


@pytest.mark.parametrize("collapse", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (-1, 1, 1), (1e-9, 1, 1)])
def test_rotations_are_proper_for_flat_collapsed_and_mirrored_shapes(bumpy, collapse):
    rotations = ArapSystem(bumpy).rotations(bumpy.vertices * np.array(collapse, dtype=float))
    np.testing.assert_allclose(np.linalg.det(rotations), 1, atol=1e-9)
    product = rotations @ rotations.transpose(0, 2, 1)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), product.shape), atol=1e-9)


@pytest.mark.parametrize("weights", ["cotangent", "uniform"])
def test_gradient_of_the_energy_is_four_times_the_residual(bumpy, weights, rng):
    system = ArapSystem(bumpy, weights)
    x = bumpy.vertices + 0.05 * rng.standard_normal((642, 3))
    direction = rng.standard_normal((642, 3))
    gradient = 4 * (system.laplacian @ x - system.rhs(system.rotations(x)))
    # By the envelope theorem the rotations need not be differentiated.
    difference = system.energy(x + 1e-6 * direction) - system.energy(x - 1e-6 * direction)
    np.testing.assert_allclose(difference / 2e-6, np.sum(gradient * direction), rtol=1e-6)


def test_rigid_pose_solves_the_linear_system(bumpy):
    system = ArapSystem(bumpy)
    pose = bumpy.vertices @ TURN.T
    residual = system.laplacian @ pose - system.rhs(system.rotations(pose))
    np.testing.assert_allclose(residual, 0, atol=1e-12)
