"""What only one of two ranks meets is told in one line, and ends both."""

import shutil
import subprocess
from pathlib import Path

import pytest
from commands import ROOT, command, environment, free_port, smoke_words, train

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def _faults_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}:{ROOT / 'tests'}")


def as_tasks_of_slurm(*words: str) -> list[tuple[int, str]]:
    """Exit code and stderr of two processes with what srun sets for two tasks of a machine."""
    job = {"SLURM_JOB_ID": "7", "SLURM_JOB_NAME": "train", "SLURM_JOB_NUM_NODES": "1"}
    step = {"SLURM_NTASKS": "2", "SLURM_NTASKS_PER_NODE": "2", "SLURM_STEP_NUM_TASKS": "2"}
    node = {
        "SLURM_NODEID": "0",
        "SLURM_JOB_NODELIST": "127.0.0.1",
        "MASTER_PORT": f"{free_port()}",
    }
    tasks = [
        subprocess.Popen(
            command(*words, "trainer=slurm", "trainer.accelerator=cpu"),
            cwd=ROOT,
            env=environment() | job | step | node | {"SLURM_PROCID": k, "SLURM_LOCALID": k},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        for k in ("0", "1")
    ]
    said = [task.communicate(timeout=300)[1] for task in tasks]
    return [(task.returncode, text) for task, text in zip(tasks, said, strict=True)]


def test_a_loss_that_is_no_number_on_one_rank_ends_all_with_one_line(smoke_copy: Path) -> None:
    words = (*smoke_words(smoke_copy), "stage=implicit", "force=true", "trainer=ddp_cpu")
    done = train(*words, "+callbacks.fault._target_=failing.NoNumber", code=2)
    assert done.stderr.count("error: ") == 1, done.stderr
    assert "error: " + str(smoke_copy) in done.stderr
    assert "the loss is no finite number in epoch 1, step 3" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_full_disk_of_one_rank_is_told_by_it_and_its_loss_by_the_first(smoke_copy: Path) -> None:
    shutil.rmtree(smoke_copy / "smoke" / "full" / "augment")
    words = (*smoke_words(smoke_copy), "stage=augment", "workers.jobs=1")
    (first, lost), (second, told) = as_tasks_of_slurm(
        *words, "+callbacks.fault._target_=failing.FullDisk"
    )
    assert (first, second) == (2, 2), lost + told
    assert told.startswith("error: rank 1: /full: cannot be written (No space left on device)")
    assert lost.startswith(f"error: {smoke_copy}/smoke/full/augment: another rank ended")
    assert (lost + told).count("\n") == 2
