"""The arrays that batches are drawn from, each in a store named by what it was made of.

They are written one mesh at a time, so writing needs no more memory than drawing.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, overload

import numpy as np
from jaxtyping import Bool, Float, Int

from gensp.data.clouds import SurfaceSampler, point_clouds, sphere_cloud
from gensp.data.items import sphere_mesh
from gensp.data.mapped import MappedArray, stored, write_rows
from gensp.data.sdf import SdfSampler, SdfSamples, cached_samples
from gensp.files import content_hash
from gensp.geometry.mesh import Mesh

# Part of every store's name; raised when the same meshes and numbers are to give other arrays.
_VERSION = 1


@dataclass(frozen=True)
class Content:
    """What is remembered of a mesh that is not kept: its digest, extent and number of faces."""

    digest: str
    extent: float
    faces: int

    @classmethod
    def of(cls, mesh: Mesh) -> "Content":
        """Of a mesh in memory."""
        digest = content_hash(mesh.vertices, mesh.faces)
        return cls(digest, float(np.abs(mesh.vertices).max()), len(mesh.faces))


@dataclass(frozen=True)
class TrainingArrays:
    """Stores of arrays of some meshes below a folder, S_0 the first row of each.

    Every method returns what lies in the store, and writes it before where it is missing.

    Attributes
    ----------
    known
        Stores that were found whole, by kind; they are neither named nor checked again.
    """

    folder: Path
    meshes: Sequence[Mesh]
    contents: Sequence[Content]
    known: dict[str, dict[str, MappedArray]] = field(default_factory=dict)

    def _stored(
        self, kind: str, write: Callable[[Path], None], *numbers: Any
    ) -> dict[str, MappedArray]:
        if kind not in self.known:
            digests = [entry.digest for entry in self.contents]
            key = content_hash(_VERSION, digests, *numbers)
            self.known[kind] = stored(self.folder / kind, key, write)
        return self.known[kind]

    def clouds(self, count: int, draws: int) -> Float[MappedArray, "items s c 3"]:
        """Encoder clouds, several draws of each."""

        def blocks() -> Iterator[np.ndarray]:
            yield np.stack([sphere_cloud(count, draw) for draw in range(draws)])
            yield from (point_clouds(mesh, count, draws) for mesh in self.meshes)

        def write(folder: Path) -> None:
            shape = 1 + len(self.meshes), draws, count, 3
            write_rows(folder / "clouds.npy", blocks(), shape, np.float32)

        return self._stored("clouds", write, count, draws)["clouds"]

    def pools(
        self, sampler: SdfSampler, bound: float, cache: Path, sample: Callable[[], None]
    ) -> dict[str, MappedArray]:
        """`points` (items, s, 3) and `distances` (items, s), of the samples in a cache.

        `sample` fills that cache; it is called before anything is read from there.
        """
        shape = 1 + len(self.meshes), sampler.near + sampler.far + sampler.uniform

        def pools() -> Iterator[SdfSamples]:
            yield sampler.of_sphere(bound)
            yield from (cached_samples(mesh, sampler, bound, cache) for mesh in self.meshes)

        def write(folder: Path) -> None:
            sample()
            points = (pool.points for pool in pools())
            write_rows(folder / "points.npy", points, (*shape, 3), np.float32)
            distances = (pool.distances for pool in pools())
            write_rows(folder / "distances.npy", distances, shape, np.float32)

        return self._stored("samples", write, sampler.settings, bound)

    def images(
        self,
        sphere: Float[np.ndarray, "v 3"],
        targets: Iterable[Float[np.ndarray, "v 3"]],
        valid: Iterable[Bool[np.ndarray, " v"]],
    ) -> dict[str, MappedArray]:
        """`targets` (items, v, 3) of an icosphere's vertices, and which are `valid` (items, v)."""
        if "images" in self.known:
            return self.known["images"]
        shape = 1 + len(self.meshes), len(sphere)

        def write(folder: Path) -> None:
            places = itertools.chain([sphere], targets)
            write_rows(folder / "targets.npy", places, (*shape, 3), np.float32)
            known = itertools.chain([np.ones(shape[1], dtype=bool)], valid)
            write_rows(folder / "valid.npy", known, shape, bool)

        digests = [content_hash(*image) for image in zip(targets, valid, strict=True)]
        return self._stored("images", write, digests)

    def surfaces(self) -> "MappedSurfaces":
        """Samplers of the surfaces."""
        ball = sphere_mesh()
        faces = [len(ball.faces), *(entry.faces for entry in self.contents)]
        starts = np.concatenate([[0], np.cumsum(faces)])

        def samplers() -> Iterator[SurfaceSampler]:
            return map(SurfaceSampler.of, itertools.chain([ball], self.meshes))

        def write(folder: Path) -> None:
            corners = (sampler.corners for sampler in samplers())
            write_rows(folder / "corners.npy", corners, (starts[-1], 3, 3), np.float32)
            cumulative = (sampler.cumulative for sampler in samplers())
            write_rows(folder / "cumulative.npy", cumulative, (starts[-1],), np.float64)

        found = self._stored("surfaces", write)
        return MappedSurfaces(found["corners"], found["cumulative"], starts)


class MappedSurfaces(Sequence[SurfaceSampler]):
    """Samplers of surfaces that stay on disk.

    Parameters
    ----------
    corners, cumulative
        Those of all samplers, one after another.
    starts
        Where the triangles of every surface begin, and the end of the last.
    """

    def __init__(
        self, corners: MappedArray, cumulative: MappedArray, starts: Int[np.ndarray, " i"]
    ) -> None:
        self.corners, self.cumulative, self.starts = corners, cumulative, starts

    def __len__(self) -> int:
        return len(self.starts) - 1

    @overload
    def __getitem__(self, item: int) -> SurfaceSampler: ...
    @overload
    def __getitem__(self, item: slice) -> Sequence[SurfaceSampler]: ...
    def __getitem__(self, item: int | slice) -> SurfaceSampler | Sequence[SurfaceSampler]:
        """The sampler of one surface, or of several."""
        if isinstance(item, slice):
            return [self[k] for k in range(*item.indices(len(self)))]
        part = slice(int(self.starts[item]), int(self.starts[item + 1]))
        return SurfaceSampler(self.corners.mapped()[part], self.cumulative.mapped()[part])
