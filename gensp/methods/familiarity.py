"""How far a shape is from those that a model learnt from, by what the fit made of it (ours)."""

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Float

from gensp.geometry.distance import closest_point
from gensp.geometry.mesh import Mesh
from gensp.geometry.spherical_map import SphericalMap
from gensp.methods.fitting import SurfaceOnSphere
from gensp.models.atlas import Atlas

# Of models that have none of their own: about what models of the package have.
LIMITS: Mapping[str, float] = {"gap": 0.0015, "stretch": 0.35}
SIGNALS = tuple(LIMITS)
_WRITTEN = {"gap": ".3%", "stretch": ".2f"}


def signals(
    atlas: Atlas, code: Float[np.ndarray, " d"], fitted: SurfaceOnSphere, mesh: Mesh
) -> dict[str, float]:
    """Novelty of a shape's code, gap that the fit leaves, stretch from the nearest known shape.

    The gap is the mean distance from the vertices of the fitted surface to the shape, over √area:
    large where the surface has parts that the shape has not. The stretch (`Atlas.stretch`) is
    that of the shared surface where it meets the shape: large where parts are made of others. The
    novelty (`Atlas.novelty`) knows nothing of the fit, and no limit is put on it: a lying animal
    has a strange code and a good map, a hand the code of a body.

    Parameters
    ----------
    code
        Of the shape (d,).
    fitted
        The surface that the map is read off.
    mesh
        The shape.
    """
    bent, shared = fitted.mesh, atlas.sphere.double().numpy()
    distance = closest_point(bent.vertices, mesh).distance
    placed = SphericalMap(fitted.sphere, bent.vertices, bent.faces).to_surface(shared)
    on_shape = closest_point(placed, mesh).at.on(mesh.vertices, mesh.faces)
    return {
        "novelty": atlas.novelty(torch.from_numpy(code)),
        "gap": float(distance.mean() / np.sqrt(mesh.area)),
        "stretch": atlas.stretch(on_shape),
    }


def beyond(found: Mapping[str, float], limits: Mapping[str, float]) -> str:
    """Which signals are above their limits, in words; empty where none is."""
    return " and ".join(
        f"{told(name, found[name])} above {format(limits[name], _WRITTEN[name])}"
        for name in SIGNALS
        if found[name] > limits[name]
    )


def told(name: str, value: float) -> str:
    """A signal as it is written, after its name."""
    return f"{name} {format(value, _WRITTEN[name])}"
