"""Inner loops compiled by numba: half-edges, collapses, energies, relaxation.

They take plain arrays and check nothing; `gensp.geometry` is what calls them. Compilation takes
some seconds once, and is kept on disk.
"""

import hashlib
from pathlib import Path

from numba import config

# A loop that numba keeps holds the loops of other modules that it calls, but only its own module
# is looked at for changes. Here what is kept belongs to the text of the whole package.
_SOURCES = sorted(Path(__file__).parent.glob("*.py"))
_DIGEST = hashlib.sha256(b"".join(path.read_bytes() for path in _SOURCES)).hexdigest()[:16]

if not config.CACHE_DIR:
    config.CACHE_DIR = str(Path(__file__).parent / "__pycache__" / _DIGEST)


def kept() -> bool:
    """Whether the loops have been compiled before, so that a call does not wait for it."""
    return any(Path(config.CACHE_DIR).rglob("*.nbi"))
