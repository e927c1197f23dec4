"""GenSP on one mesh: encode, generate, fit, invert, refine (paper §4, appendix C)."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
import torch
from jaxtyping import Float

from gensp.data.clouds import point_clouds
from gensp.errors import Unsupported
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.refine import invert, reliability
from gensp.geometry.sphere import icosphere
from gensp.geometry.spherical_map import SphericalMap
from gensp.methods.familiarity import LIMITS, beyond, signals
from gensp.methods.fitting import Known, SurfaceOnSphere, prolong
from gensp.models import Atlas, Generator, PointNet2Encoder, load_model

T = TypeVar("T")
Fit = Callable[[SurfaceOnSphere, Mesh, Known], SurfaceOnSphere]
Refinement = Callable[[Mesh, np.ndarray, np.ndarray, np.ndarray], SphericalMap]


class GenSP:
    """Spherical parameterization by the learnt generator.

    Parameters
    ----------
    encoder, generator
        The trained networks e^γ and g^θ.
    level
        Icosphere whose image under the generator is inverted; level 6 has 40,962 vertices.
    fit
        Called with the generated surface, the mesh, and what the model knows; gives the surface to
        invert.
    refine
        Called with the mesh, a start and a target on the sphere (n, 3), and how far the target
        can be trusted (n,); gives the final map.
    points
        Size of the encoder's cloud; by default as in training.
    draws
        Number of clouds whose codes are averaged; by default as in training.
    atlas
        The shapes learnt from, where the model keeps them: what `fit` may start from.
    limits
        Above which gap or stretch (`familiarity.signals`) a shape is reported as far from those
        learnt from.
    own
        The surface that is fitted is the one generated at the shape's own code (1), the mean
        image of the shapes learnt from (0), or between. What all shapes share has no bias of its
        own, but it must resemble them.

    Raises
    ------
    Unsupported
        The encoder does not tell the clouds that it was trained on, and they are not given.
    """

    name = "gensp"

    def __init__(
        self,
        encoder: PointNet2Encoder,
        generator: Generator,
        *,
        fit: Fit,
        refine: Refinement,
        level: int = 6,
        points: int | None = None,
        draws: int | None = None,
        own: float = 1.0,
        atlas: Atlas | None = None,
        limits: Mapping[str, float] = LIMITS,
    ) -> None:
        self.encoder, self.generator = encoder.eval(), generator.eval()
        self.fit, self.refine = fit, refine
        self.level, self.own = level, own
        self.atlas, self.limits = atlas, limits
        self.points = _told("points", points, encoder)
        self.draws = _told("draws", draws, encoder)

    @classmethod
    def load(cls, path: Path | str, **settings: Any) -> Self:
        """With the networks of a model.pt of Stage IV (or III-b).

        Raises
        ------
        Unsupported
            The file holds no encoder and generator.
        """
        networks = load_model(path)
        if networks.keys() - {"atlas"} != {"encoder", "generator"}:
            raise Unsupported(
                f"{path}: holds {', '.join(networks)}; encoder and generator are required; name "
                "the model.pt of stage=finetune or initialize"
            )
        return cls(**networks, **settings)  # type: ignore[arg-type]

    @torch.no_grad()
    def encode(self, mesh: Mesh) -> Float[np.ndarray, " d"]:
        """Latent code of a normalised mesh, from clouds that depend on the mesh alone."""
        clouds = torch.from_numpy(point_clouds(mesh, self.points, self.draws))
        code: np.ndarray = self.encoder(clouds).mean(dim=0).numpy()
        return code

    def generate(self, code: Float[np.ndarray, " d"], level: int | None = None) -> Mesh:
        """The image of the icosphere under g(z, ·), a mesh with the icosphere's faces."""
        ball = icosphere(self.level if level is None else level)
        return Mesh(self.generate_at(code, ball.vertices), ball.faces, "generated")

    @torch.no_grad()
    def generate_at(
        self, code: Float[np.ndarray, " d"], p: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 3"]:
        """g(z, p) at unit vectors."""
        z, at = torch.from_numpy(code)[None], torch.from_numpy(p.astype(np.float32))[None]
        image: np.ndarray = self.generator(z, at)[0].double().numpy()
        return image

    def place(self, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Where maps have what the generator has at p: one placement for all shapes."""
        return p if self.atlas is None else self.atlas.place(p)

    def fitted(
        self, shape: Mesh, code: Float[np.ndarray, " d"], generated: Mesh
    ) -> SurfaceOnSphere:
        """The surface that the map of a normalised mesh is read off.

        `generated` is the image at the shape's own code.
        """
        source = generated if self.own == 1 else self._towards_mean(code)
        known = Known(code, lambda p: self.generate_at(code, p), self.atlas)
        return self.fit(SurfaceOnSphere(source, icosphere(self.level).vertices), shape, known)

    def familiarity(
        self, shape: Mesh, code: Float[np.ndarray, " d"], fitted: SurfaceOnSphere
    ) -> dict[str, Any]:
        """How far a normalised mesh is from what the model knows, where it keeps that.

        Its signals, and in `far` which of them are above their limits.
        """
        if self.atlas is None:
            return {}
        found = signals(self.atlas, code, fitted, shape)
        return {**found, "far": beyond(found, self.limits)}

    def _towards_mean(self, code: Float[np.ndarray, " d"]) -> Mesh:
        """The mean image, with the part `own` of what the generator adds to it for a code."""
        mean: np.ndarray = self.generator.mean_code.numpy()
        image: np.ndarray = self.generator.mean_image.double().numpy()
        if len(image) == 0:
            raise Unsupported(
                f"own = {self.own:g}: the model holds no mean image; a model.pt of stage=finetune "
                "or initialize is required, or set recipe.fit.own=1"
            )
        surface = self.generate(mean + self.own * (code - mean))
        error = image - self.generate(mean).vertices[: len(image)]
        return surface.with_vertices(surface.vertices + prolong(error, len(surface.vertices)))

    def __call__(self, mesh: Mesh) -> SphericalMap:
        """Map a genus-0 mesh; the map's arrays keep the prediction, its surface and the code."""
        seconds: dict[str, float] = {}
        shape = normalize(mesh)
        code = _timed(seconds, "encode", lambda: self.encode(shape))
        generated = _timed(seconds, "generate", lambda: self.generate(code))
        fitted = _timed(seconds, "fit", lambda: self.fitted(shape, code, generated))
        found = _timed(
            seconds, "invert", lambda: invert(shape.vertices, fitted.mesh, fitted.sphere)
        )
        predicted = _timed(seconds, "place", lambda: self.place(found.sphere))
        trust = reliability(predicted, shape.faces, found.distance)
        refined = _timed(seconds, "refine", lambda: self.refine(mesh, predicted, predicted, trust))
        familiar = _timed(seconds, "compare", lambda: self.familiarity(shape, code, fitted))
        return replace(
            refined,
            diagnostics={
                **refined.diagnostics,
                **seconds,
                "seconds": sum(seconds.values()),
                **familiar,
            },
            arrays={
                **refined.arrays,
                "predicted": predicted,
                "reliability": trust,
                "generated": generated.vertices,
                "fitted": fitted.mesh.vertices,
                "fitted_faces": fitted.mesh.faces,
                "code": code,
            },
        )


def _told(name: str, given: int | None, encoder: PointNet2Encoder) -> int:
    """A number of the encoder's clouds: as given, or as in training."""
    number = given or encoder.settings[name]
    if not number:
        raise Unsupported(
            f"{name}: the encoder does not tell the clouds that it was trained on; the model.pt "
            f"of stage=finetune or initialize is required, or give {name}=NUMBER"
        )
    return int(number)


def _timed(seconds: dict[str, float], part: str, work: Callable[[], T]) -> T:
    start = time.perf_counter()
    result = work()
    seconds[f"seconds_{part}"] = time.perf_counter() - start
    return result
