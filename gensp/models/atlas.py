"""What a model keeps of the shapes it learnt from: a surface that they share (ours)."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from gensp.geometry.distortion import isometric_distortion, singular_values
from gensp.geometry.mesh import Mesh
from gensp.geometry.spherical_map import SphericalMap
from gensp.models.network import Network


class Atlas(Network):
    """The shared surface of Stage III-a: no weights, but part of the model.

    A shape that the model has never seen is registered to those it resembles.

    Parameters
    ----------
    shapes, vertices, faces, latent, degrees
        Sizes k, n, m, d, l.

    Attributes
    ----------
    sphere
        Unit positions (n, 3) of the shared vertices: where the generator has them.
    placed
        Unit positions (n, 3) where maps have them: the same, or what distorts all shapes least.
    triangles
        Shared triangles (m, 3).
    images
        Shared vertices (k, n, 3) on every shape.
    maps
        Where every shape's own bijective map has them (k, n, 3).
    signals
        Harmonic coefficients (k, l, o) of the maps' densities, as real and imaginary part: what
        maps are turned to each other by. None where the maps agree without a turn.
    codes
        Codes (k, d) of the shapes.
    """

    sphere: Tensor
    placed: Tensor
    triangles: Tensor
    images: Tensor
    maps: Tensor
    signals: Tensor
    codes: Tensor

    def __init__(
        self, shapes: int, vertices: int, faces: int, latent: int, degrees: int = 0
    ) -> None:
        super().__init__()
        self.settings: dict[str, Any] = {
            "shapes": shapes,
            "vertices": vertices,
            "faces": faces,
            "latent": latent,
            "degrees": degrees,
        }
        self.register_buffer("sphere", torch.zeros((vertices, 3)))
        self.register_buffer("placed", torch.zeros((vertices, 3)))
        self.register_buffer("triangles", torch.zeros((faces, 3), dtype=torch.int32))
        self.register_buffer("images", torch.zeros((shapes, vertices, 3)))
        self.register_buffer("maps", torch.zeros((shapes, vertices, 3)))
        orders = max(0, 2 * degrees - 1)
        self.register_buffer("signals", torch.zeros((shapes, degrees, orders, 2)))
        self.register_buffer("codes", torch.zeros((shapes, latent)))

    @classmethod
    def of(cls, shared: Mapping[str, np.ndarray], codes: Tensor, *, limit: int = 100) -> "Atlas":
        """From the arrays of a shared surface and the codes of the same shapes.

        Of more than `limit` shapes those are kept whose codes lie farthest apart.
        """
        kept = _spread(codes, limit)
        images = shared["images"][kept]
        signals = shared.get("signals", np.zeros((len(codes), 0, 0), dtype=np.complex64))[kept]
        sizes = len(images), images.shape[1], len(shared["faces"]), codes.shape[1]
        atlas = cls(*sizes, signals.shape[1])
        atlas.sphere.copy_(torch.tensor(shared["sphere"]))
        atlas.placed.copy_(atlas.sphere)
        atlas.triangles.copy_(torch.tensor(shared["faces"]))
        atlas.images.copy_(torch.from_numpy(images))
        atlas.maps.copy_(torch.from_numpy(shared["maps"][kept]))
        atlas.signals.copy_(torch.view_as_real(torch.from_numpy(signals)))
        atlas.codes.copy_(codes[kept])
        return atlas

    @property
    def faces(self) -> Int[np.ndarray, "m 3"]:
        """The shared triangles, as meshes have them."""
        faces: np.ndarray = self.triangles.numpy().astype(np.int64)
        return faces

    def place(self, p: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3"]:
        """Where maps have what the generator has at unit positions p; the same for all shapes."""
        if torch.equal(self.placed, self.sphere):
            return p
        sphere = self.sphere.double().numpy()
        at = SphericalMap(sphere, sphere, self.faces, "shared surface").locate(p)
        placed: np.ndarray = at.on(self.placed.double().numpy(), self.faces)
        return placed / np.linalg.norm(placed, axis=1, keepdims=True)

    def _load_from_state_dict(self, state: dict[str, Any], prefix: str, *rest: Any) -> None:
        """Models written before there was a placement have their vertices where they are."""
        state.setdefault(f"{prefix}placed", state.get(f"{prefix}sphere"))
        super()._load_from_state_dict(state, prefix, *rest)

    def novelty(self, code: Tensor) -> float:
        """Distance of a code (d,) to the nearest kept one, over the median of the kept ones'.

        About 1 for shapes such as those learnt from; infinite where only one is known.
        """
        gaps = torch.cdist(self.codes, self.codes)
        own = gaps.fill_diagonal_(torch.inf).amin(dim=1).median()
        nearest = (self.codes - code).norm(dim=1).min()
        return float(nearest / own) if torch.isfinite(own) and own > 0 else float("inf")

    def stretch(self, positions: Float[np.ndarray, "n 3"]) -> float:
        """How far the shared vertices at `positions` are from the known shape that is most alike.

        1 less the area-weighted mean of 1/σ from that shape, σ the isometric distortion (paper
        §5.1): 0 for a known shape that is only bent, towards 1 where no part has a like part.
        """
        images = self.images.double().numpy()
        return min(_stretch(Mesh(image, self.faces), positions) for image in images)

    def without(self, shapes: Collection[int]) -> "Atlas":
        """The same but for some of the known shapes, given by their places."""
        kept = [k for k in range(len(self.codes)) if k not in shapes]
        fewer = Atlas(**{**self.settings, "shapes": len(kept)})
        each = ("images", "maps", "signals", "codes")
        state = self.state_dict()
        fewer.load_state_dict({**state, **{name: state[name][kept] for name in each}})
        return fewer


def _stretch(mesh: Mesh, positions: Float[np.ndarray, "n 3"]) -> float:
    areas = mesh.face_areas
    solid = areas > 0
    sigma = isometric_distortion(singular_values(mesh.vertices, positions, mesh.faces[solid]))
    return float(1 - np.average(1 / sigma, weights=areas[solid]))


def _spread(codes: Tensor, limit: int) -> list[int]:
    """Places of codes by farthest points, all of them in order where they are few."""
    if len(codes) <= limit:
        return list(range(len(codes)))
    chosen = [int((codes - codes.mean(dim=0)).norm(dim=1).argmin())]
    gap = (codes - codes[chosen[0]]).norm(dim=1)
    while len(chosen) < limit:
        chosen.append(int(gap.argmax()))
        gap = torch.minimum(gap, (codes - codes[chosen[-1]]).norm(dim=1))
    return sorted(chosen)
