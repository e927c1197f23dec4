"""Two processes on the CPU: one folder, the results of one process."""

import csv
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import ROOT, begun, environment, kill_in_the_middle, run_here, smoke_words, train
from compare import different

from gensp.errors import Unsupported

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("stage", ["augment", "correspond", "evaluate"])
def test_items_are_shared_out(stage: str, smoke: Path, smoke_copy: Path) -> None:
    folder = smoke_copy / "smoke" / "full" / stage
    shutil.rmtree(folder)
    train(*smoke_words(smoke_copy), f"stage={stage}", "trainer=ddp_cpu", "workers.jobs=2")
    assert different(folder, smoke / "smoke" / "full" / stage) == []
    assert json.loads((folder / "manifest.json").read_text())["ranks"] == 2


def losses(folder: Path) -> dict[str, np.ndarray]:
    with open(folder / "history.csv") as file:
        rows = list(csv.DictReader(file))
    names = [name for name in rows[-1] if name.startswith("train/")]
    return {name: np.array([float(row[name] or "nan") for row in rows]) for name in names}


# Few epochs, as rounding grows from step to step; level sets early, so that they take part.
SHORT = {
    "implicit": ("epochs=4", "regularize_from_epoch=1", "level_sets.every=3"),
    "initialize": ("epochs=4",),
    "finetune": ("epochs=2",),
}


def short_words(stage: str, runs: Path) -> tuple[str, ...]:
    recipe = (f"recipe.{stage}.{setting}" for setting in SHORT[stage])
    return (*smoke_words(runs), f"stage={stage}", *recipe, "callbacks.last.every_seconds=0")


@pytest.mark.parametrize("stage", list(SHORT))
def test_two_ranks_train_as_one_does(stage: str, smoke_copy: Path, tmp_path: Path) -> None:
    folder = smoke_copy / "smoke" / "full" / stage
    words = short_words(stage, smoke_copy)
    run_here(*words, "force=true")
    alone = losses(folder)
    train(*words, "trainer=ddp_cpu", "force=true")
    together = losses(folder)
    assert alone.keys() == together.keys()
    assert stage != "implicit" or np.isfinite(alone["train/deformation"][1:]).all()
    for name, expected in alone.items():
        np.testing.assert_allclose(together[name], expected, rtol=0, atol=1e-6, err_msg=name)


@pytest.mark.parametrize("stage", ["implicit", "finetune"])
def test_two_ranks_that_were_killed_go_on_to_the_same_bits(
    stage: str, smoke_copy: Path, tmp_path: Path
) -> None:
    folder, whole = smoke_copy / "smoke" / "full" / stage, tmp_path / "whole"
    words = (*short_words(stage, smoke_copy), "trainer=ddp_cpu")
    train(*words, "force=true")
    shutil.move(folder, whole)
    kill_in_the_middle(folder, *words)
    assert begun(folder)
    assert not (folder / "manifest.json").exists(), "killed too late to be of use"
    assert "resumed from its last checkpoint" in train(*words).stdout
    assert different(folder, whole) == []


def test_whole_pipeline_needs_an_outer_launcher(tmp_path: Path) -> None:
    with pytest.raises(Unsupported, match=r"one stage at a time .* torchrun"):
        run_here(*smoke_words(tmp_path), "trainer=ddp_cpu")


def test_torchrun_walks_stages_in_step(smoke: Path, tmp_path: Path) -> None:
    words = smoke_words(tmp_path)
    pipeline = "pipeline=[['stage=augment'],['stage=implicit']]"
    launcher = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    done = subprocess.run(
        [sys.executable, *launcher, "train.py", *words, "trainer=ddp_cpu", pipeline],
        cwd=ROOT,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    made = tmp_path / "smoke" / "full"
    assert different(made / "augment", smoke / "smoke" / "full" / "augment") == []
    assert (made / "implicit" / "manifest.json").is_file()
    assert done.stdout.count("] implicit") == 1
