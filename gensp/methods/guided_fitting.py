"""Fitting the surface that a model's shapes share to a new shape, led by certified maps."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from gensp.errors import RegistrationFailed, Unsupported
from gensp.geometry.guided_registration import (
    PATIENT,
    MappedShape,
    guides,
    least_strained,
    posed,
)
from gensp.geometry.mesh import Mesh, simplify
from gensp.geometry.registration import Registration, RegistrationSettings, approached
from gensp.geometry.registration_step import BendingSystem, Schedule, scale_of
from gensp.geometry.rotation_registration import register_rotation
from gensp.geometry.spherical_map import SphericalMap
from gensp.methods.fitting import Known, SurfaceOnSphere
from gensp.methods.hierarchical import dirichlet
from gensp.models.atlas import Atlas


@dataclass(frozen=True)
class Start:
    """A known or generated shape to be bent, and the positions from where."""

    source: Mesh
    vertices: Float[np.ndarray, "n 3"]
    strain: float = 0.0


class GuidedFit:
    """The shared surface registered to the shape from several starts, of which the least strained.

    Starts are the surface generated at the shape's own code; the shapes of nearest codes, as they
    are; and the shapes whose maps agree best with the map of this one, in its pose. Of the poses
    only the least strained are registered.

    Parameters
    ----------
    vertices
        The shape is simplified to so many before registration.
    neighbours
        Shapes of nearest codes, and as many poses that are registered.
    alike
        Shapes whose poses are tried.
    guides
        Rotations of the sphere that are tried for each of these; 0: no poses. None are tried for
        models whose known shapes all have agreeing maps (correspond=tree) either.
    registration
        Changes of the settings' defaults.
    schedule
        In place of the settings' own: it begins stiffer and takes longer.
    """

    def __init__(
        self,
        *,
        vertices: int = 2500,
        neighbours: int = 1,
        alike: int = 3,
        guides: int = 2,
        registration: Mapping[str, Any] | None = None,
        schedule: Schedule = PATIENT,
    ) -> None:
        self.vertices = vertices
        self.neighbours, self.alike, self.guides = neighbours, alike, guides
        self.settings = RegistrationSettings(**{**(registration or {}), "schedule": schedule})

    def __call__(self, generated: SurfaceOnSphere, mesh: Mesh, known: Known) -> SurfaceOnSphere:
        """The shared surface on the shape.

        Raises
        ------
        RegistrationFailed
            Every registration diverged.
        Unsupported
            The model keeps no shared surface.
        """
        atlas = _required(known.atlas)
        coarse = simplify(mesh, self.vertices)
        starts = self._near(known, atlas)
        if self.guides and atlas.signals.numel():
            starts += self._posed(MappedShape(dirichlet()(coarse)), atlas)
        best = least_strained(
            {k: partial(self._registered, start, coarse) for k, start in enumerate(starts)}
        ).best
        sphere = atlas.sphere.double().numpy()
        return SurfaceOnSphere(Mesh(best.vertices, atlas.faces, mesh.name), sphere)

    def _near(self, known: Known, atlas: Atlas) -> list[Start]:
        """The generated surface, and known shapes of nearest codes."""
        own = Mesh(known.generate(atlas.sphere.double().numpy()), atlas.faces, "generated")
        gaps = np.linalg.norm(atlas.codes.numpy() - known.code, axis=1)
        nearest = np.argsort(gaps, kind="stable")[: self.neighbours]
        shapes = [own, *(known_shapes(atlas)[k].mesh for k in nearest)]
        return [Start(shape, shape.vertices) for shape in shapes]

    def _posed(self, target: MappedShape, atlas: Atlas) -> list[Start]:
        """Known shapes in the pose of this one."""
        shapes = known_shapes(atlas)
        signals = torch.view_as_complex(atlas.signals).numpy().astype(np.complex128)
        agreement = [
            register_rotation(signal, target.signal, candidates=1)[0].correlation
            for signal in signals
        ]
        alike = np.argsort(-np.array(agreement), kind="stable")[: self.alike]
        poses = [pose for k in alike for pose in self._poses(shapes[k], target)]
        return sorted(poses, key=lambda start: start.strain)[: self.neighbours]

    def _poses(self, shape: MappedShape, target: MappedShape) -> list[Start]:
        bending, scale = BendingSystem(shape.mesh, self.settings), scale_of(target.mesh)
        found = []
        for positions in guides(shape, target, self.guides):
            with suppress(RegistrationFailed):  # the other starts are still to be tried
                pose = posed(bending, positions, self.settings, scale)
                found.append(Start(shape.mesh, pose, bending.strain(pose)))
        return found

    def _registered(self, start: Start, target: Mesh) -> Registration:
        bending = BendingSystem(start.source, self.settings)
        return approached(start.source, [target], self.settings, bending, start.vertices)


@lru_cache(maxsize=1)
def known_shapes(atlas: Atlas) -> list[MappedShape]:
    """The shapes that a model learnt from, with their own maps."""
    faces = atlas.faces
    pairs = zip(atlas.images.double().numpy(), atlas.maps.double().numpy(), strict=True)
    return [
        MappedShape(SphericalMap(map, image, faces, f"shape {k}"))
        for k, (image, map) in enumerate(pairs)
    ]


def _required(atlas: Atlas | None) -> Atlas:
    if atlas is None:
        raise Unsupported(
            "fit=guided: the model keeps no surface that its shapes share; one made since models "
            "do is required; run stage=finetune force=true, or choose fit=register"
        )
    return atlas
