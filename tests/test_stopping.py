"""Signals end a command in one line; what is not the default stays."""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress

import pytest

from gensp.cli import app
from gensp.stopping import one_line_stop
from gensp.terminal import complain


@pytest.fixture(autouse=True)
def _defaults() -> Iterator[None]:
    """Programs in the background ignore SIGINT; trainings of other tests may leave a handler."""
    defaults = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
    before = {number: signal.signal(number, own) for number, own in defaults.items()}
    yield
    for number, own in before.items():
        signal.signal(number, own)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_block_in_one_line(
    number: signal.Signals, capsys: pytest.CaptureFixture[str]
) -> None:
    before = signal.getsignal(number)
    with pytest.raises(SystemExit) as ended, one_line_stop(complain):
        _sent(number)
    assert ended.value.code == 128 + number
    said = f"error: stopped by {number.name}; the same command goes on from here\n"
    assert capsys.readouterr().err == said
    assert signal.getsignal(number) is before


def _hidden(*_: object, **__: object) -> None:
    """What numba makes of an exception of a handler that ran in compiled code."""
    try:
        _sent(signal.SIGINT)
    except BaseException as error:
        raise SystemError("returned a result with an exception set") from error


def _swallowed(*_: object, **__: object) -> None:
    """What a library does that tries whether it can import another."""
    with suppress(BaseException):
        _sent(signal.SIGINT)
    time.sleep(5)


@pytest.mark.parametrize("how", [_hidden, _swallowed, lambda *_, **__: _sent(signal.SIGINT)])
def test_the_console_script_is_stopped_in_one_line(
    how: Callable[..., None], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gensp.geometry.mesh.load_mesh", how)
    monkeypatch.setattr("sys.argv", ["gensp", "check", "cow.obj"])
    with pytest.raises(SystemExit) as ended:
        app()
    assert ended.value.code == 128 + signal.SIGINT
    line = "gensp: stopped by SIGINT; files are whole or absent; type the command again\n"
    assert capsys.readouterr().err == line


def test_a_block_that_swallows_its_end_is_stopped_at_the_end() -> None:
    with pytest.raises(SystemExit) as ended, one_line_stop(complain), suppress(SystemExit):
        _sent(signal.SIGINT)
    assert ended.value.code == 128 + signal.SIGINT


def test_a_fault_of_compiled_code_is_told_as_ever() -> None:
    with pytest.raises(SystemError), one_line_stop(complain):
        raise SystemError


def test_a_signal_that_python_drops_is_asked_for_again(capsys: pytest.CaptureFixture[str]) -> None:
    def tidied() -> Iterator[None]:
        try:
            yield
        finally:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(0.01)

    def lose() -> None:
        generator = tidied()
        next(generator)
        del generator  # its ending raises, and nobody is there to catch it
        time.sleep(5)

    with pytest.raises(SystemExit), one_line_stop(complain):
        lose()
    assert capsys.readouterr().err.count("stopped by") == 1


def test_a_signal_that_is_ignored_or_handled_stays_so() -> None:
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        with one_line_stop(complain):
            assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
            os.kill(os.getpid(), signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, before)


def test_other_exceptions_that_python_drops_are_told_as_ever() -> None:
    told: list[object] = []
    before, sys.unraisablehook = sys.unraisablehook, told.append
    try:
        with one_line_stop(complain):
            _drop(ValueError("a word"))
    finally:
        sys.unraisablehook = before
    assert len(told) == 1


def _sent(number: signal.Signals) -> None:
    os.kill(os.getpid(), number)
    time.sleep(5)


def _drop(error: Exception) -> None:
    class Ending:
        def __del__(self) -> None:
            raise error

    Ending()
