"""Kill -9 in the middle of every stage, run again: what is finished stays, the result is equal."""

import shutil
import signal
from pathlib import Path

import numpy as np
import pytest
from commands import (
    STAGES,
    begun,
    finished_items,
    kill_in_the_middle,
    run_here,
    smoke_words,
    stop_in_the_middle,
)
from compare import different

from gensp.pictures.report import Page, write_report
from gensp.runs import Run
from gensp.tables import summary_markdown

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("stage", STAGES)
def test_a_killed_stage_goes_on(stage: str, smoke: Path, smoke_copy: Path) -> None:
    folder = smoke_copy / "smoke" / "full" / stage
    shutil.rmtree(folder)
    slowly = ("workers.jobs=1", "callbacks.last.every_seconds=0")
    words = (*smoke_words(smoke_copy), f"stage={stage}", *slowly)
    kill_in_the_middle(folder, *words)
    assert begun(folder)
    assert not (folder / "manifest.json").exists(), "killed too late to be of use"
    kept = finished_items(folder)
    run_here(*words)
    assert kept.items() <= finished_items(folder).items()
    assert different(folder, smoke / "smoke" / "full" / stage) == []


@pytest.mark.parametrize(("number", "jobs"), [(signal.SIGTERM, 1), (signal.SIGINT, 2)])
def test_a_stopped_stage_says_so_in_one_line_and_goes_on(
    number: signal.Signals, jobs: int, smoke: Path, smoke_copy: Path
) -> None:
    folder = smoke_copy / "smoke" / "full" / "augment"
    shutil.rmtree(folder)
    words = (*smoke_words(smoke_copy), "stage=augment", f"workers.jobs={jobs}")
    code, said = stop_in_the_middle(folder, number, *words)
    assert (code, said) == (128 + number, _stopped_by(number))
    assert not (folder / "manifest.json").exists()
    run_here(*words)
    assert different(folder, smoke / "smoke" / "full" / "augment") == []


def test_a_training_is_stopped_in_one_line(smoke_copy: Path) -> None:
    folder = smoke_copy / "smoke" / "full" / "implicit"
    shutil.rmtree(folder)
    long = ("stage=implicit", "recipe.implicit.epochs=5000", "callbacks.last.every_seconds=0")
    code, said = stop_in_the_middle(folder, signal.SIGTERM, *smoke_words(smoke_copy), *long)
    assert said.endswith(_stopped_by(signal.SIGTERM))
    assert code == 128 + signal.SIGTERM
    assert "Traceback" not in said


def _stopped_by(number: signal.Signals) -> str:
    return f"error: stopped by {number.name}; the same command goes on from here\n"


@pytest.mark.parametrize("name", ["summary.md", "report.html"])
def test_a_comparison_sees_figures_and_no_seconds(name: str, tmp_path: Path) -> None:
    def folder(error: float, seconds: float) -> Path:
        group = {"error": error, "seconds": seconds, "shapes": 3}
        summary = {"method": "gensp", "variant": "full", "groups": {"all": group}}
        made = tmp_path / f"{error}_{seconds}"
        made.mkdir()
        if name == "summary.md":
            (made / name).write_text(summary_markdown(summary))
        else:
            page = Page("", "", summary, (), {}, np.eye(3), settings={"runs": str(made)})
            write_report(page, made / name)
        return made

    first = folder(0.01, 2.0)
    assert different(first, folder(0.01, 3.0)) == []
    assert different(first, folder(0.02, 2.0)) == [name]


def test_a_finished_stage_returns_at_once(smoke_copy: Path) -> None:
    folder = smoke_copy / "smoke" / "full" / "implicit"
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    assert run_here(*smoke_words(smoke_copy), "stage=implicit") == Run(folder).headline
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


def test_a_forced_stage_is_made_anew_and_equal(smoke: Path, smoke_copy: Path) -> None:
    folder = smoke_copy / "smoke" / "full" / "augment"
    (folder / "stray.txt").touch()
    run_here(*smoke_words(smoke_copy), "stage=augment", "force=true")
    assert different(folder, smoke / "smoke" / "full" / "augment") == []


@pytest.mark.parametrize(("stage", "reader"), [("augment", "implicit"), ("finetune", "evaluate")])
def test_equal_results_leave_later_stages_finished(
    stage: str, reader: str, smoke_copy: Path
) -> None:
    run = smoke_copy / "smoke" / "full"
    before = Run(run / stage)
    sealed, outputs = before.manifest["seconds"], before.outputs
    run_here(*smoke_words(smoke_copy), f"stage={stage}", "force=true")
    after = Run(run / stage)
    assert after.manifest["seconds"] != sealed
    assert after.outputs == outputs
    kept = (run / reader / "manifest.json").stat().st_mtime_ns
    for later in STAGES[STAGES.index(stage) + 1 : STAGES.index(reader) + 1]:
        run_here(*smoke_words(smoke_copy), f"stage={later}")
    assert (run / reader / "manifest.json").stat().st_mtime_ns == kept
