"""What makes a training faster and must not change what it learns: precision and compilation.

Eqs. 5 and 12 are losses of derivatives, so their gradients are second derivatives. Whatever the
words say, they are computed in single precision, as their linear solve needs, and uncompiled, for
compiled functions have no second derivative. The encoder is not compiled: its maxima may fall
elsewhere.
"""

import os
import shutil
from collections.abc import Callable
from typing import Any

import torch

from gensp.errors import Unsupported

PRECISIONS = ("32-true", "bf16-mixed")
_COMPILERS = ("g++", "clang++", "c++")


def require_fast(precision: Any, compiled: bool) -> None:
    """Refuse words under which the gradients are not those of the plain training.

    Parameters
    ----------
    precision
        `trainer.precision`.
    compiled
        `compile`.

    Raises
    ------
    Unsupported
        Another precision than `PRECISIONS`, or there is no compiler.
    """
    if str(precision) not in PRECISIONS:
        raise Unsupported(
            f"trainer.precision={precision}: the geometric terms of the losses need second "
            f"derivatives in single precision; {' or '.join(PRECISIONS)} is required"
        )
    wanted = [name for name in (os.environ.get("CXX"), *_COMPILERS) if name]
    if compiled and not any(map(shutil.which, wanted)):
        raise Unsupported(
            f"compile=true: no C++ compiler was found ({', '.join(wanted)}), and torch.compile "
            "needs one; install g++ or name one by the variable CXX, or leave the word out"
        )


def compiled_call(network: Callable[..., Any]) -> Callable[..., Any]:
    """The network for first derivatives, its weights shared."""
    return torch.compile(network, dynamic=True)


def single_precision(device: torch.device) -> torch.autocast:
    """A context in which mixed precision is off."""
    return torch.autocast(device.type, enabled=False)
