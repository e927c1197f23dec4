"""What computed a run: versions, the revision of the sources, the machine and its memory."""

import contextlib
import importlib.metadata
import os
import platform
import resource
import socket
import subprocess
from pathlib import Path
from typing import Any

_PACKAGES = (
    *("gensp", "torch", "lightning", "numpy", "scipy", "libigl", "trimesh", "torchdiffeq"),
    *("numba", "scikit-image", "qdldl", "joblib", "hydra-core", "h5py"),
)

# What launchers (torchrun, Slurm, jsrun, Lightning's own) call the place of a process.
_RANKS = ("RANK", "SLURM_PROCID", "JSM_NAMESPACE_RANK", "LOCAL_RANK", "NODE_RANK")


def first_process() -> bool:
    """Whether this is rank zero, or the only process: the one that speaks and tidies."""
    return all(os.environ.get(name, "0") == "0" for name in _RANKS)


def rank() -> str:
    """The place of this process among those that were started together, as its launcher says."""
    return next((os.environ[name] for name in _RANKS if name in os.environ), "0")


def environment() -> dict[str, Any]:
    """Versions of what computed the run, the revision of the sources, the machine."""
    versions = {name: _version(name) for name in _PACKAGES}
    return {
        "versions": {"python": platform.python_version(), **versions},
        "revision": _revision(),
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        "processor": _processor(),
        "memory_gib": round(_memory(), 1),
    }


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _revision() -> str | None:
    """Of the repository that holds the package's sources; of an installed package its version.

    A repository around it, such as that of whoever installed it into a folder below, knows nothing
    of these files.
    """
    if _git("ls-files", "--error-unmatch", Path(__file__).name) is None:
        return _version("gensp")
    return _git("describe", "--always", "--dirty")


def _git(*words: str) -> str | None:
    """What git says of the folder of the package; None where it refuses or is missing."""
    command = ["git", "-C", str(Path(__file__).parent), *words]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def _processor() -> str:
    """Name of the processor, as far as the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def _memory() -> float:
    """Memory of the machine in GiB."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30


def forget_peak_memory() -> None:
    """Let `peak_memory` tell of what comes after, where the system can."""
    for process in ("self", *_children()):
        with contextlib.suppress(OSError):
            # 5 resets the largest resident size, see proc(5).
            Path(f"/proc/{process}/clear_refs").write_text("5", encoding="ascii")


def peak_memory() -> float:
    """Largest resident size, in GiB, of this process or of one of its children.

    Where the system cannot tell it of running processes, finished children are meant, and the
    size is the largest since the process began.
    """
    sizes = [_resident_peak(process) for process in ("self", *_children())]
    if sizes[0]:
        return max(sizes) / 2**20
    users = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    unit = 1 if platform.system() == "Darwin" else 1024
    return max(resource.getrusage(who).ru_maxrss for who in users) * unit / 2**30


def own_peak_memory() -> float:
    """Largest resident size of this process alone, in GiB."""
    unit = 1 if platform.system() == "Darwin" else 1024
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
    return (_resident_peak("self") * 1024 or most) / 2**30


def process_name() -> str:
    """Name of this process among those of all machines that share a folder."""
    return f"{socket.gethostname()}-{os.getpid()}"


# Files of workers, hidden and so no results; a resumed run removes those of the killed one.
_NOTED = ".memory-"
# Where workers leave them in a stage's folder; all others may hold a file for every item.
_PLACES = ("", "alternatives/", "rounds/*/", "settled/")


def note_peak_memory(folder: Path) -> None:
    """Leave the peak of this process in a folder, for whoever asked it to work there."""
    # Best effort: what cannot be noted must not cost the item.
    with contextlib.suppress(OSError):
        path = folder / f"{_NOTED}{process_name()}"
        path.write_text(f"{own_peak_memory():.6f}", encoding="ascii")


def noted_peak_memories(folder: Path) -> list[float]:
    """Take up what the workers have left, dead and replaced ones too: a peak of each, in GiB."""
    found = []
    for path in (path for place in _PLACES for path in folder.glob(f"{place}{_NOTED}*")):
        # One that was killed while it wrote left no number.
        with contextlib.suppress(OSError, ValueError):
            found.append(float(path.read_text(encoding="ascii")))
            path.unlink()
    return found


def _children() -> list[str]:
    """Processes that this one has started and that still run, where the system tells them."""
    try:
        found = [path.read_text() for path in Path("/proc/self/task").glob("*/children")]
    except OSError:
        return []
    return [process for listed in found for process in listed.split()]


def _resident_peak(process: str) -> int:
    """Largest resident size of a process in KiB; 0 where the system does not tell."""
    try:
        lines = Path(f"/proc/{process}/status").read_text(encoding="utf-8").splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith("VmHWM")), 0)
