"""Registration from a source that many shapes share (ours, not in the paper).

An image of the icosphere that has come along a chain of registrations carries the bias of its own
chain. What the images of a collection have in common does not: registered from there to every
shape, they agree better with one another.
"""

import numpy as np
from jaxtyping import Float, Int

from gensp.geometry.correspondence import Correspondence, closest_agreeing, correspondence
from gensp.geometry.mesh import Mesh


def low_rank(images: Float[np.ndarray, "k n 3"], rank: int) -> Float[np.ndarray, "k n 3"]:
    """Every image reduced to the mean and `rank` principal modes of all; rank 0 is the mean."""
    flat = images.reshape(len(images), -1)
    mean = flat.mean(axis=0)
    modes = np.linalg.svd(flat - mean, full_matrices=False)[2][:rank]
    return (mean + (flat - mean) @ modes.T @ modes).reshape(images.shape)


def placed(
    registered: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "f 3"], mesh: Mesh
) -> Correspondence:
    """The icosphere's vertices, registered to a mesh as they are, as points of that mesh."""
    normals = Mesh(registered, faces).vertex_normals
    return correspondence(closest_agreeing(registered, normals, mesh), mesh, faces)
