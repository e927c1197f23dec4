"""Running the program as a person does; one smoke run that many tests read."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock
from hydra import compose, initialize_config_dir

ROOT = Path(__file__).parents[1]
STAGES = (
    "augment",
    "implicit",
    "correspond",
    "initialize",
    "finetune",
    "parameterize",
    "evaluate",
)
# A crash in compiled code says where it was.
_FAULTS = {"PYTHONFAULTHANDLER": "1"}
_RANKS = ("RANK", "LOCAL_RANK", "WORLD_SIZE", "LOCAL_WORLD_SIZE", "NODE_RANK", "MASTER_PORT")


def command(*words: str) -> list[str]:
    return [sys.executable, "train.py", *words]


def environment() -> dict[str, str]:
    """One thread, and nothing of an outer launcher."""
    kept = {name: value for name, value in os.environ.items() if name not in _RANKS}
    return {**kept, "OMP_NUM_THREADS": "1", "IGL_NUM_THREADS": "1", "COLUMNS": "200", **_FAULTS}


def train(*words: str, code: int = 0) -> subprocess.CompletedProcess[str]:
    """Run train.py and check its exit code."""
    done = subprocess.run(
        command(*words), cwd=ROOT, env=environment(), capture_output=True, text=True, timeout=590
    )
    said = f"exit code {done.returncode}\n{done.stdout[-3000:]}{done.stderr[-6000:]}"
    assert done.returncode == code, said
    return done


def run_here(*words: str) -> float | None:
    """What train.py does, in this process: importing Lightning again costs seconds."""
    from gensp.run import run

    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        return run(compose("config", overrides=list(words)), words)


def kill_in_the_middle(folder: Path, *words: str) -> None:
    """Start a stage and kill it, workers included, once something of it is on the disk."""
    process = subprocess.Popen(
        command(*words),
        cwd=ROOT,
        env=environment(),
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        _wait_until_begun(process, folder)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def stop_in_the_middle(folder: Path, number: signal.Signals, *words: str) -> tuple[int, str]:
    """Start a stage, send it and its workers a signal, as terminals do; exit code and stderr."""
    process = subprocess.Popen(
        command(*words),
        cwd=ROOT,
        env=environment(),
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        # Programs started in the background ignore SIGINT, and so do theirs.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        _wait_until_begun(process, folder)
        os.killpg(process.pid, number)
        _, said = process.communicate(timeout=60)
    finally:
        process.kill()
    return process.returncode, said


def _wait_until_begun(process: subprocess.Popen[Any], folder: Path) -> None:
    until = time.monotonic() + 120
    while not begun(folder) and process.poll() is None and time.monotonic() < until:
        time.sleep(0.002)


def begun(folder: Path) -> bool:
    return (folder / "checkpoints" / "last.ckpt").is_file() or bool(finished_items(folder))


def finished_items(folder: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in folder.glob("rows/[!.]*.json")}


def free_port() -> int:
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        return int(listening.getsockname()[1])


def smoke_words(runs: Path) -> list[str]:
    return ["experiment=smoke", f"paths.runs={runs}", f"paths.cache={runs}/cache", "threads=1"]


@pytest.fixture(scope="session")
def smoke(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The runs folder of `experiment=smoke`, all stages; to be read only."""
    from gensp.methods.hierarchical import compile_loops

    folder = shared_folder(tmp_path_factory)
    runs = folder / "smoke" / "runs"
    with FileLock(folder / "smoke.lock"):
        if not (runs / "output.txt").is_file():
            compile_loops()  # here, not in each of its workers
            done = train(*smoke_words(runs))
            (runs / "output.txt").write_text(done.stdout)
    return runs


def shared_folder(factory: pytest.TempPathFactory) -> Path:
    """The temporary folder that all processes of one run of the tests see."""
    own = factory.getbasetemp()
    return own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


@pytest.fixture
def smoke_copy(smoke: Path, tmp_path: Path) -> Path:
    """A copy of the smoke runs, to be changed."""
    return copied(smoke, tmp_path / "runs")


def copied(runs: Path, to: Path) -> Path:
    """A copy without the halves of files that another process may be writing."""
    return Path(shutil.copytree(runs, to, ignore=shutil.ignore_patterns(".*")))
