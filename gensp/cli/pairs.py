"""Two shapes for one command: their maps, and the rotation that brings them together."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import typer

from gensp.cli.inputs import chosen_method, is_map, map_of
from gensp.errors import NotGenusZero
from gensp.geometry.matching import aligning_rotation
from gensp.geometry.spherical_map import SphericalMap


@dataclass(frozen=True)
class Pair:
    """Maps of two shapes, and the rotation from the first one's sphere to the second's.

    Attributes
    ----------
    apart
        Files of those that may have a sphere of their own, which nobody said how to align.
    """

    a: SphericalMap
    b: SphericalMap
    rotation: np.ndarray
    apart: tuple[Path, ...] = ()

    @property
    def names(self) -> tuple[str, str]:
        """Two different names for files."""
        a, b = self.a.name, self.b.name
        return (a, b) if a != b else (f"{a}1", f"{b}2")


def pair_of(
    a: Path,
    b: Path,
    *,
    method: str | None = None,
    model: str | None = None,
    register: bool = False,
    align: bool | None = None,
) -> Pair:
    """Read or make the two maps; maps of meshes are aligned unless a model made them.

    Raises
    ------
    GenSPError
        An input cannot be used, or a map has folds.
    """
    meshes = not (is_map(a) and is_map(b))
    made = chosen_method(method, model, register) if meshes else None
    first, second = map_of(a, made), map_of(b, made)
    for path, map in ((a, first), (b, second)):
        found = map.certify()
        if not found:
            remedy = (
                "make it again with gensp parameterize" if is_map(path) else "leave out --method"
            )
            raise NotGenusZero(f"{path}: {found}; a bijective map is required; {remedy}")
    _require_one_side({a: first, b: second})
    wanted = meshes and model is None if align is None else align
    apart = _apart({a: first, b: second}) if align is None and not wanted else ()
    rotation = aligning_rotation(first, second) if wanted else np.eye(3)
    return Pair(first, second, rotation, apart)


def _require_one_side(maps: dict[Path, SphericalMap]) -> None:
    """Refuse a mirrored map beside one that is not: no rotation brings them together."""
    sides = {path: map.certify().orientation for path, map in maps.items()}
    mirrored = [path for path, side in sides.items() if side < 0]
    if 0 < len(mirrored) < len(sides):
        raise NotGenusZero(
            f"{mirrored[0]}: mirrors its surface, and the other map does not; maps of one "
            "orientation are required; make it again with gensp parameterize"
        )


def _apart(maps: dict[Path, SphericalMap]) -> tuple[Path, ...]:
    """Maps that no model has made, as far as files tell: a model's have a reliability."""
    # One file twice is one sphere.
    own = [path for path, map in maps.items() if is_map(path) and "reliability" not in map.arrays]
    return tuple(own) if len(maps) > 1 else ()


def tell_apart(pair: Pair) -> None:
    """Say on stderr which maps may agree only after a rotation; last, as it is no error."""
    if pair.apart:
        typer.echo(
            f"gensp: {', '.join(map(str, pair.apart))}: no array 'reliability', as in maps of a "
            "method without a model; such maps agree only after a rotation of the sphere; type "
            "--align if they are",
            err=True,
        )
