"""One process at a time in a run folder.

The lock is on a hidden file in the folder, opened for writing as NFS requires. The system gives it
back when its holder dies, however that happens; the file that stays then is taken by the next.
"""

import contextlib
import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gensp.errors import RunInUse
from gensp.files import unwritable
from gensp.machine import first_process
from gensp.runs import LOCK
from gensp.terminal import warn

try:
    import fcntl
except ImportError:  # pragma: no cover - Windows has no such locks
    fcntl = None  # type: ignore[assignment]

_NO_LOCKS = {errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL, errno.EBADF}


@contextmanager
def occupied(folder: Path) -> Iterator[None]:
    """Hold a folder for this process, or for the ranks that it leads; made where it is missing.

    A folder in which nothing was written is removed again. Where the system or the file system has
    no locks, the folder is taken as it is, with a warning.

    Raises
    ------
    RunInUse
        Another process holds it.
    OutputError
        The folder cannot be made or written.
    """
    if not first_process():
        yield
        return
    made = _make(folder)
    try:
        with _held(folder):
            yield
    finally:
        for path in made:
            with contextlib.suppress(OSError):
                path.rmdir()


def _make(folder: Path) -> list[Path]:
    """Make a folder; those that were missing, the deepest first."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(folder, error, "paths.runs") from error
    return missing


@contextmanager
def _held(folder: Path) -> Iterator[None]:
    handle = _open_locked(folder)
    try:
        yield
    finally:
        # Removed before it is given back: what another process opened meanwhile is no lock then.
        with contextlib.suppress(OSError):
            (folder / LOCK).unlink()
        os.close(handle)


def _open_locked(folder: Path) -> int:
    """The lock's file, opened, locked and still the one in the folder."""
    path = folder / LOCK
    while True:
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError as error:
            raise unwritable(folder, error, "paths.runs") from error
        try:
            _lock(handle, folder)
            if path.exists() and os.path.samestat(os.fstat(handle), path.stat()):
                return handle
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)


def _lock(handle: int, folder: Path) -> None:
    if fcntl is None:
        _warn(folder, "this system has none")
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise RunInUse(
            f"{folder}: another process works in it; one at a time is required; wait for it and "
            "run the same command again, or choose name=NEW"
        ) from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        _warn(folder, error.strerror or str(error))


def _warn(folder: Path, reason: str) -> None:
    warn(f"{folder}: cannot be locked ({reason}); start no second command that writes into it")
