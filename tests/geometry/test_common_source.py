import numpy as np

from gensp.geometry.common_source import low_rank, placed
from gensp.geometry.distance import closest_point
from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere import icosphere


def test_images_of_few_modes_come_back_and_rank_zero_is_the_mean(rng: np.random.Generator) -> None:
    modes = rng.normal(size=(2, 42, 3))
    images = 1 + np.einsum("km,mnj->knj", rng.normal(size=(5, 2)), modes)
    np.testing.assert_allclose(low_rank(images, 2), images, atol=1e-12)
    mean = np.broadcast_to(images.mean(axis=0), images.shape)
    np.testing.assert_allclose(low_rank(images, 0), mean, atol=1e-12)
    # More modes never leave more out; five images have four modes.
    noisy = images + 0.1 * rng.normal(size=images.shape)
    left = [np.square(low_rank(noisy, rank) - noisy).sum() for rank in range(5)]
    assert left == sorted(left, reverse=True)
    assert left[4] < 1e-9 < left[0]


def test_registered_vertices_become_points_of_the_mesh(bumpy: Mesh) -> None:
    ball = icosphere(3)
    lifted = bumpy.vertices + 0.01 * bumpy.vertex_normals
    image = placed(lifted, ball.faces, bumpy)
    np.testing.assert_allclose(image.points, bumpy.vertices, atol=0.005)
    assert closest_point(image.points, bumpy).distance.max() < 1e-12
    assert image.valid.all()
    assert image.fold_rate == 0
