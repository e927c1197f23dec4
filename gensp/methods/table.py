"""Methods by name that map one shape without training, as conf/method/ has them."""

from collections.abc import Callable

import numpy as np

from gensp.errors import Unsupported
from gensp.geometry.flow import StepSchedule
from gensp.methods import SphericalParameterization
from gensp.methods.arap import ARAP
from gensp.methods.cmcf import CMCF
from gensp.methods.hierarchical import ahsp, dirichlet, smat, stretch
from gensp.methods.planar import PlanarReduction
from gensp.methods.refinement import CertifiedRefinement, NoRefinement

DEFAULT = "dirichlet"
# The authors of the flow take the step 0.1 at area 1, and four times the cotangent matrix.
_AUTHORS_STEP = 0.4 * 4 * np.pi


def _flow() -> SphericalParameterization:
    return CMCF(refine=CertifiedRefinement())


def _raw_flow() -> SphericalParameterization:
    return CMCF(
        refine=NoRefinement(),
        step=StepSchedule(_AUTHORS_STEP, 1.0, _AUTHORS_STEP),
        tolerance=0.0,
        intrinsic=False,
        full=True,
        patience=None,
        name="cmcf_raw",
    )


def _rigid() -> SphericalParameterization:
    return ARAP(start=dirichlet())


_Make = Callable[[], SphericalParameterization]
# Every map of these is certified, or they raise.
CERTIFIED: dict[str, _Make] = {
    "dirichlet": dirichlet,
    "stretch": stretch,
    "ahsp": ahsp,
    "smat": smat,
    "cmcf": _flow,
}
# The results of these are taken as they are: faces may be folded.
RAW: dict[str, _Make] = {"arap": _rigid, "vc25": PlanarReduction, "cmcf_raw": _raw_flow}
PER_SHAPE = {**CERTIFIED, **RAW}


def per_shape(name: str) -> SphericalParameterization:
    """The method of this name, ready to be called with a mesh.

    Raises
    ------
    Unsupported
        No method has this name, or it needs a trained model.
    """
    if name == "gensp":
        raise Unsupported(
            "method 'gensp': has no networks of its own; a trained model is required; name it "
            "with --model, or load it with gensp.load"
        )
    if name not in PER_SHAPE:
        raise Unsupported(
            f"method '{name}': is not known; one of {', '.join(PER_SHAPE)} is required; name one "
            "of them, or pass what gensp.load(MODEL) returns; python train.py method= has more"
        )
    return PER_SHAPE[name]()
