"""DataModules of the learning stages: distance samples (II), correspondences (III-b and IV)."""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gensp.compute import require_seen
from gensp.data.batches import CorrespondenceDataset, SdfDataset
from gensp.data.fitting import Batching, FitModule
from gensp.data.items import ItemMeshes, training_items
from gensp.data.mapped import Chosen, Entries, MappedArray
from gensp.data.sdf import SdfSampler, keep_samples, sample_path
from gensp.data.shapes import SPHERE
from gensp.errors import GenSPError, MissingData
from gensp.geometry.common_source import mean_of_blocks
from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere import icosphere_of
from gensp.layout import item_files
from gensp.runs import Run
from gensp.sharing import Workers, shared_out

_AT_ONCE = 2**23  # numbers that a mean reads at once


class SdfModule(FitModule):
    """Signed distance samples of input and augmented shapes (Stage II)."""

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
        super().__init__(meshes, batching=batching, seed=seed, cache=cache)
        self.sampler = sampler
        self.cache = Path(cache) / "sdf"
        self.workers = workers or Workers()

    @cached_property
    def bound(self) -> float:
        """Half width of the cube that the uniform samples fill; it holds all shapes."""
        extent = max([1.0, *(entry.extent for entry in self.arrays.contents)])
        return math.ceil(11 * extent) / 10

    @classmethod
    def from_runs(
        cls, inputs: Mapping[str, Run], folder: Path, *, augmented: bool, **settings: Any
    ) -> Self:
        """All training items of `augment`; without augmentation (No-DA) the inputs alone."""
        augment = inputs["augment"].folder
        items = training_items(augment, augmented)
        return cls(ItemMeshes(augment, [item.id for item in items]), **settings)

    def sample(self) -> None:
        """Fill the cache of samples with all workers.

        Raises
        ------
        GenSPError
            Workers die of a shape.
        """
        paths = {mesh.name: self._path(mesh) for mesh in self.meshes}
        missing = {id: k for k, (id, path) in enumerate(paths.items()) if not path.is_file()}
        done = shared_out(
            lambda id: partial(
                keep_samples, self.meshes[missing[id]], self.sampler, self.bound, self.cache
            ),
            list(missing),
            self.workers,
            found=lambda id: paths[id] if paths[id].is_file() else None,
            what=self.cache,
        )
        lost = []
        for id, path in done:
            if path is None:
                lost.append(id)
            else:
                require_seen(paths[id], self.cache)
        if lost:
            raise GenSPError(
                f"{', '.join(lost)}: a worker died of its distance samples, often for want of "
                "memory; lower recipe.implicit.sdf, or leave the shape out"
            )

    def _path(self, mesh: Mesh) -> Path:
        return sample_path(mesh, self.sampler, self.bound, self.cache)

    def dataset(self) -> SdfDataset:
        """Pools of samples, made of those in the cache."""
        pools = self.arrays.pools(self.sampler, self.bound, self.cache, self.sample)
        return SdfDataset(
            self.ids,
            self.clouds,
            pools["points"],
            pools["distances"],
            count=self.batching.points,
            seed=self.seed,
            passes=self.batching.passes,
        )


class CorrespondenceModule(FitModule):
    """Where the icosphere's vertices belong on every shape (Stages III-b and IV)."""

    def __init__(
        self,
        meshes: Sequence[Mesh],
        targets: Sequence[Float[np.ndarray, "v 3"]] | Float[np.ndarray, "i v 3"],
        valid: Sequence[Bool[np.ndarray, " v"]] | Bool[np.ndarray, "i v"],
        *,
        batching: Batching,
        seed: int = 0,
        store: Path | str | None = None,
    ) -> None:
        super().__init__(meshes, batching=batching, seed=seed, cache=store)
        self.sphere = icosphere_of(len(targets[0]))
        self.carried = targets, valid

    @classmethod
    def from_runs(cls, inputs: Mapping[str, Run], folder: Path, **settings: Any) -> Self:
        """All items to which `correspond` has carried the icosphere."""
        folder = inputs["correspond"].folder
        carried = item_files(folder, "correspondences", ".npz")
        files = [file for file in carried if file.stem != SPHERE]
        if not files:
            raise MissingData(
                f"{folder / 'correspondences'}: holds no correspondences; at least one shape is "
                "required; run stage=correspond again"
            )
        meshes = ItemMeshes(inputs["augment"].folder, [file.stem for file in files])
        return cls(meshes, Entries(files, "points"), Entries(files, "valid"), **settings)

    @cached_property
    def _images(self) -> dict[str, MappedArray]:
        return self.arrays.images(self.sphere.vertices, *self.carried)

    @property
    def targets(self) -> Float[MappedArray, "items v 3"]:
        """Where the vertices belong on every item."""
        return self._images["targets"]

    @property
    def valid(self) -> Bool[MappedArray, "items v"]:
        """Where that is known."""
        return self._images["valid"]

    def mean_target(self, items: Sequence[int]) -> Float[Tensor, "v 3"]:
        """Mean place of the vertices over the items where it is known; elsewhere that on S_0."""
        targets, valid = self.targets.mapped(), self.valid.mapped()
        step = max(1, _AT_ONCE // targets[0].size)
        parts = [items[k : k + step] for k in range(0, len(items), step)]
        mean = mean_of_blocks(((targets[part], valid[part]) for part in parts), targets[0])
        return torch.from_numpy(mean.astype(np.float32))

    def shared_surface(self, items: Sequence[int]) -> dict[str, Any]:
        """The icosphere on the given items, as the arrays of `models.atlas.Atlas`.

        The images are read for those items alone that are asked of them.
        """
        # Whatever maps agree serve as guides: here they agree by construction.
        maps = np.broadcast_to(self.sphere.vertices, (len(items), *self.sphere.vertices.shape))
        return {
            "ids": np.array([self.ids[k] for k in items]),
            "sphere": self.sphere.vertices,
            "faces": self.sphere.faces,
            "images": Chosen(self.targets, items),
            "maps": maps,
        }

    def dataset(self) -> CorrespondenceDataset:
        """Targets of all icosphere vertices, and samplers of all surfaces."""
        return CorrespondenceDataset(
            self.ids,
            self.clouds,
            torch.from_numpy(self.sphere.vertices.astype(np.float32)),
            self.targets,
            self.valid,
            self.arrays.surfaces(),
            count=self.batching.points,
            surface_count=self.batching.surface_points,
            seed=self.seed,
            passes=self.batching.passes,
        )
