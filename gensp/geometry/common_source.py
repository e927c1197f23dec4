"""Registration from a source that many shapes share (ours, not in the paper).

An image of the icosphere that has come along a chain of registrations carries the bias of its own
chain. What the images of a collection have in common does not: registered from there to every
shape, they agree better with one another.
"""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool, Float, Int

from gensp.geometry.correspondence import Correspondence, closest_agreeing, correspondence
from gensp.geometry.mesh import Mesh


def known_mean(
    images: Float[np.ndarray, "k n 3"],
    valid: Bool[np.ndarray, "k n"],
    otherwise: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n 3"]:
    """Mean of every vertex over the images where it is known, and `otherwise` where in none."""
    return mean_of_blocks([(images, valid)], otherwise)


def mean_of_blocks(
    blocks: Iterable[tuple[Float[np.ndarray, "k n 3"], Bool[np.ndarray, "k n"]]],
    otherwise: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n 3"]:
    """`known_mean` of the images and their `valid` in blocks, of which one is held at a time.

    Sums over blocks are in double precision, whatever the images are.
    """
    total, count = np.zeros(otherwise.shape), np.zeros((len(otherwise), 1), dtype=np.int64)
    for images, valid in blocks:
        known = valid[..., None]
        total += np.where(known, images, 0).sum(axis=0)
        count += known.sum(axis=0)
    mean: np.ndarray = np.where(count > 0, total / np.maximum(count, 1), otherwise)
    return mean


def low_rank(
    images: Float[np.ndarray, "k n 3"], valid: Bool[np.ndarray, "k n"], rank: int
) -> Float[np.ndarray, "k n 3"]:
    """Every image reduced to the mean and `rank` principal modes of all; rank 0 is the mean.

    Vertices that are not valid in an image have no part in the mean and count as lying there.
    """
    mean = known_mean(images, valid, images.mean(axis=0))
    away = np.where(valid[..., None], images - mean, 0).reshape(len(images), -1)
    modes = np.linalg.svd(away, full_matrices=False)[2][:rank]
    return mean + (away @ modes.T @ modes).reshape(images.shape)


def placed(
    registered: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "f 3"], mesh: Mesh
) -> Correspondence:
    """The icosphere's vertices, registered to a mesh as they are, as points of that mesh."""
    normals = Mesh(registered, faces).vertex_normals
    return correspondence(closest_agreeing(registered, normals, mesh), mesh, faces)
