"""DataModules of the learning stages: distance samples (II), correspondences (III-b and IV)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from jaxtyping import Float
from lightning import LightningDataModule
from torch import Tensor
from torch.utils.data import DataLoader

from gensp.compute import Workers, shared_out
from gensp.data.batches import (
    CorrespondenceDataset,
    EpochDataset,
    SdfDataset,
    epoch_loader,
)
from gensp.data.clouds import SurfaceSampler, point_clouds, sphere_cloud
from gensp.data.items import item_mesh, training_items
from gensp.data.modules import places
from gensp.data.sdf import SdfSampler, cached_samples, keep_samples, sample_path
from gensp.data.shapes import SPHERE
from gensp.errors import GenSPError, MissingData
from gensp.files import load_npz
from gensp.geometry.common_source import known_mean
from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere import icosphere, icosphere_of
from gensp.runs import Run

_SPHERE_LEVEL = 5


@dataclass(frozen=True)
class Batching:
    """How batches are drawn.

    Attributes
    ----------
    size
        Shapes in a batch over all ranks, S_0 included; accumulated gradients are those of as many
        times more.
    points
        Samples (II) or icosphere vertices (III-b, IV) of every shape.
    surface_points
        Area-uniform points of every shape (III-b, IV).
    passes
        How often one epoch goes through the items.
    cloud, draws
        Points of the encoder's cloud, and number of clouds drawn of every shape.
    """

    size: int = 16
    points: int = 1024
    surface_points: int = 0
    passes: int = 1
    cloud: int = 1024
    draws: int = 1


class FitModule(LightningDataModule):
    """Items held in memory; see `gensp.data.batches` for how batches are drawn.

    Attributes
    ----------
    ids
        All items of an epoch in fixed order, S_0 first.
    clouds
        Their encoder clouds in that order, several draws of each.
    """

    def __init__(self, meshes: Sequence[Mesh], *, batching: Batching, seed: int) -> None:
        super().__init__()
        self.meshes = list(meshes)
        self.ids = [SPHERE, *(mesh.name for mesh in meshes)]
        self.batching = batching
        self.seed = seed
        count, draws = batching.cloud, batching.draws
        sphere = np.stack([sphere_cloud(count, draw) for draw in range(draws)])
        clouds = [sphere, *(point_clouds(mesh, count, draws) for mesh in meshes)]
        self.clouds: Float[Tensor, "items s c 3"] = torch.from_numpy(np.stack(clouds))

    @cached_property
    def _loaded(self) -> EpochDataset[Any]:
        return self.dataset()

    def dataset(self) -> EpochDataset[Any]:
        """What the batches are drawn from."""
        raise NotImplementedError

    def train_dataloader(self) -> DataLoader[Any]:
        """The share of this rank of every epoch.

        K accumulated batches are one of K times the shapes, S_0 once, in K micro-batches.
        """
        rank, ranks, _ = places(self.trainer)
        micro = self.trainer.accumulate_grad_batches if self.trainer else 1
        size = self.batching.size * micro
        return epoch_loader(self._loaded, batch_size=size, micro=micro, rank=rank, ranks=ranks)


class SdfModule(FitModule):
    """Signed distance samples of input and augmented shapes (Stage II).

    Attributes
    ----------
    bound
        Half width of the cube that the uniform samples fill; it holds all shapes.
    """

    def __init__(
        self,
        meshes: Sequence[Mesh],
        *,
        batching: Batching,
        sampler: SdfSampler,
        cache: Path | str,
        seed: int = 0,
        workers: Workers | None = None,
    ) -> None:
        super().__init__(meshes, batching=batching, seed=seed)
        self.sampler = sampler
        self.cache = Path(cache) / "sdf"
        self.workers = workers or Workers()
        # The cache is seen by all machines, as the run folder is.
        self.prepare_data_per_node = False
        extent = max([1.0, *(float(np.abs(mesh.vertices).max()) for mesh in meshes)])
        self.bound = math.ceil(11 * extent) / 10

    @classmethod
    def from_runs(
        cls, inputs: Mapping[str, Run], folder: Path, *, augmented: bool, **settings: Any
    ) -> Self:
        """All training items of `augment`; without augmentation (No-DA) the inputs alone."""
        augment = inputs["augment"].folder
        items = training_items(augment, augmented)
        return cls([item_mesh(augment, item.id) for item in items], **settings)

    def prepare_data(self) -> None:
        """Fill the cache, on the first rank, with all workers.

        Raises
        ------
        GenSPError
            Workers die of a shape.
        """
        paths = {
            mesh.name: sample_path(mesh, self.sampler, self.bound, self.cache)
            for mesh in self.meshes
        }
        missing = {mesh.name: mesh for mesh in self.meshes if not paths[mesh.name].is_file()}
        done = shared_out(
            lambda id: partial(keep_samples, missing[id], self.sampler, self.bound, self.cache),
            list(missing),
            self.workers,
            found=lambda id: paths[id] if paths[id].is_file() else None,
            what=self.cache,
        )
        lost = [id for id, path in done if path is None]
        if lost:
            raise GenSPError(
                f"{', '.join(lost)}: a worker died of its distance samples, often for want of "
                "memory; lower recipe.implicit.sdf, or leave the shape out"
            )

    def dataset(self) -> SdfDataset:
        """Pools of samples, read from the cache."""
        pools = [self.sampler.of_sphere(self.bound)]
        pools += [
            cached_samples(mesh, self.sampler, self.bound, self.cache) for mesh in self.meshes
        ]
        return SdfDataset(
            self.ids,
            self.clouds,
            torch.from_numpy(np.stack([pool.points for pool in pools])),
            torch.from_numpy(np.stack([pool.distances for pool in pools])),
            count=self.batching.points,
            seed=self.seed,
            passes=self.batching.passes,
        )


class CorrespondenceModule(FitModule):
    """Where the icosphere's vertices belong on every shape (Stages III-b and IV)."""

    def __init__(
        self,
        meshes: Sequence[Mesh],
        targets: Float[np.ndarray, "i v 3"],
        valid: np.ndarray,
        *,
        batching: Batching,
        seed: int = 0,
    ) -> None:
        super().__init__(meshes, batching=batching, seed=seed)
        self.sphere = icosphere_of(targets.shape[1])
        self.targets = np.concatenate([self.sphere.vertices[None], targets]).astype(np.float32)
        self.valid = np.concatenate([np.ones_like(valid[:1]), valid])

    @classmethod
    def from_runs(cls, inputs: Mapping[str, Run], folder: Path, **settings: Any) -> Self:
        """All items to which `correspond` has carried the icosphere."""
        carried = inputs["correspond"].folder / "correspondences"
        files = [file for file in sorted(carried.glob("*.npz")) if file.stem != SPHERE]
        if not files:
            raise MissingData(
                f"{carried}: holds no correspondences; at least one shape is required; "
                "run stage=correspond again"
            )
        arrays = [load_npz(file) for file in files]
        augment = inputs["augment"].folder
        return cls(
            [item_mesh(augment, file.stem) for file in files],
            np.stack([entry["points"] for entry in arrays]),
            np.stack([entry["valid"].astype(bool) for entry in arrays]),
            **settings,
        )

    def mean_target(self, items: Sequence[int]) -> Float[Tensor, "v 3"]:
        """Mean place of the vertices over the items where it is known; elsewhere that on S_0."""
        mean = known_mean(self.targets[items], self.valid[items], self.targets[0])
        return torch.from_numpy(mean.astype(np.float32))

    def shared_surface(self, items: Sequence[int]) -> dict[str, np.ndarray]:
        """The icosphere on the given items, as the arrays of `models.atlas.Atlas`."""
        images = self.targets[items]
        return {
            "ids": np.array([self.ids[k] for k in items]),
            "sphere": self.sphere.vertices,
            "faces": self.sphere.faces,
            "images": images,
            # Whatever maps agree serve as guides: here they agree by construction.
            "maps": np.broadcast_to(self.sphere.vertices, images.shape),
        }

    def dataset(self) -> CorrespondenceDataset:
        """Targets of all icosphere vertices, and samplers of all surfaces."""
        ball = icosphere(_SPHERE_LEVEL)
        return CorrespondenceDataset(
            self.ids,
            self.clouds,
            torch.from_numpy(self.sphere.vertices.astype(np.float32)),
            torch.from_numpy(self.targets),
            torch.from_numpy(self.valid),
            [SurfaceSampler.of(mesh) for mesh in (ball, *self.meshes)],
            count=self.batching.points,
            surface_count=self.batching.surface_points,
            seed=self.seed,
            passes=self.batching.passes,
        )
