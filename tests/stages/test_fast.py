"""`debug=fast`: one batch or one item through every stage, nothing kept."""

from pathlib import Path

import pytest
from commands import STAGES, run_here, smoke_words


def listing(folder: Path) -> dict[Path, int]:
    paths = (path for path in folder.rglob("*") if path.is_file() and "cache" not in path.parts)
    return {path: path.stat().st_mtime_ns for path in paths}


def leaves_nothing(smoke: Path, *words: str) -> None:
    before = listing(smoke)
    run_here(*smoke_words(smoke), *words, "debug=fast")
    assert listing(smoke) == before


@pytest.mark.parametrize("stage", STAGES)
def test_one_batch(stage: str, smoke: Path) -> None:
    leaves_nothing(smoke, f"stage={stage}")


METHODS = ("cmcf", "cmcf_raw", "dirichlet", "stretch", "ahsp", "arap", "vc25")
OPTIONS = ("fit=register", "fit=guided", "refine=none", "refine=certify")


@pytest.mark.parametrize("word", [*OPTIONS, *(f"method={name}" for name in METHODS)])
def test_one_map(word: str, smoke: Path) -> None:
    leaves_nothing(smoke, "stage=parameterize", word)


def test_one_pair(smoke: Path) -> None:
    leaves_nothing(smoke, "stage=correspond", "correspond=paired")


@pytest.mark.parametrize("generator", ["direct", "flow"])
def test_other_generators(generator: str, smoke: Path) -> None:
    leaves_nothing(smoke, "stage=initialize", f"model/generator={generator}")
