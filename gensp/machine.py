"""What computed a run: versions, the revision of the sources, the machine and its memory."""

import importlib.metadata
import os
import platform
import resource
import subprocess
from pathlib import Path
from typing import Any

_PACKAGES = ("gensp", "torch", "lightning", "numpy", "scipy", "libigl", "trimesh", "torchdiffeq")

# What launchers (torchrun, Lightning's own, Slurm, jsrun) call the place of a process.
_RANKS = ("RANK", "LOCAL_RANK", "NODE_RANK", "SLURM_PROCID", "JSM_NAMESPACE_RANK")


def first_process() -> bool:
    """Whether this is rank zero, or the only process: the one that speaks and tidies."""
    return all(os.environ.get(name, "0") == "0" for name in _RANKS)


def environment() -> dict[str, Any]:
    """Versions of what computed the run, the revision of the sources, the machine."""
    versions = {name: _version(name) for name in _PACKAGES}
    return {
        "versions": {"python": platform.python_version(), **versions},
        "revision": _revision(),
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
    }


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _revision() -> str | None:
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def peak_memory() -> float:
    """Largest resident size of this process or of one of its finished children, in GiB."""
    sizes = (
        resource.getrusage(who).ru_maxrss
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    unit = 1 if platform.system() == "Darwin" else 1024
    return max(sizes) * unit / 2**30
