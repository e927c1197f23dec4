"""Stage II: the encoder and the implicit shape generator (paper §4.2)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from gensp.data.batches import SdfBatch
from gensp.errors import BadMesh, EmptyLevelSet, Unsupported
from gensp.geometry.levelset import extract_surface
from gensp.geometry.reduced import Cover, deformation_cover
from gensp.losses import NORMS, encoder_penalty, implicit_deformation, origin_penalty, sdf_loss
from gensp.models import ImplicitField, PointNet2Encoder, save_model
from gensp.stages.base import FitStage
from gensp.stages.latents import CloudCodes, CodeTable, draws, save_codes
from gensp.stages.speed import single_precision
from gensp.terminal import warn

_SHARE = "level_set_share"


@dataclass(frozen=True)
class LevelSetSampling:
    """How the geometric regulariser samples level sets (paper §4.2).

    Attributes
    ----------
    vertices, nodes
        m and l of Eq. 6.
    directions
        Random v over which Eq. 8 is averaged.
    scale_weight
        η of Eq. 6.
    resolution
        Cells of the marching cubes grid.
    kept, every
        Number of level sets kept at a time, and training steps between two extractions. The tree
        that their codes are drawn from may be older, see `CodeTable.join_neighbours`.
    """

    vertices: int = 2000
    nodes: int = 200
    directions: int = 8
    scale_weight: float = 0.1
    resolution: int = 64
    kept: int = 4
    every: int = 20


@dataclass(frozen=True)
class LevelSet:
    """A sampled code z with the vertices of its level set and their reduced model."""

    z: Tensor
    points: Tensor
    cover: Cover


class ImplicitStage(FitStage):
    """Trains e^γ and f^φ on the three terms of Eq. 9, S_0 in every batch.

    Parameters
    ----------
    norm
        Of Eq. 3, `l2`, `l1` or `clamped`.
    tolerance
        Of Eq. 3 at first; it falls evenly to 0 at half of the epochs, from coarse to fine.
    encoder_weight, penalize
        λ, and what Eq. 4 is taken of: `latents` or the encoder's `weights`.
    origin_weight
        Weight of ‖e(S_0)‖².
    deformation_weight
        μ.
    geometric_regularization, regularize_from_epoch
        Whether and from which epoch on Eq. 5 takes part.
    sampling
        How its level sets are sampled.

    Raises
    ------
    Unsupported
        The norm is none of these.
    """

    def __init__(
        self,
        *,
        encoder: PointNet2Encoder,
        field: ImplicitField,
        norm: str,
        tolerance: float,
        encoder_weight: float,
        penalize: str,
        origin_weight: float,
        deformation_weight: float,
        geometric_regularization: bool,
        regularize_from_epoch: int,
        sampling: LevelSetSampling,
        learning_rate: float,
        seed: int = 0,
        folder: Path | str = Path("."),
    ) -> None:
        super().__init__(learning_rate=learning_rate, seed=seed, folder=folder)
        self.encoder, self.field = encoder, field
        if norm not in NORMS:
            known = ", ".join(NORMS)
            raise Unsupported(f"recipe.implicit.norm={norm}: one of {known} is required")
        self.norm, self.tolerance, self.penalize = norm, tolerance, penalize
        self.encoder_weight, self.origin_weight = encoder_weight, origin_weight
        self.deformation_weight = deformation_weight
        self.geometric_regularization = geometric_regularization
        self.regularize_from_epoch = regularize_from_epoch
        self.sampling = sampling
        self.encode = CloudCodes(encoder, self.folder)
        self.level_sets: list[LevelSet] = []
        self.extracted = -sampling.every

    def setup(self, stage: str) -> None:
        """Make room for the codes of all items."""
        self.table = CodeTable(self.trainer.datamodule.ids, self.encoder.latent)

    def training_step(self, batch: SdfBatch, index: int) -> Tensor:
        """Eq. 9 and the penalty that holds S_0 at the origin."""
        absolute = self.encode(batch.drawn, batch.clouds).float()
        codes = absolute - absolute[:1]
        self.table.update(batch.ids, codes, self.total)
        counted, mine = codes[batch.first :], slice(batch.first, None)
        predicted = self.fast(self.field)(counted, batch.points[mine])
        bound = self._tolerance()
        data = batch.weight * sdf_loss(predicted, batch.distances[mine], self.norm, bound)
        latents = (
            batch.weight * encoder_penalty(counted)
            if self.penalize == "latents"
            else encoder_penalty(self._weights())
        )
        origin = origin_penalty(absolute[0])
        loss = data + self.encoder_weight * latents + self.origin_weight * origin
        self.log_losses(data=data, latents=latents, origin=origin)
        regularize = self.current_epoch >= self.regularize_from_epoch and batch.ends
        if self.geometric_regularization and regularize:
            with single_precision(self.device):
                deformation = self._deformation()
            self.log_losses(**{_SHARE: float(deformation is not None)})
            if deformation is not None:
                loss = loss + self.micro_batches * self.deformation_weight * deformation
                self.log_losses(deformation=deformation)
        return loss

    def _tolerance(self) -> float:
        done = self.global_step / self.trainer.estimated_stepping_batches
        return self.tolerance * max(0.0, 1 - 2 * done)

    def _weights(self) -> Tensor:
        return torch.cat([weight.flatten() for weight in self.encoder.parameters()])

    def _deformation(self) -> Tensor | None:
        """Eq. 5 at one of the kept level sets; none while the field has no level set."""
        generator = draws(self.seed, self.global_step)
        if self.global_step - self.extracted >= self.sampling.every:
            self.table.join_neighbours()
            codes = self.table.sample(self.sampling.kept, generator)
            self.level_sets = [s for s in map(self._level_set, codes) if s is not None]
            self.extracted = self.global_step
        if not self.level_sets:
            return None
        chosen = int(torch.randint(len(self.level_sets), (), generator=generator))
        directions = torch.randn(
            (self.sampling.directions, self.encoder.latent), generator=generator
        )
        level_set = self.level_sets[chosen]
        mine, weight = self.part(len(directions))
        return weight * implicit_deformation(
            self.field.rowwise,
            level_set.z.to(self.device),
            level_set.points.to(self.device),
            level_set.cover.to(self.device),
            torch.nn.functional.normalize(directions[mine], dim=1).to(self.device),
            self.sampling.scale_weight,
        )

    def _level_set(self, z: Tensor) -> LevelSet | None:
        """The level set of one code; None where the field has none yet."""
        try:
            mesh = extract_surface(
                lambda x: self.field(z[None], x[None])[0],
                resolution=self.sampling.resolution,
                vertices=self.sampling.vertices,
                bounds=self.trainer.datamodule.bound,
                require_genus_zero=False,
                device=self.device,
            )
        except (EmptyLevelSet, BadMesh):
            return None
        points = torch.from_numpy(mesh.vertices).to(z)
        return LevelSet(z, points, deformation_cover(points, self.sampling.nodes))

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Keep the level sets: they belong to networks that no longer exist."""
        super().on_save_checkpoint(checkpoint)
        checkpoint["extracted"], checkpoint["renewed"] = self.extracted, self.table.renewed
        checkpoint["level_sets"] = [
            {"z": s.z, "points": s.points, "nodes": s.cover.nodes, "pairs": s.cover.pairs}
            for s in self.level_sets
        ]

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Go on with the level sets in use."""
        super().on_load_checkpoint(checkpoint)
        self.extracted = checkpoint["extracted"]
        # Older checkpoints have none: the tree is spanned anew.
        self.table.renewed = checkpoint.get("renewed", len(self.table.rows))
        self.level_sets = [
            LevelSet(s["z"], s["points"], Cover(s["nodes"], s["pairs"]))
            for s in checkpoint["level_sets"]
        ]

    def finish(self) -> dict[str, float]:
        """Put S_0 exactly at the origin; write the networks and the codes of all items."""
        items = self.trainer.datamodule
        self.encoder.set_origin(items.clouds[0].to(self.encoder.origin.device))
        save_codes(
            self.folder / "latents.npz", items.ids, self.encode.all(items.ids, items.clouds)
        )
        save_model(self.folder / "model.pt", encoder=self.encoder, field=self.field)
        self._require_level_sets()
        return super().finish()

    def _require_level_sets(self) -> None:
        """Warn where Eq. 5 was asked for and never took part."""
        name = f"train/{_SHARE}"
        shares = [means[name] for means in self.history if name in means]
        if shares and not any(shares):
            warn(
                f"{self.folder}: the field had no level set in any step of the geometric "
                "regularisation (Eq. 5), which never took part; train for more epochs, or raise "
                "recipe.implicit.level_sets.resolution"
            )
