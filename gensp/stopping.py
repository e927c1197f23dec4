"""What `kill`, a time limit and Ctrl-C do to a command: it ends at once, in one line."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, NoReturn

_DEFAULTS: dict[signal.Signals, Any] = {
    signal.SIGTERM: signal.SIG_DFL,
    signal.SIGINT: signal.default_int_handler,
}
_AGAIN = 0.1  # seconds until a signal that was lost is sent anew


@contextmanager
def one_line_stop(
    tell: Callable[[str], object],
    *,
    remedy: str = "the same command goes on from here",
    several: bool = False,
    patience: float | None = None,
) -> Iterator[None]:
    """End on SIGTERM or SIGINT with one line and exit code 128 + signal, like a shell.

    Lightning alone would note a SIGTERM and go on to the end of the items, and to the next stage;
    it calls a handler that it finds after its own. Nothing is lost: items and checkpoints are
    written by rename. A signal that is ignored (nohup), or handled by a launcher of jobs, stays
    so, and so do those of ranks: their launcher, or Lightning, ends all of them.

    Parameters
    ----------
    tell
        Puts the line where it is read.
    remedy
        What the line says of typing the command again.
    patience
        Seconds until the signal is sent anew where the command goes on all the same, because a
        library has swallowed what was raised, as some do while they are imported.
    """
    ours = [number for number, own in _DEFAULTS.items() if signal.getsignal(number) == own]
    ours = [] if several else ours
    stop = _Stop(sys.unraisablehook, lambda name: tell(f"stopped by {name}; {remedy}"), patience)
    try:
        with _installed(stop, ours):
            yield
    except (SystemExit, SystemError):
        # Lightning's own, without a code, where Python dropped ours; or compiled code's, which
        # hides ours.
        if stop.number:
            raise SystemExit(128 + stop.number) from None
        raise
    if stop.number:
        raise SystemExit(128 + stop.number)


@contextmanager
def _installed(stop: "_Stop", numbers: list[signal.Signals]) -> Iterator[None]:
    sys.unraisablehook = stop.retried
    for number in numbers:
        signal.signal(number, stop)
    try:
        yield
    finally:
        sys.unraisablehook = stop.others
        stop.again.cancel()
        for number in numbers:
            signal.signal(number, _DEFAULTS[number])


class _Stop:
    """The handler: says so once, raises SystemExit as often as it takes."""

    def __init__(
        self,
        others: Callable[[Any], object],
        tell: Callable[[str], object],
        patience: float | None,
    ) -> None:
        self.others, self.tell, self.patience, self.number = others, tell, patience, 0
        self.again = threading.Timer(_AGAIN, lambda: None)

    def __call__(self, number: int, frame: FrameType | None) -> NoReturn:
        first, self.number = not self.number, number
        # Another line may be half written: then that line is what is told.
        with suppress(RuntimeError):
            if first:
                self.tell(signal.Signals(number).name)
        if self.patience is not None:
            self._ask_in(self.patience)
        raise SystemExit(128 + number)

    def retried(self, lost: Any) -> None:
        """Python drops what is raised while it tidies up a generator: ask once more."""
        if not (self.number and isinstance(lost.exc_value, SystemExit)):
            self.others(lost)
            return
        self._ask_in(_AGAIN)

    def _ask_in(self, seconds: float) -> None:
        self.again.cancel()
        self.again = threading.Timer(seconds, os.kill, (os.getpid(), self.number))
        self.again.daemon = True
        self.again.start()
