"""The console script `gensp`: commands for a person with one mesh, or two.

Every command does its work in functions of the library, which are imported when it runs.
"""

import sys
from typing import Annotated

import typer

from gensp import __version__
from gensp.cli.card import card
from gensp.cli.correspondence import match, transfer
from gensp.cli.faults import fault_line
from gensp.cli.meshes import check, repair
from gensp.cli.morph import morph
from gensp.cli.parameterize import parameterize
from gensp.cli.runs import runs
from gensp.cli.view import view
from gensp.stopping import one_line_stop

_PATIENCE = 0.5  # seconds in which a stopped command has tidied up

commands = typer.Typer(
    name="gensp",
    help=(
        "Maps closed genus-0 meshes to the sphere and uses such maps. Meshes are read from ply, "
        "obj, off and stl; maps from the npz that 'parameterize' writes. Collections are learnt "
        "by 'python train.py'. Exit codes: 0 done; 2 bad input, 130 Ctrl-C, with "
        "one line on stderr."
    ),
    epilog="Start with: gensp check cow.obj, then gensp parameterize cow.obj --out maps --texture",
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for command in (parameterize, check, repair, match, transfer, morph, view, card):
    commands.command()(command)
commands.add_typer(runs, name="runs")


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"gensp {__version__}")
        raise typer.Exit


@commands.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version.", callback=_print_version, is_eager=True
        ),
    ] = False,
) -> None:
    """What can be said before a command."""


def app() -> None:
    """Run the console script: exit code 0, or one line on stderr and 2, or 130 if interrupted."""
    remedy = "files are whole or absent; type the command again"
    with one_line_stop(_complain, remedy=remedy, patience=_PATIENCE):
        code = _run(sys.argv[1:] or ["--help"])
    sys.exit(code)


def _run(words: list[str]) -> int:
    try:
        return commands(words, prog_name="gensp", standalone_mode=False) or 0
    except typer.Abort:
        _complain("stopped; files are whole or absent; type the command again")
        return 130
    except Exception as error:
        line = fault_line(error)
        if line is None:
            raise
        typer.echo(line, err=True)
        return 2


def _complain(line: str) -> None:
    typer.echo(f"gensp: {line}", err=True)


__all__ = ["app", "commands"]
