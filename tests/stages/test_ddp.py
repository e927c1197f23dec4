"""Two processes on the CPU: one folder, the results of one process."""

import csv
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from commands import ROOT, environment, run_here, smoke_words, train
from compare import different, load

from gensp.errors import Unsupported

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("stage", ["augment", "correspond", "evaluate"])
def test_items_are_shared_out(stage: str, smoke: Path, smoke_copy: Path) -> None:
    folder = smoke_copy / "smoke" / "full" / stage
    shutil.rmtree(folder)
    train(*smoke_words(smoke_copy), f"stage={stage}", "trainer=ddp_cpu", "workers.jobs=2")
    assert different(folder, smoke / "smoke" / "full" / stage) == []
    assert json.loads((folder / "manifest.json").read_text())["ranks"] == 2


@pytest.mark.parametrize("stage", ["implicit", "finetune"])
def test_two_ranks_train_one_model(stage: str, smoke: Path, smoke_copy: Path) -> None:
    folder = smoke_copy / "smoke" / "full" / stage
    shutil.rmtree(folder)
    train(*smoke_words(smoke_copy), f"stage={stage}", "trainer=ddp_cpu")
    reference = smoke / "smoke" / "full" / stage
    assert load(folder / "model.pt").keys() == load(reference / "model.pt").keys()
    with open(folder / "history.csv") as file:
        history = list(csv.DictReader(file))
    losses = [
        float(row[column])
        for row in history
        for column in row
        if "train/" in column and row[column]
    ]
    assert losses
    assert all(abs(loss) < 1e6 for loss in losses)


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
