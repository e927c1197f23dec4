import numpy as np

from gensp.geometry.common_source import low_rank, placed
from gensp.geometry.distance import closest_point
from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere import icosphere


def test_images_of_few_modes_come_back_and_rank_zero_is_the_mean(rng: np.random.Generator) -> None:
    modes = rng.normal(size=(2, 42, 3))
    images = 1 + np.einsum("km,mnj->knj", rng.normal(size=(5, 2)), modes)
    valid = np.ones((5, 42), dtype=bool)
    np.testing.assert_allclose(low_rank(images, valid, 2), images, atol=1e-12)
    mean = np.broadcast_to(images.mean(axis=0), images.shape)
    np.testing.assert_allclose(low_rank(images, valid, 0), mean, atol=1e-12)
    # More modes never leave more out; five images have four modes.
    noisy = images + 0.1 * rng.normal(size=images.shape)
    left = [np.square(low_rank(noisy, valid, rank) - noisy).sum() for rank in range(5)]
    assert left == sorted(left, reverse=True)
    assert left[4] < 1e-9 < left[0]


def test_vertices_known_to_be_wrong_have_no_part(rng: np.random.Generator) -> None:
    images, valid = rng.normal(size=(5, 42, 3)), rng.random((5, 42)) < 0.7
    valid[:, 0] = False
    valid[0, 1:] = True
    spoilt = np.where(valid[..., None], images, 1e3)
    mean = low_rank(spoilt, valid, 0)[0]
    expected = [images[valid[:, k], k].mean(axis=0) for k in range(1, 42)]
    np.testing.assert_allclose(mean[1:], expected)
    np.testing.assert_array_equal(mean[0], [1e3, 1e3, 1e3])
    # With all modes the known vertices come back, and the others lie in the mean.
    back = np.where(valid[..., None], images, mean)
    np.testing.assert_allclose(low_rank(spoilt, valid, 5), back, atol=1e-9)


def test_registered_vertices_become_points_of_the_mesh(bumpy: Mesh) -> None:
    ball = icosphere(3)
    lifted = bumpy.vertices + 0.01 * bumpy.vertex_normals
    image = placed(lifted, ball.faces, bumpy)
    np.testing.assert_allclose(image.points, bumpy.vertices, atol=0.005)
    assert closest_point(image.points, bumpy).distance.max() < 1e-12
    assert image.valid.all()
    assert image.fold_rate == 0
