"""Sweeps: one folder per variant, shared stages made once, a failed job stops no other."""

import json
from pathlib import Path

import pytest
from commands import STAGES, smoke_words, train

pytestmark = pytest.mark.slow

ABLATIONS = ("full", "no_da", "no_gp", "no_gr")


def test_all_ablations_by_one_command(smoke_copy: Path) -> None:
    done = train("-m", *smoke_words(smoke_copy), f"ablation={','.join(ABLATIONS)}")
    runs = smoke_copy / "smoke"
    made = {path.parent.relative_to(runs).as_posix() for path in runs.glob("*/*/manifest.json")}
    shared = {"no_da/augment", "no_gp/augment", "no_gp/implicit", "no_gr/augment"}
    assert {f"{name}/{stage}" for name in ABLATIONS for stage in STAGES} - shared <= made
    assert not shared & made
    # What was there before is kept, and says so.
    assert done.stdout.count("finished before") >= len(STAGES) + len(shared)
    tables = [
        json.loads((runs / name / "evaluate/summary.json").read_text()) for name in ABLATIONS
    ]
    assert all(table["groups"]["all"]["shapes"] == 6 for table in tables)


def test_a_failed_job_stops_no_other(tmp_path: Path) -> None:
    done = train("-m", *smoke_words(tmp_path), "stage=correspond,augment", code=1)
    assert "'correspond' needs 'augment'" in done.stderr
    assert "Traceback" not in done.stderr
    assert (tmp_path / "smoke/full/augment/manifest.json").is_file()
