"""Surface point clouds: what the encoder sees of a shape, and random points of a surface."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from gensp.files import content_hash
from gensp.geometry.mesh import Mesh
from gensp.geometry.points import sample_surface
from gensp.geometry.sphere import sample_sphere


def point_cloud(mesh: Mesh, count: int, seed: int = 0) -> Float[np.ndarray, "count 3"]:
    """Area-uniform points of a normalised mesh in single precision.

    The draw depends on the mesh's content, on `count` and on `seed` alone, so training and
    inference see the same cloud of the same mesh.
    """
    key = content_hash(mesh.vertices, mesh.faces, count, seed)
    generator = np.random.default_rng(int(key, 16))
    points = sample_surface(mesh.face_areas, count, generator)
    return points.on(mesh.vertices, mesh.faces).astype(np.float32)


def point_clouds(mesh: Mesh, count: int, draws: int) -> Float[np.ndarray, "draws count 3"]:
    """Several independent clouds of a mesh; the mean of their codes is the code of the shape.

    A single cloud's code varies as much as those of different people's heads.
    """
    return np.stack([point_cloud(mesh, count, seed) for seed in range(draws)])


def sphere_cloud(count: int, seed: int = 0) -> Float[np.ndarray, "count 3"]:
    """The cloud of S_0: uniform points of the exact unit sphere."""
    generator = np.random.default_rng([count, seed])
    return sample_sphere(count, generator).astype(np.float32)


@dataclass(frozen=True)
class SurfaceSampler:
    """Area-uniform random points of one surface, drawn as float32 tensors.

    Both arrays may be mapped from a file: only what is drawn is read.
    """

    corners: Float[np.ndarray, "m 3 3"]
    cumulative: Float[np.ndarray, " m"]

    @classmethod
    def of(cls, mesh: Mesh) -> "SurfaceSampler":
        """Prepare a mesh for sampling."""
        corners = mesh.vertices[mesh.faces].astype(np.float32)
        return cls(corners, np.cumsum(mesh.face_areas) / mesh.area)

    def draw(self, count: int, generator: torch.Generator) -> Float[Tensor, "count 3"]:
        """Random points; equal generators give equal points."""
        face = self._faces(torch.rand(count, generator=generator, dtype=torch.float64).numpy())
        u, v = torch.rand((2, count), generator=generator)
        root = u.sqrt()
        weights = torch.stack([1 - root, root * (1 - v), root * v], dim=1)
        corners = torch.from_numpy(np.array(self.corners[face]))
        return torch.einsum("kj,kjc->kc", weights, corners)

    def _faces(self, level: Float[np.ndarray, " k"]) -> Int[np.ndarray, " k"]:
        face: np.ndarray = np.searchsorted(self.cumulative, level)
        return np.minimum(face, len(self.cumulative) - 1)
