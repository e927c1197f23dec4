"""What a training says of the validation shapes on its way; it changes nothing of the training."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import Callback
from lightning.pytorch.utilities.seed import isolate_rng
from torch import Tensor, nn

from gensp.data.clouds import point_cloud
from gensp.data.shapes import SPHERE, ShapeCollection
from gensp.geometry.mesh import Mesh, normalize
from gensp.stages.base import FitStage
from gensp.tasks.generated import KnownShapes
from gensp.terminal import say


class Validation(Callback):
    """Measures a few shapes at ends of epochs, evenly through the training, the last included.

    The figures go to the loggers and to the history as val/<name>. They are taken on rank zero,
    without gradients and with random states of their own.

    Parameters
    ----------
    collection
        Tells the splits. Shapes of the split val are measured, whether they are learnt from
        (`recipe.augment.learn_from`) or not; where there are none, the first training shapes.
    times
        How often; 0: never.
    shapes
        At most so many are measured.
    """

    def __init__(self, *, collection: ShapeCollection, times: int = 10, shapes: int = 4) -> None:
        self.collection, self.times, self.shapes = collection, times, shapes
        self._clouds: Tensor | None = None

    def on_fit_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Say so where training shapes stand for missing validation shapes."""
        chosen = self.chosen(trainer)
        if self.times and chosen and not set(chosen) & set(self.collection.ids("val")):
            say(f"      no shape of split val: val/ is measured on {', '.join(chosen)}, of train")

    def chosen(self, trainer: Trainer) -> list[str]:
        """Ids of the shapes that are measured."""
        learnt = set(trainer.datamodule.ids)  # type: ignore[attr-defined]
        train = [id for id in self.collection.ids("train") if id in learnt]
        return (self.collection.ids("val") or train)[: self.shapes]

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Measure, if it is time to."""
        if not trainer.is_global_zero or not self._due(trainer) or not self.chosen(trainer):
            return
        assert isinstance(pl_module, FitStage)
        with isolate_rng(), torch.no_grad(), evaluating(pl_module):
            found = self.measured(trainer, pl_module)
        pl_module.measured = {f"val/{name}": value for name, value in found.items()}
        for logger in trainer.loggers:
            logger.log_metrics(pl_module.measured, step=trainer.global_step)

    def _due(self, trainer: Trainer) -> bool:
        epochs = trainer.max_epochs or 0
        # The ends k · epochs / times, rounded up.
        done = trainer.current_epoch + 1
        return done * self.times // max(1, epochs) > (done - 1) * self.times // max(1, epochs)

    def measured(self, trainer: Trainer, stage: Any) -> dict[str, float]:
        """The figures by name."""
        raise NotImplementedError

    def codes(self, trainer: Trainer, stage: Any, ids: list[str]) -> Tensor:
        """Codes of the shapes by the encoder as it is now, from the first cloud of each."""
        if self._clouds is None:
            clouds = [self._cloud(trainer, id) for id in (SPHERE, *ids)]
            self._clouds = torch.stack(clouds)[:, None]
        codes: Tensor = stage.encode.all([SPHERE, *ids], self._clouds)
        return codes[1:]

    def _cloud(self, trainer: Trainer, id: str) -> Tensor:
        data = trainer.datamodule  # type: ignore[attr-defined]
        if id in data.ids:
            return data.clouds[data.ids.index(id), 0]
        cloud = point_cloud(normalize(self.collection.mesh(id)), data.batching.cloud)
        return torch.from_numpy(cloud)


class GeneratorValidation(Validation):
    """σ, bad faces, coverage and c of the surfaces that the generator makes of the shapes.

    Parameters
    ----------
    level
        Of the icosphere whose images are measured.
    """

    def __init__(self, *, level: int = 4, **shared: Any) -> None:
        super().__init__(**shared)
        self.level = level
        self._known: KnownShapes | None = None

    def measured(self, trainer: Trainer, stage: Any) -> dict[str, float]:
        """See `KnownShapes.figures`."""
        ids = self.chosen(trainer)
        if self._known is None:
            self._known = KnownShapes(self.collection, ids, level=self.level)
        codes = self.codes(trainer, stage, ids)
        p = torch.from_numpy(self._known.ball.vertices.astype(np.float32)).to(codes)[None]
        images = {id: stage.generator(z[None], p)[0] for id, z in zip(ids, codes, strict=True)}
        return self._known.figures(
            {id: image.float().cpu().numpy() for id, image in images.items()}
        )


class DistanceValidation(Validation):
    """Mean error of the signed distance at points that the training never draws.

    Parameters
    ----------
    points
        Of every shape; a third of each kind of `gensp.data.sdf.SdfSampler`.
    """

    def __init__(self, *, points: int = 1500, **shared: Any) -> None:
        super().__init__(**shared)
        self.points = points
        self._samples: tuple[Tensor, Tensor] | None = None

    def measured(self, trainer: Trainer, stage: Any) -> dict[str, float]:
        """The mean of |f(z, x) − d|, lengths at area 4π."""
        ids = self.chosen(trainer)
        if self._samples is None:
            self._samples = self._drawn(trainer, ids)
        codes = self.codes(trainer, stage, ids)
        points, distances = (part.to(codes) for part in self._samples)
        error = (stage.field(codes, points) - distances).abs().mean()
        return {"distance": float(error)}

    def _drawn(self, trainer: Trainer, ids: list[str]) -> tuple[Tensor, Tensor]:
        data = trainer.datamodule  # type: ignore[attr-defined]
        each = max(1, self.points // 3)
        sampler = replace(
            data.sampler, near=each, far=each, uniform=each, seed=data.sampler.seed + 1
        )
        # One by one: a training holds no more of its collection than it draws.
        pools = [sampler(self._mesh(data, id), data.bound) for id in ids]
        points, distances = ([getattr(p, name) for p in pools] for name in ("points", "distances"))
        return torch.from_numpy(np.stack(points)), torch.from_numpy(np.stack(distances))

    def _mesh(self, data: Any, id: str) -> Mesh:
        if id in data.ids:
            return data.meshes[data.ids.index(id) - 1]  # item 0 is S_0
        return normalize(self.collection.mesh(id))


@contextmanager
def evaluating(module: nn.Module) -> Iterator[None]:
    """Evaluation mode, after which every part has the mode that it had."""
    modes = {part: part.training for part in module.modules()}
    module.eval()
    try:
        yield
    finally:
        for part, mode in modes.items():
            part.training = mode
