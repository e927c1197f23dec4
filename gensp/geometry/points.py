"""Points of a triangulated surface, as face and barycentric coordinates."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True)
class SurfacePoints:
    """k points of a triangulation: face indices (k,) and barycentric weights (k, 3)."""

    faces: Int[np.ndarray, " k"]
    barycentric: Float[np.ndarray, "k 3"]

    def on(
        self, vertices: Float[np.ndarray, "n c"], faces: Int[np.ndarray, "m 3"]
    ) -> Float[np.ndarray, "k c"]:
        """Interpolate values given at the vertices (positions, colours, …)."""
        return np.einsum("kj,kjc->kc", self.barycentric, vertices[faces[self.faces]])

    def __len__(self) -> int:
        return len(self.faces)

    def take(self, index: np.ndarray) -> "SurfacePoints":
        """The points at `index` (integers or a mask)."""
        return SurfacePoints(self.faces[index], self.barycentric[index])


def sample_surface(
    face_areas: Float[np.ndarray, " m"], count: int, generator: np.random.Generator
) -> SurfacePoints:
    """Area-uniform random points of a triangulation with the given face areas."""
    faces = generator.choice(len(face_areas), size=count, p=face_areas / face_areas.sum())
    root, v = np.sqrt(generator.random(count)), generator.random(count)
    return SurfacePoints(faces, np.stack([1 - root, root * (1 - v), root * v], axis=1))
