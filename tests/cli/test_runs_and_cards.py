"""`gensp runs` and `gensp card`."""

import csv
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from gensp.catalogue import LISTED, compared, find_runs
from gensp.errors import MissingData
from gensp.geometry.mesh import Mesh, save_mesh
from gensp.restarts import begin
from gensp.runs import seal

Run = Callable[..., tuple[int, str, str]]
Refused = Callable[..., str]


def finished(folder: Path, stage: str, rate: float, loss: float, seconds: float = 2.0) -> None:
    settings = {"stage": {"name": stage, "rates": [rate, 1]}, "seed": 0}
    begin(folder, settings)
    facts = {"seconds": seconds, "device": "cpu", "threads": 1, "ranks": 1, "resumed": False}
    seal(folder, stage=stage, settings=settings, metrics={"loss": loss}, facts=facts)


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """Two variants of two stages; one of them lacks the second."""
    root = tmp_path / "runs"
    finished(root / "heads" / "full" / "implicit", "implicit", 0.1, 0.5)
    finished(root / "heads" / "full" / "augment", "augment", 0.1, 7.0)
    finished(root / "heads" / "no_da" / "implicit", "implicit", 0.2, 0.75, seconds=9.0)
    return root


def test_runs_are_found_from_any_depth_in_the_order_of_the_stages(runs: Path) -> None:
    names = [entry.name for entry in find_runs(runs)]
    assert names == ["heads/full/augment", "heads/full/implicit", "heads/no_da/implicit"]
    assert [entry.name for entry in find_runs(runs / "heads" / "full")] == ["augment", "implicit"]
    assert [entry.name for entry in find_runs(runs / "heads/full/augment")] == ["augment"]


def test_compare_tells_what_differs_and_nothing_else(runs: Path) -> None:
    rows = compared([find_runs(runs / "heads" / variant) for variant in ("full", "no_da")])
    assert {row[0] for row in rows} == {"implicit"}
    told = {row[1]: row[2:] for row in rows}
    assert told["stage.rates.0"] == ["0.1", "0.2"]
    assert told["loss"] == ["0.5", "0.75"]
    assert told["seconds"] == ["2", "9"]
    assert set(told) == {"stage.rates.0", "loss", "seconds", "peak_memory_gib"}


def test_a_run_compared_with_itself_differs_in_nothing(runs: Path) -> None:
    entries = find_runs(runs / "heads" / "full")
    assert {row[1] for row in compared([entries, entries])} == {"seconds", "peak_memory_gib"}


def test_commands_print_tables(gensp: Run, runs: Path) -> None:
    code, said, _ = gensp("runs", "list", runs)
    assert code == 0
    assert "heads/no_da/implicit" in said
    assert "loss 0.75" in said
    code, said, _ = gensp("runs", "show", runs / "heads" / "full" / "augment")
    assert code == 0
    for word in ("stage.rates.0", "version of numpy", "peak_memory_gib", "processor"):
        assert word in said
    code, said, _ = gensp("runs", "compare", runs / "heads/full", runs / "heads/no_da")
    assert code == 0
    assert "stage.rates.0" in said


def test_a_list_for_another_program_has_unbroken_lines(
    gensp: Run, runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    variant = "full+finetune.isometry_weight-0.01,finetune.smoothness_weight-0.25"
    finished(runs / "heads" / variant / "finetune", "finetune", 0.1, 3.0)
    rows = [line.split("\t") for line in gensp("runs", "list", runs)[1].splitlines()]
    assert rows[0] == list(LISTED)
    assert {len(row) for row in rows} == {len(LISTED)}
    assert f"heads/{variant}/finetune" in [row[0] for row in rows]


def test_export_holds_everything(gensp: Run, runs: Path, tmp_path: Path) -> None:
    for suffix in ("csv", "json", "md"):
        assert gensp("runs", "export", runs, tmp_path / f"all.{suffix}")[0] == 0
    with open(tmp_path / "all.csv", newline="") as file:
        table = {row["run"]: row for row in csv.DictReader(file)}
    listed = {row["run"]: row for row in json.loads((tmp_path / "all.json").read_text())}
    assert table.keys() == listed.keys()
    row = listed["heads/no_da/implicit"]
    assert row["setting.stage.rates.0"] == 0.2
    assert row["metric.loss"] == 0.75
    assert {"seconds", "revision", "machine", "memory_gib", "version of torch"} <= row.keys()
    assert table["heads/no_da/implicit"]["metric.loss"] == "0.75"
    assert "heads/no_da/implicit" in (tmp_path / "all.md").read_text()


def test_what_cannot_be_told_is_one_line(refused: Refused, runs: Path, tmp_path: Path) -> None:
    assert "holds no finished stage" in refused("runs", "list", tmp_path / "nowhere")
    assert "two or more are required" in refused("runs", "compare", runs)
    separate = runs / "heads/full/augment", runs / "heads/no_da/implicit"
    assert "share no stage" in refused("runs", "compare", *separate)
    assert ".csv, .json, .md" in refused("runs", "export", runs, tmp_path / "all.xlsx")
    (runs / "heads/full/augment/manifest.json").write_text("{")
    assert "manifest.json: cannot be read" in refused("runs", "list", runs)
    (runs / "heads/full/augment/manifest.json").write_text("{}")
    with pytest.raises(MissingData, match="has no digest"):
        find_runs(runs)


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="told by Linux alone")
def test_peak_memory_is_that_since_it_was_forgotten() -> None:
    script = (
        "from gensp.machine import forget_peak_memory, peak_memory\n"
        "block = bytearray(2**28); del block; large = peak_memory()\n"
        "forget_peak_memory(); print(large, peak_memory())"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    large, after = map(float, done.stdout.split())
    assert large > 0.25
    assert after < large - 0.2


def test_card_is_written_by_the_command(gensp: Run, tmp_path: Path, bumpy: Mesh) -> None:
    save_mesh(bumpy, tmp_path / "meshes" / "stone.ply")
    code, said, _ = gensp("card", tmp_path, "--out", tmp_path / "card", "--name", "stones")
    assert code == 0
    assert "CARD.md" in said
    assert "Data card: stones" in (tmp_path / "card" / "CARD.md").read_text()
    assert (tmp_path / "card" / "card.jpg").stat().st_size > 1000


def test_a_wrong_axis_of_the_card_is_told(refused: Refused, tmp_path: Path) -> None:
    assert "--up w" in refused("card", tmp_path, "--up", "w")
