"""Methods by name that map one shape without training."""

from collections.abc import Callable

from gensp.errors import Unsupported
from gensp.methods import SphericalParameterization
from gensp.methods.cmcf import CMCF
from gensp.methods.hierarchical import ahsp, dirichlet, smat, stretch
from gensp.methods.refinement import NewtonRefinement

DEFAULT = "dirichlet"


def _flow() -> SphericalParameterization:
    return CMCF(refine=NewtonRefinement())


PER_SHAPE: dict[str, Callable[[], SphericalParameterization]] = {
    "dirichlet": dirichlet,
    "stretch": stretch,
    "ahsp": ahsp,
    "smat": smat,
    "cmcf": _flow,
}


def per_shape(name: str) -> SphericalParameterization:
    """The method of this name, ready to be called with a mesh.

    Raises
    ------
    Unsupported
        No method has this name.
    """
    if name not in PER_SHAPE:
        raise Unsupported(
            f"method '{name}': is not known; one of {', '.join(PER_SHAPE)} is required; name one "
            "of them, or give a trained model with --model; train.py method= has more"
        )
    return PER_SHAPE[name]()
