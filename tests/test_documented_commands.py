"""Every command that a page shows is one: it composes, or its words are read, without running."""

import argparse
import itertools
import re
import runpy
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import pytest
import typer
from commands import ROOT
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), ROOT / "data" / "README.md"]
FENCED = re.compile(r"^```\w*\n(.*?)^```", re.DOTALL | re.MULTILINE)
INLINE = re.compile(r"`([^`]*)`")
SETTING = re.compile(r"^(?:[A-Z_]+=\S+ +)*")  # of the environment, before a command
OPEN = re.compile("[…<]|COMMAND")
PROGRAMS = ("python train.py", "torchrun", "srun", "gensp", "make", "python benchmarks/")


def shown(page: Path) -> list[str]:
    """Commands of a page, in fences and in the text, comments left out.

    In the text a program is often named without what it needs: those that end there are left out,
    and so is what leaves something open.
    """
    text = page.read_text()
    blocks = [block.replace("\\\n", " ") for block in FENCED.findall(text)]
    lines = [line for block in blocks for line in block.splitlines()]
    named = (" ".join(found.split()) for found in INLINE.findall(FENCED.sub("", text)))
    lines += [line for line in named if len(line.split()) > 2 and not OPEN.search(line)]
    bare = [SETTING.sub("", line.strip()) for line in lines]
    return [line for line in bare if line.startswith(PROGRAMS)]


COMMANDS = [(page.name, line) for page in PAGES for line in dict.fromkeys(shown(page))]


def of(*programs: str) -> Any:
    """The commands of some programs, for a test."""
    found = [command for command in COMMANDS if command[1].startswith(programs)]
    return pytest.mark.parametrize(("page", "line"), found)


def jobs(words: list[str]) -> list[list[str]]:
    """What a command line runs: under -m every combination of the listed choices."""
    if "-m" not in words:
        return [words]
    choices = []
    for word in (word for word in words if word != "-m"):
        key, values = word.split("=", 1)
        choices.append([f"{key}={value}" for value in values.split(",")])
    return [list(job) for job in itertools.product(*choices)]


def test_pages_show_commands_of_every_program() -> None:
    assert len({page for page, _ in COMMANDS}) >= 4
    for program in PROGRAMS:
        assert sum(line.startswith(program) for _, line in COMMANDS) >= 2, program
    assert len(COMMANDS) >= 100


@of("python train.py", "torchrun", "srun")
def test_a_shown_command_composes(page: str, line: str, tmp_path: Path) -> None:
    words = shlex.split(line.replace("FOLDER", str(tmp_path)), comments=True)
    if "train.py" not in words:
        return  # how many processes torchrun or srun starts, within a sentence
    start, words = words[: words.index("train.py")], words[words.index("train.py") + 1 :]
    if start[0] == "torchrun":
        from torch.distributed.run import get_args_parser

        get_args_parser().parse_args([*start[1:], "train.py", *words])
    if words == ["--help"]:
        return  # run by tests/test_config.py
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        for job in jobs(words):
            cfg = compose("config", overrides=job)
            assert OmegaConf.to_container(cfg, resolve=True, throw_on_missing=True)


@of("gensp")
def test_a_shown_command_of_the_console_is_read(page: str, line: str) -> None:
    from gensp.cli import commands

    command, words = typer.main.get_command(commands), shlex.split(line, comments=True)[1:]
    while hasattr(command, "commands"):
        command = command.commands[words.pop(0)]
    known = {option for entry in command.params for option in entry.opts}
    given = {word.split("=")[0] for word in words if word.startswith("--")}
    assert given <= known
    needed = [entry for entry in command.params if entry.required]
    if len(words) >= len(needed):  # an option alone is a mention
        assert command.make_context(command.name, words).params


@of("make")
def test_a_shown_target_is_made(page: str, line: str) -> None:
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    words = [word for word in shlex.split(line, comments=True)[1:] if "=" not in word]
    assert words
    assert set(words) <= set(targets)


class Read(Exception):
    """The words were read; what comes after would run."""


def _reading(name: str) -> Callable[..., NoReturn]:
    """A method of the parser that ends when it has read the words."""
    parse = getattr(argparse.ArgumentParser, name)

    def reads(self: argparse.ArgumentParser, *given: Any) -> NoReturn:
        parse(self, *given)
        raise Read

    return reads


@of("python benchmarks/")
def test_a_shown_benchmark_reads_its_words(
    page: str, line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    script, *words = shlex.split(line.replace("NAME", "heads"), comments=True)[1:]
    if "ArgumentParser" not in (ROOT / script).read_text():
        assert words == []
        return
    for name in ("parse_args", "parse_intermixed_args"):
        monkeypatch.setattr(argparse.ArgumentParser, name, _reading(name))
    monkeypatch.setattr(sys, "argv", [script, *words])
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    with pytest.raises(Read):
        runpy.run_path(str(ROOT / script), run_name="__main__")
