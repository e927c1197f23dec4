"""Mixed precision and compilation give the gradients of the plain training, or are refused."""

from collections.abc import Callable, Iterator
from pathlib import Path

import jaxtyping
import pytest
import torch
from lightning import Callback, Trainer
from stages.test_generator import correspondences, finetune_stage, initialize_stage
from stages.test_implicit import implicit_stage, sdf_module

from gensp.errors import Unsupported
from gensp.geometry.reduced import deformation_cover
from gensp.geometry.sphere import icosphere
from gensp.losses import implicit_deformation
from gensp.models import ImplicitField
from gensp.stages import speed
from gensp.stages.base import FitStage


@pytest.fixture
def traceable() -> Iterator[None]:
    """The checks of shapes, which the compiler cannot follow, are off."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


Made = tuple[FitStage, object]


def implicit(folder: Path) -> Made:
    return implicit_stage(folder, regularize_from_epoch=0), sdf_module(folder)


def initialize(folder: Path) -> Made:
    return initialize_stage(folder), correspondences()


def finetune(folder: Path) -> Made:
    return finetune_stage(folder), correspondences()


class FirstGradient(Callback):
    """Keeps the gradient of the first step."""

    found: torch.Tensor | None = None

    def on_after_backward(self, trainer: Trainer, stage: FitStage) -> None:
        if self.found is None:
            grads = [weight.grad for weight in stage.parameters() if weight.grad is not None]
            self.found = torch.cat([grad.flatten().clone() for grad in grads])


def gradient(made: Made, *, precision: str = "32-true", compiled: bool = False) -> torch.Tensor:
    stage, data = made
    stage.compiled = compiled
    kept = FirstGradient()
    quiet = {"logger": False, "enable_progress_bar": False, "enable_model_summary": False}
    trainer = Trainer(
        max_steps=1,
        accelerator="cpu",
        precision=precision,
        callbacks=[kept],
        enable_checkpointing=False,
        inference_mode=False,
        **quiet,
    )
    trainer.fit(stage, data)
    assert kept.found is not None
    return kept.found


@pytest.mark.parametrize("made", [implicit, initialize, finetune])
def test_mixed_precision_keeps_the_direction_of_the_gradient(
    made: Callable[[Path], Made], tmp_path: Path
) -> None:
    plain = gradient(made(tmp_path))
    mixed = gradient(made(tmp_path), precision="bf16-mixed")
    assert not torch.equal(mixed, plain)
    assert torch.nn.functional.cosine_similarity(mixed, plain, dim=0) > 0.99
    assert (mixed - plain).norm() < 0.1 * plain.norm()


@pytest.mark.parametrize("made", [implicit, initialize, finetune])
def test_compilation_keeps_the_gradient(
    made: Callable[[Path], Made],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    traceable: None,
) -> None:
    calls = []

    def traced(network: torch.nn.Module) -> Callable[..., torch.Tensor]:
        calls.append(network)
        # As torch.compile differentiates, without the minutes of a C++ compiler.
        return torch.compile(network, dynamic=True, backend="aot_eager")

    monkeypatch.setattr("gensp.stages.base.compiled_call", traced)
    plain = gradient(made(tmp_path))
    assert not calls
    found = gradient(made(tmp_path), compiled=True)
    assert len(calls) == 1
    torch.testing.assert_close(found, plain, rtol=1e-3, atol=1e-5)


def deformation(field: Callable[..., torch.Tensor]) -> torch.Tensor:
    """Eq. 5 on the unit sphere."""
    points = torch.tensor(icosphere(2).vertices, dtype=torch.float32)
    directions = torch.eye(4)[:2]
    return implicit_deformation(
        lambda x, z: field(z, x[:, None]).squeeze(1),
        torch.zeros(4),
        points,
        deformation_cover(points, 15),
        directions,
        0.1,
    )


def test_eq_5_cannot_be_compiled_and_so_is_not(traceable: None) -> None:
    field = ImplicitField(4, width=16, depth=2, octaves=1)
    compiled = torch.compile(field, backend="aot_eager")
    with pytest.raises(RuntimeError, match=r"double backward|donated buffers"):
        deformation(compiled).backward()


def test_the_geometric_terms_stay_in_single_precision() -> None:
    field = ImplicitField(4, width=16, depth=2, octaves=1)
    plain = deformation(field)
    with torch.autocast("cpu", torch.bfloat16):
        assert not torch.equal(deformation(field), plain)
        with speed.single_precision(torch.device("cpu")):
            assert torch.equal(deformation(field), plain)


@pytest.mark.parametrize("precision", ["16-mixed", "bf16-true", "64-true", 16])
def test_other_precisions_are_refused(precision: object) -> None:
    with pytest.raises(Unsupported, match=r"trainer\.precision=.*32-true or bf16-mixed is req"):
        speed.require_fast(precision, False)


def test_compilation_needs_a_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CXX", "no-such-compiler")
    monkeypatch.setattr(speed.shutil, "which", lambda _: None)
    with pytest.raises(Unsupported, match=r"compile=true: no C\+\+ compiler was found \(no-such"):
        speed.require_fast("32-true", True)
    speed.require_fast("32-true", False)
