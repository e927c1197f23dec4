"""Signed distance samples of closed surfaces, made once per mesh and kept in a cache."""

import warnings
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gensp.errors import DamagedFile
from gensp.files import content_hash, load_npz, save_npz
from gensp.geometry.distance import signed_distance
from gensp.geometry.mesh import Mesh
from gensp.geometry.points import sample_surface
from gensp.geometry.sphere import sample_sphere
from gensp.geometry.thickness import medial_ball_radii
from gensp.layout import keyed_path

_DENSEST = 10.0


@dataclass(frozen=True)
class SdfSamples:
    """k points around one surface and their signed distances, negative inside."""

    points: Float[np.ndarray, "k 3"]
    distances: Float[np.ndarray, " k"]


@dataclass(frozen=True)
class SdfSampler:
    """How many samples are taken where, for surfaces of area 4π.

    Attributes
    ----------
    near, near_deviation
        Samples close to the surface: points of it moved by Gaussian noise.
    far, far_deviation
        The same at a larger distance.
    uniform
        Uniform samples of the cube [-bound, bound]³.
    thinness
        Points of the surface are drawn with density (R/r)^thinness, where r is the radius of the
        largest ball that touches it there from inside, and R its median; 0: uniformly.
    """

    near: int = 1500
    near_deviation: float = 0.02
    far: int = 1500
    far_deviation: float = 0.1
    uniform: int = 1500
    thinness: float = 0.0
    seed: int = 0

    def __call__(self, mesh: Mesh, bound: float) -> SdfSamples:
        """Sample a mesh; the draw depends on its content alone."""
        generator = np.random.default_rng(int(self.key(mesh, bound), 16))
        on_surface = sample_surface(self._weights(mesh), self.near + self.far, generator)
        points = self._around(on_surface.on(mesh.vertices, mesh.faces), bound, generator)
        distances = signed_distance(points.astype(np.float64), mesh)
        return SdfSamples(points, distances.astype(np.float32))

    def _weights(self, mesh: Mesh) -> Float[np.ndarray, " m"]:
        if not self.thinness:
            return mesh.face_areas
        radii = medial_ball_radii(mesh)[mesh.faces].mean(axis=1)
        # Creases have balls as small as their triangles: no place takes all samples.
        relative = np.clip(np.median(radii) / radii, 1 / _DENSEST, _DENSEST)
        return mesh.face_areas * relative**self.thinness

    def of_sphere(self, bound: float) -> SdfSamples:
        """The same of S_0, with its exact distance |x| - 1."""
        generator = np.random.default_rng(self.seed)
        points = self._around(sample_sphere(self.near + self.far, generator), bound, generator)
        distances = np.linalg.norm(points.astype(np.float64), axis=1) - 1
        return SdfSamples(points, distances.astype(np.float32))

    def _around(
        self, surface: Float[np.ndarray, "k 3"], bound: float, generator: np.random.Generator
    ) -> Float[np.ndarray, "s 3"]:
        deviation = np.repeat([self.near_deviation, self.far_deviation], [self.near, self.far])
        around = surface + deviation[:, None] * generator.standard_normal(surface.shape)
        anywhere = generator.uniform(-bound, bound, (self.uniform, 3))
        # Rounded first, so that the stored distance is that of the stored point.
        return np.concatenate([around, anywhere]).astype(np.float32)

    @property
    def settings(self) -> dict[str, float]:
        """What decides a draw; without `thinness` while it is 0, as before there was one."""
        return {name: value for name, value in asdict(self).items() if name != "thinness" or value}

    def key(self, mesh: Mesh, bound: float) -> str:
        """Name of the samples in a cache: the mesh's content and these settings."""
        return content_hash(mesh.vertices, mesh.faces, self.settings, bound)


def sample_path(mesh: Mesh, sampler: SdfSampler, bound: float, cache: Path) -> Path:
    """Where the samples of a mesh are kept."""
    return keyed_path(cache, sampler.key(mesh, bound), ".npz")


def cached_samples(mesh: Mesh, sampler: SdfSampler, bound: float, cache: Path) -> SdfSamples:
    """Samples from `cache`, computed and stored where they are missing or damaged."""
    path = sample_path(mesh, sampler, bound, cache)
    if path.is_file():
        samples = _read(path)
        if samples is not None:
            return samples
        warnings.warn(f"{path}: damaged; {mesh.name} is sampled again", stacklevel=2)
    samples = sampler(mesh, bound)
    digest = content_hash(samples.points, samples.distances)
    save_npz(path, points=samples.points, distances=samples.distances, digest=np.array(digest))
    return samples


def keep_samples(mesh: Mesh, sampler: SdfSampler, bound: float, cache: Path) -> Path:
    """What `cached_samples` does, for a worker, which need not send the samples back."""
    cached_samples(mesh, sampler, bound, cache)
    return sample_path(mesh, sampler, bound, cache)


def _read(path: Path) -> SdfSamples | None:
    """Stored samples, or nothing where the file is not what was written."""
    try:
        arrays = load_npz(path)
        samples = SdfSamples(arrays["points"], arrays["distances"])
        stored = str(arrays["digest"])
    except (OSError, KeyError, DamagedFile):
        return None
    return samples if stored == content_hash(samples.points, samples.distances) else None
