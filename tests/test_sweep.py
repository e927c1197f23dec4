"""Sweeps: one folder per variant, shared stages made once, a failed job stops no other."""

import json
from pathlib import Path

import pytest
from commands import STAGES, smoke_words, train

pytestmark = pytest.mark.slow

ABLATIONS = ("full", "no_da", "no_gp", "no_gr")


def test_all_ablations_by_one_command(smoke_copy: Path) -> None:
    # Certified: a model of two minutes leaves more folds than untangling can undo.
    words = (*smoke_words(smoke_copy), "refine=certify")
    done = train("-m", *words, f"ablation={','.join(ABLATIONS)}")
    runs = smoke_copy / "smoke"
    made = {path.parent.relative_to(runs).as_posix() for path in runs.glob("*/*/manifest.json")}
    shared = {"no_da/augment", "no_gp/augment", "no_gp/implicit", "no_gr/augment"}
    learnt = {f"{name}/{stage}" for name in ABLATIONS for stage in STAGES[:5]}
    maps = {f"{name}+certify/{stage}" for name in ABLATIONS for stage in STAGES[5:]}
    assert (learnt | maps) - shared <= made
    assert not shared & made
    # What was there before is kept, and says so.
    assert done.stdout.count("finished before") == 5 + len(shared)
    for name in ABLATIONS:
        table = json.loads((runs / f"{name}+certify/evaluate/summary.json").read_text())
        assert table["variant"] == f"{name}+certify"
        assert 0 < table["groups"]["all"]["error"] < 0.5
        assert table["groups"]["all"]["bad_faces_percent"] == 0
        assert table["groups"]["all"]["affected_shapes"] == 0
    lines = (runs / "summary.md").read_text()
    assert all(f"{name}+certify" in lines for name in ABLATIONS)


def test_a_failed_job_stops_no_other(tmp_path: Path) -> None:
    done = train("-m", *smoke_words(tmp_path), "stage=correspond,augment", code=1)
    assert "'correspond' needs 'augment'" in done.stderr
    assert "Traceback" not in done.stderr
    assert (tmp_path / "smoke/full/augment/manifest.json").is_file()
