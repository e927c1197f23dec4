"""Registration led by certified maps, and judged by strain (ours, not in the paper).

Closest points find the way between similar poses alone. A bijective map of each shape, made
without the other, says where its limbs are in any pose: two such maps with a rotation of the
sphere between them compose to a rough correspondence. Bent towards that as rigidly as it can be,
the source takes the target's pose, and closest points do the rest. Several starts are tried; the
one that strained the source least is nearest to the true correspondence.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from jaxtyping import Complex, Float

from gensp.errors import RegistrationFailed
from gensp.geometry.distance import ClosestPointTree
from gensp.geometry.mesh import Mesh
from gensp.geometry.registration import Registration, approached
from gensp.geometry.registration_step import (
    BendingSystem,
    Pull,
    RegistrationSettings,
    scale_of,
)
from gensp.geometry.rotation_registration import density_signal, register_rotation
from gensp.geometry.spherical_map import SphericalMap

# Stiff for long: poses differ by bending, which takes many steps to spread.
PATIENT = (
    (300.0, 15),
    (100.0, 15),
    (30.0, 10),
    (10.0, 8),
    (3.0, 5),
    (1.0, 4),
    (0.3, 3),
    (0.1, 3),
)
UNGUIDED, INVERSE = -1, -2
# A guide's point at distance d weighs 1/(1 + (d/ℓ)²) with ℓ = _FAR · median(d) + _NEAR.
_FAR, _NEAR = 2.0, 0.02


@dataclass(frozen=True)
class MappedShape:
    """A shape that takes part in registrations, with a bijective map of its own."""

    map: SphericalMap

    @cached_property
    def mesh(self) -> Mesh:
        """The shape."""
        return self.map.mesh

    @cached_property
    def signal(self) -> Complex[np.ndarray, "l o"]:
        """What two maps are turned to each other by."""
        return density_signal(self.map.sphere, self.map.faces, self.mesh.face_areas)


@dataclass(frozen=True)
class Guided:
    """The least strained registration, and which guide led there.

    −1 stands for closest points alone, −2 for the inverse of the registration the other way.
    """

    best: Registration
    guide: int


def guides(source: MappedShape, target: MappedShape, count: int) -> list[Float[np.ndarray, "n 3"]]:
    """Positions on the target of the source's vertices, for the `count` best rotations."""
    turns = register_rotation(source.signal, target.signal, candidates=count)
    return [target.map.to_surface(source.map.sphere @ turn.rotation.T) for turn in turns]


def register_guided(
    source: MappedShape, target: MappedShape, *, settings: RegistrationSettings, count: int = 3
) -> Guided:
    """Register by closest points from the source as it is, and from its pose by the best guide.

    Parameters
    ----------
    count
        Rotations that are tried; of their poses the least strained is registered.

    Raises
    ------
    RegistrationFailed
        Every start diverged.
    """
    bending = BendingSystem(source.mesh, settings)
    poses = {}
    for guide, positions in enumerate(guides(source, target, count) if count else []):
        with suppress(RegistrationFailed):  # the other starts are still to be tried
            poses[guide] = posed(bending, positions, settings, scale_of(target.mesh))
    starts = {UNGUIDED: source.mesh.vertices}
    if poses:
        led = min(poses, key=lambda guide: bending.strain(poses[guide]))
        starts[led] = poses[led]
    return least_strained(
        {
            guide: partial(approached, source.mesh, [target.mesh], settings, bending, start)
            for guide, start in starts.items()
        }
    )


def restarted(
    source: MappedShape,
    target: MappedShape,
    found: Guided,
    back: Guided,
    *,
    settings: RegistrationSettings,
) -> Guided:
    """A registration tried again from the inverse of the one back; the less strained of both.

    Bending a folded leg straight may succeed where bending it the other way did not.
    """
    bent = target.mesh.with_vertices(back.best.vertices)
    at = ClosestPointTree(bent).query(source.mesh.vertices).at
    positions = at.on(target.mesh.vertices, target.mesh.faces)
    bending = BendingSystem(source.mesh, settings)
    try:
        start = posed(bending, positions, settings, scale_of(target.mesh))
        again = approached(source.mesh, [target.mesh], settings, bending, start)
    except RegistrationFailed:
        return found
    return min(found, Guided(again, INVERSE), key=lambda guided: guided.best.strain)


def least_strained(attempts: Mapping[int, Callable[[], Registration]]) -> Guided:
    """Of several registrations, each under the number of its guide, the least strained.

    Raises
    ------
    RegistrationFailed
        Every one diverged.
    """
    found, failures = [], []
    for guide, attempt in attempts.items():
        try:
            found.append(Guided(attempt(), guide))
        except RegistrationFailed as error:
            failures.append(error)
    if not found:
        raise failures[0]
    return min(found, key=lambda guided: guided.best.strain)


def posed(
    bending: BendingSystem,
    positions: Float[np.ndarray, "n 3"],
    settings: RegistrationSettings,
    scale: float,
) -> Float[np.ndarray, "n 3"]:
    """The source's vertices near given positions, bent as rigidly as the schedule says.

    Positions that the others do not bear out lose their weight from one stiffness to the next.
    """
    vertices, weights = positions, np.ones(len(positions))
    for stiffness, steps in settings.posing:
        pull = Pull(bending.corners, positions, weights)
        for _ in range(int(steps)):
            vertices = bending.step(vertices, [pull], stiffness)
        away = np.linalg.norm(vertices - positions, axis=1)
        weights = 1 / (1 + np.square(away / (_FAR * np.median(away) + _NEAR * scale)))
    return vertices
