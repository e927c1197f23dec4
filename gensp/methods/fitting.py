"""Fitting a generated surface to the shape it stands for, before the map is read off it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from gensp.geometry.mesh import Mesh, simplify
from gensp.geometry.registration import RegistrationSettings, register
from gensp.geometry.sphere import icosphere
from gensp.models.atlas import Atlas


@dataclass(frozen=True)
class SurfaceOnSphere:
    """A surface near a shape, and unit positions (k, 3) of its vertices on the sphere."""

    mesh: Mesh
    sphere: Float[np.ndarray, "k 3"]


@dataclass(frozen=True)
class Known:
    """What a model knows of the shape to be fitted, and of others.

    Attributes
    ----------
    code
        Latent code (d,) of the shape.
    generate
        g(z, ·) at unit positions (n, 3).
    atlas
        The shapes learnt from, if the model keeps them.
    """

    code: Float[np.ndarray, " d"]
    generate: Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, "n 3"]]
    atlas: Atlas | None = None


class NoFit:
    """The generated surface as it is: the paper's own map."""

    def __call__(self, generated: SurfaceOnSphere, mesh: Mesh, known: Known) -> SurfaceOnSphere:
        """The generated surface."""
        return generated


class RegisterFit:
    """As-rigid-as-possible registration of the generated surface to the shape, as in Stage III.

    A shape that the model has never seen is generated roughly; its own surface then says where
    exactly the icosphere belongs. The generated surface gives the start and the rest shape, so the
    consistency of the model carries over.

    Parameters
    ----------
    vertices
        The shape is simplified to so many before registration.
    level
        Finer icospheres are registered at this level and follow by prolonged displacements.
    registration
        Changes of the settings' defaults.
    """

    def __init__(
        self,
        *,
        vertices: int = 2500,
        level: int = 4,
        registration: Mapping[str, Any] | None = None,
    ) -> None:
        self.vertices = vertices
        self.level = level
        self.settings = RegistrationSettings(**(registration or {}))

    def __call__(self, generated: SurfaceOnSphere, mesh: Mesh, known: Known) -> SurfaceOnSphere:
        """The generated surface bent onto the shape.

        Raises
        ------
        RegistrationFailed
            The registration diverged.
        """
        surface = generated.mesh
        coarse = self._coarse(surface)
        fitted = register(coarse, [simplify(mesh, self.vertices)], settings=self.settings)
        displacement = prolong(fitted.vertices - coarse.vertices, len(surface.vertices))
        bent = surface.with_vertices(surface.vertices + displacement)
        return SurfaceOnSphere(bent, generated.sphere)

    def _coarse(self, generated: Mesh) -> Mesh:
        """The nested icosphere image of the level that is registered."""
        ball = icosphere(self.level)
        if len(generated.vertices) <= len(ball.vertices):
            return generated
        return Mesh(generated.vertices[: len(ball.vertices)], ball.faces, generated.name)


def prolong(values: Float[np.ndarray, "n c"], count: int) -> Float[np.ndarray, "k c"]:
    """Values at an icosphere's vertices continued to those of a finer one, at midpoints linearly.

    `count` is the number of vertices of the finer icosphere.
    """
    level = 0
    while 10 * 4**level + 2 < len(values):
        level += 1
    while len(values) < count:
        sides = icosphere(level).faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        edges = np.unique(np.sort(sides, axis=1), axis=0)
        values = np.concatenate([values, values[edges].mean(axis=1)])
        level += 1
    return values
