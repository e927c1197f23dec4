"""Stages III-b and IV: the shape generator, from correspondences to surfaces (paper §4.3–4.4)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor

from gensp.data.batches import CorrespondenceBatch
from gensp.data.items import item_mesh, sphere_mesh
from gensp.data.shapes import SPHERE
from gensp.files import load_npz, read_json
from gensp.geometry.distance import ClosestPointTree
from gensp.geometry.shared_sphere import place_for_all
from gensp.geometry.sphere import icosphere
from gensp.losses import correspondence_loss, coverage_loss, generator_deformation, surface_loss
from gensp.models import Atlas, Generator, PointNet2Encoder, jacobian, load_model, save_model
from gensp.runs import Run
from gensp.stages.base import FitStage
from gensp.stages.latents import CloudCodes, CodeTable, draws, save_codes
from gensp.stages.speed import single_precision
from gensp.tasks.correspond import is_input
from gensp.tasks.pairing import SHARED


class GeneratorStage(FitStage):
    """What both stages share: the networks, the codes of all items, and what is written.

    `shared` are the arrays of the shared surface, where Stage III-a made one; of `kept_shapes`
    inputs at most the model keeps it. Where it made none, the model keeps the icosphere, and how
    maps are to be placed (`placement`, of `geometry.shared_sphere.place_for_all`; None: not).
    """

    def __init__(
        self,
        *,
        encoder: PointNet2Encoder,
        generator: Generator,
        learning_rate: float,
        shared: Mapping[str, np.ndarray] | None = None,
        kept_shapes: int = 100,
        placement: Mapping[str, Any] | None = None,
        seed: int = 0,
        folder: Path | str = Path("."),
    ) -> None:
        super().__init__(learning_rate=learning_rate, seed=seed, folder=folder)
        self.shared, self.kept_shapes, self.placement = shared, kept_shapes, placement
        self.encoder = encoder.train().requires_grad_(False)
        self.generator = generator.train()
        self.encode = CloudCodes(encoder, self.folder)

    def setup(self, stage: str) -> None:
        """Encode all items once."""
        items = self.trainer.datamodule
        self.table = CodeTable(items.ids, self.encoder.latent).to(self.encoder.origin.device)
        self.table.update(items.ids, self.encode.all(items.ids, items.clouds))

    def correspondence(self, codes: Tensor, batch: CorrespondenceBatch) -> Tensor:
        """Eq. 10 over the shapes that count in this part of a step's batch, with its weight."""
        mine = slice(batch.first, None)
        generated = self.fast(self.generator)(codes[mine], batch.sphere[mine]).float()
        loss = correspondence_loss(generated, batch.targets[mine], batch.valid[mine])
        return batch.known_weight * loss

    def _inputs(self) -> list[int]:
        """Rows of the input shapes in the table."""
        return [k for id, k in self.table.rows.items() if is_input(id)]

    def finish(self) -> dict[str, float]:
        """Put S_0 exactly at the origin; write the networks and the codes of all items."""
        items = self.trainer.datamodule
        self.encoder.set_origin(items.clouds[0].to(self.encoder.origin.device))
        codes = self.encode.all(items.ids, items.clouds)
        save_codes(self.folder / "latents.npz", items.ids, codes)
        self.generator.mean_code.copy_(codes[self._inputs()].mean(dim=0))
        networks = {"encoder": self.encoder, "generator": self.generator}
        save_model(self.folder / "model.pt", **networks, atlas=self._atlas(codes))
        return super().finish()

    def _atlas(self, codes: Tensor) -> Atlas:
        """The inputs by a surface that they share: Stage III-a's own, or the icosphere."""
        items, rows = self.trainer.datamodule, self._inputs()
        shared = self.shared or items.shared_surface(rows)
        rows = [self.table.rows[str(id)] for id in shared["ids"]]
        atlas = Atlas.of(shared, codes[rows], limit=self.kept_shapes)
        if self.shared is None and self.placement:
            _place(atlas, self.placement)
        return atlas


class InitializeStage(GeneratorStage):
    """Stage III-b: the generator learns the propagated correspondences (Eq. 10).

    Parameters
    ----------
    latent_spread
        Codes are scaled so that the input shapes lie this far from their mean.
    """

    def __init__(self, *, latent_spread: float, **shared: Any) -> None:
        super().__init__(**shared)
        self.latent_spread = latent_spread

    @classmethod
    def from_runs(cls, inputs: Mapping[str, Run], folder: Path, **numbers: Any) -> Self:
        """With the encoder of Stage II."""
        encoder = load_model(inputs["implicit"].folder / "model.pt")["encoder"]
        shared = shared_surface(inputs["correspond"].folder)
        return cls(encoder=encoder, shared=shared, folder=folder, **numbers)

    def setup(self, stage: str) -> None:
        """Encode all items; scale codes by the spread of the inputs; keep their mean image."""
        super().setup(stage)
        image = self.trainer.datamodule.mean_target(self._inputs())
        self.generator.mean_image = image.to(self.table.codes.device)
        self.generator.fit_latents(self.table.codes[self._inputs()], self.latent_spread)

    def training_step(self, batch: CorrespondenceBatch, index: int) -> Tensor:
        """Eq. 10."""
        loss = self.correspondence(self.table.of(batch.ids), batch)
        self.log_losses(correspondence=loss)
        return loss


class FinetuneStage(GeneratorStage):
    """Stage IV: generator and encoder against the surfaces themselves (Eqs. 11 and 12).

    Parameters
    ----------
    surfaces
        Closest-point tree of every item.
    parents
        The tree of Stage III: item → parent; its edges carry p_sync.
    train_encoder
        Whether γ is trained too (the paper's text) or only θ (its formula).
    deformation_weight, isometry_weight
        μ̄ and β.
    geometric_regularization
        Whether Eq. 12 takes part.
    deformation_codes, deformation_points
        Codes z ~ p_sync in a step and sphere points of each, for Eq. 12.
    correspondence_weight, final_correspondence_weight
        Weight of Eq. 10 beside Eq. 11, from the first step linearly to the last.
    coverage_weight
        Weight of the distance from the shape to the generated surface.
    level
        The icosphere, randomly turned in every step, whose vertices sample Eq. 11.
    """

    def __init__(
        self,
        *,
        surfaces: Mapping[str, ClosestPointTree],
        parents: Mapping[str, str],
        train_encoder: bool,
        deformation_weight: float,
        isometry_weight: float,
        geometric_regularization: bool,
        deformation_codes: int,
        deformation_points: int,
        correspondence_weight: float,
        final_correspondence_weight: float,
        coverage_weight: float,
        level: int,
        **shared: Any,
    ) -> None:
        super().__init__(**shared)
        self.surfaces, self.parents = surfaces, parents
        self.train_encoder = train_encoder
        self.encoder.requires_grad_(train_encoder)
        self.deformation_weight, self.isometry_weight = deformation_weight, isometry_weight
        self.geometric_regularization = geometric_regularization
        self.deformation_codes, self.deformation_points = deformation_codes, deformation_points
        self.correspondence_weights = correspondence_weight, final_correspondence_weight
        self.coverage_weight = coverage_weight
        self.ball = icosphere(level)

    @classmethod
    def from_runs(cls, inputs: Mapping[str, Run], folder: Path, **numbers: Any) -> Self:
        """With the networks of Stage III-b and the tree of Stage III-a."""
        networks = load_model(inputs["initialize"].folder / "model.pt")
        networks.pop("atlas", None)  # made anew, with the codes of this stage
        shared = shared_surface(inputs["correspond"].folder)
        tree = read_json(inputs["correspond"].folder / "tree.json")
        ids = tree["ids"]
        parents = {id: ids[p] for id, p in zip(ids, tree["parent"], strict=True) if p >= 0}
        surfaces = Surfaces(inputs["augment"].folder)
        found = {"parents": parents, "surfaces": surfaces, "shared": shared}
        return cls(**networks, **found, folder=folder, **numbers)  # type: ignore[arg-type]

    def setup(self, stage: str) -> None:
        """Encode all items and join them by the tree."""
        super().setup(stage)
        self.table.join(self.parents)

    def training_step(self, batch: CorrespondenceBatch, index: int) -> Tensor:
        """Eq. 11, Eq. 12, and what keeps limbs from retracting."""
        random = draws(self.seed, self.global_step)
        codes = self._codes(batch)
        mine = slice(batch.first, None)
        p = self._turned_ball(random).to(codes).expand(len(codes[mine]), -1, -1)
        generated = self.fast(self.generator)(codes[mine], p).float()
        surfaces = [self.surfaces[id] for id in batch.ids[mine]]
        data = batch.weight * surface_loss(generated, surfaces)
        self.log_losses(data=data)
        loss = data + self._kept(codes, batch) + self._covered(generated, batch)
        if self.geometric_regularization and batch.ends:
            with single_precision(self.device):
                deformation = self._deformation(random)
            loss = loss + self.micro_batches * self.deformation_weight * deformation
            self.log_losses(deformation=deformation)
        return loss

    def _codes(self, batch: CorrespondenceBatch) -> Tensor:
        if not self.train_encoder:
            return self.table.of(batch.ids)
        codes = self.encode(batch.drawn, batch.clouds).float()
        codes = codes - codes[:1]
        self.table.update(batch.ids, codes, self.total)
        return codes

    def _turned_ball(self, random: torch.Generator) -> Tensor:
        """The icosphere's vertices in a random orientation: a quadrature of the sphere."""
        basis, triangle = torch.linalg.qr(torch.randn((3, 3), generator=random).double())
        rotation = basis * triangle.diagonal().sign()
        rotation = rotation * torch.linalg.det(rotation)
        return torch.from_numpy(np.array(self.ball.vertices)) @ rotation.T

    def _kept(self, codes: Tensor, batch: CorrespondenceBatch) -> Tensor:
        """Eq. 10 with its weight at this step."""
        first, last = self.correspondence_weights
        progress = self.global_step / max(1, self.trainer.estimated_stepping_batches)
        weight = first + (last - first) * progress
        with torch.set_grad_enabled(weight > 0):
            loss = self.correspondence(codes, batch)
        self.log_losses(correspondence=loss)
        return weight * loss

    def _covered(self, generated: Tensor, batch: CorrespondenceBatch) -> Tensor:
        """Distance of points of the shapes to the generated surfaces; logged at any weight."""
        with torch.set_grad_enabled(self.coverage_weight > 0):
            loss = coverage_loss(batch.surface[batch.first :], generated, self.ball.faces)
            loss = batch.weight * loss
        self.log_losses(coverage=loss)
        return self.coverage_weight * loss

    def _deformation(self, random: torch.Generator) -> Tensor:
        """Eq. 12 at codes between neighbours of the tree and random sphere points."""
        z = self.table.sample(self.deformation_codes, random)
        p = torch.randn((self.deformation_codes, self.deformation_points, 3), generator=random)
        p = torch.nn.functional.normalize(p, dim=2).to(z)
        mine, weight = self.part(len(z))
        metric = jacobian(self.generator, z[mine], p[mine])
        return weight * generator_deformation(metric, self.isometry_weight)


def _place(atlas: Atlas, placement: Mapping[str, Any]) -> None:
    """Put the icosphere's vertices where their images on all shapes are distorted least."""
    images = atlas.images.double().numpy()
    sphere = atlas.sphere.double().numpy()
    found = place_for_all(images, atlas.faces, sphere, **placement)
    atlas.placed.copy_(torch.from_numpy(found.sphere))


def shared_surface(folder: Path) -> dict[str, np.ndarray] | None:
    """Arrays of the shared surface that a paired Stage III-a left, if it was one."""
    path = folder / SHARED
    return load_npz(path) if path.is_file() else None


class Surfaces(dict[str, ClosestPointTree]):
    """Closest-point trees of the items of a folder, built when asked for.

    The `kept` asked for last stay: a tree takes a megabyte, and longer to query than to build.
    """

    def __init__(self, folder: Path, kept: int = 64) -> None:
        super().__init__()
        self.folder, self.kept = folder, kept

    def __getitem__(self, id: str) -> ClosestPointTree:
        tree = self.pop(id) if id in self else self._built(id)
        self[id] = tree
        while len(self) > self.kept:
            del self[next(iter(self))]
        return tree

    def _built(self, id: str) -> ClosestPointTree:
        return ClosestPointTree(sphere_mesh() if id == SPHERE else item_mesh(self.folder, id))
