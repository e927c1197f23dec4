"""Mistakes of the person at the keyboard as one line, in the words of `python train.py`."""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches

from hydra.errors import (
    CompactHydraException,
    ConfigCompositionException,
    HydraException,
    InstantiationException,
    MissingConfigException,
    OverrideParseException,
)
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from gensp.errors import GenSPError
from gensp.terminal import complain

_LISTED = 12  # known words that a line names one by one
_HELP = "python train.py --help lists them"
# The library names arguments; on the command line they are settings.
_ARGUMENTS = re.compile(r"(?<![\w.])(on_bad|max_faces)\b")


@contextmanager
def one_line_errors(*, sweep: bool) -> Iterator[None]:
    """Tell a GenSPError in one line: exit code 2, or a failed job that lets a sweep go on."""
    try:
        yield
    except GenSPError as error:
        line = _ARGUMENTS.sub(r"shapes.\1", str(error))
        if sweep:
            raise CompactHydraException(line) from None
        complain(line, of_all=error.of_all)
        raise SystemExit(2) from None


@contextmanager
def one_line_words() -> Iterator[None]:
    """Tell what Hydra cannot compose in one line, exit code 2; a failed job of a sweep with 1."""
    try:
        yield
    except InstantiationException:
        raise
    except HydraException as error:
        failed = type(error) is CompactHydraException
        complain(str(error) if failed else hydra_line(error))
        raise SystemExit(1 if failed else 2) from None


def hydra_line(error: Exception) -> str:
    """What was typed wrongly, what is known, and the nearest known word."""
    cause = error.__cause__
    if isinstance(error, MissingConfigException) and error.options:
        group, _, word = str(error.missing_cfg_file).rpartition("/")
        if word.startswith("submitit"):
            return (
                f"{group}={word}: the package 'hydra-submitit-launcher' is not installed; it is "
                "required; type: pip install 'gensp[slurm]'"
            )
        return _unknown(f"{group}={word}", f"{group} has no '{word}'", word, error.options, group)
    if isinstance(error, ConfigCompositionException) and isinstance(cause, OmegaConfBaseException):
        key, parent = str(cause.full_key), cause.parent_node
        if isinstance(parent, DictConfig):
            return _misspelt(key, str(cause.key), parent)
    if isinstance(error, OverrideParseException):
        quotes = "; words within a list need quotes, as in \"pipeline=[['stage=augment']]\""
        return (
            f"{error.override}: cannot be read; key=value or group=choice is required"
            f"{quotes if '[' in str(error.override) else ''}"
        )
    said = str(error).splitlines()[0].rstrip(".")
    several = re.fullmatch(r"Ambiguous value for argument '(.*)'", said)
    if several:
        return f"{several[1]}: several values; one is required; add -m to run one after the other"
    return f"{said}; {_HELP}"


def _misspelt(key: str, word: str, parent: DictConfig) -> str:
    table = key.removesuffix(word).rstrip(".")
    group = word.rpartition("/")[0]
    known = [f"{group}/{name}" for name in parent.get(group, ())] if group else list(parent)
    shown = [name for name in known if not name.startswith("_") and name != "hydra"]
    return _unknown(
        key, f"{table or 'the configuration'} has no '{word}'", word, shown, table, "."
    )


def _unknown(
    typed: str, found: str, word: str, known: Sequence[str], table: str, joint: str = "="
) -> str:
    """One line on a word that is not known, with the nearest that is."""
    near = get_close_matches(word, known, n=1)
    few = f"one of {', '.join(known)} is required" if 0 < len(known) <= _LISTED else _HELP
    remedy = f"; did you mean {table + joint if table else ''}{near[0]}?" if near else ""
    return f"{typed}: {found}; {few}{remedy}"
