"""Every `python train.py …` that a page shows composes."""

import itertools
import re
import shlex
from pathlib import Path

import pytest
from commands import ROOT
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), ROOT / "data" / "README.md"]
FENCED = re.compile(r"^```\w*\n(.*?)^```", re.DOTALL | re.MULTILINE)
INLINE = re.compile(r"`(python train\.py[^`]*)`")


def shown(page: Path) -> list[str]:
    """Commands of a page, in fences and in the text, comments left out."""
    text = page.read_text()
    blocks = [block.replace("\\\n", " ") for block in FENCED.findall(text)]
    lines = [line for block in blocks for line in block.splitlines()]
    lines += [" ".join(found.split()) for found in INLINE.findall(FENCED.sub("", text))]
    return [line for line in lines if line.startswith("python train.py")]


COMMANDS = [(page.name, line) for page in PAGES for line in shown(page)]


def jobs(words: list[str]) -> list[list[str]]:
    """What a command line runs: under -m every combination of the listed choices."""
    if "-m" not in words:
        return [words]
    choices = []
    for word in (word for word in words if word != "-m"):
        key, values = word.split("=", 1)
        choices.append([f"{key}={value}" for value in values.split(",")])
    return [list(job) for job in itertools.product(*choices)]


def test_pages_show_commands() -> None:
    assert len({page for page, _ in COMMANDS}) >= 4
    assert len(COMMANDS) >= 15


@pytest.mark.parametrize(("page", "line"), COMMANDS)
def test_a_shown_command_composes(page: str, line: str, tmp_path: Path) -> None:
    words = shlex.split(line.replace("FOLDER", str(tmp_path)), comments=True)[2:]
    if words == ["--help"]:
        return  # run by tests/test_config.py
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        for job in jobs(words):
            cfg = compose("config", overrides=job)
            assert OmegaConf.to_container(cfg, resolve=True, throw_on_missing=True)
