"""One process at a time in a run folder.

The lock is on the folder itself: nothing is left behind, and the system gives it back when its
holder dies, however that happens.
"""

import contextlib
import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gensp.errors import OutputError, RunInUse
from gensp.machine import first_process

try:
    import fcntl
except ImportError:  # pragma: no cover - Windows has no such locks
    fcntl = None  # type: ignore[assignment]

_NO_LOCKS = {errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL, errno.EBADF}


@contextmanager
def occupied(folder: Path) -> Iterator[None]:
    """Hold a folder for this process, or for the ranks that it leads; made where it is missing.

    A folder in which nothing was written is removed again. File systems without locks are taken
    as they are.

    Raises
    ------
    RunInUse
        Another process holds it.
    OutputError
        The folder cannot be made.
    """
    if fcntl is None or not first_process():
        yield
        return
    made = _make(folder)
    handle = os.open(folder, os.O_RDONLY)
    try:
        _lock(handle, folder)
        yield
    finally:
        os.close(handle)
        for path in made:
            with contextlib.suppress(OSError):
                path.rmdir()


def _make(folder: Path) -> list[Path]:
    """Make a folder; those that were missing, the deepest first."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"{folder}: cannot be written ({error.strerror}); free space or permission is "
            "required; name another folder with paths.runs=FOLDER"
        ) from error
    return missing


def _lock(handle: int, folder: Path) -> None:
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
