"""`debug=fast`: one batch or one item through every stage, nothing kept."""

from pathlib import Path

import pytest
from commands import STAGES, run_here, smoke_words


def listing(folder: Path) -> dict[Path, int]:
    paths = (path for path in folder.rglob("*") if path.is_file() and "cache" not in path.parts)
    return {path: path.stat().st_mtime_ns for path in paths}


@pytest.mark.parametrize("stage", STAGES)
def test_one_batch(stage: str, smoke: Path) -> None:
    before = listing(smoke)
    run_here(*smoke_words(smoke), f"stage={stage}", "debug=fast")
    assert listing(smoke) == before


METHODS = ("cmcf", "cmcf_raw", "dirichlet", "stretch", "ahsp", "arap", "vc25")
OPTIONS = ("fit=register", "fit=guided", "refine=none", "refine=certify")


@pytest.mark.parametrize("word", [*OPTIONS, *(f"method={name}" for name in METHODS)])
def test_one_map(word: str, smoke: Path) -> None:
    run_here(*smoke_words(smoke), "stage=parameterize", "debug=fast", word)


def test_one_pair(smoke: Path) -> None:
    run_here(*smoke_words(smoke), "stage=correspond", "correspond=paired", "debug=fast")


@pytest.mark.parametrize("generator", ["direct", "flow"])
def test_other_generators(generator: str, smoke: Path) -> None:
    words = ("stage=initialize", "debug=fast", f"model/generator={generator}")
    run_here(*smoke_words(smoke), *words)
