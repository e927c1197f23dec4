"""Point cloud encoder e^γ: PointNet++ with the neighbourhood search kept apart.

Source: paper appendix B.5; Qi et al., PointNet++, NeurIPS 2017.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn.functional import silu

from gensp.models.network import Network


@dataclass(frozen=True)
class Grouping:
    """Which points form which neighbourhood, level by level, for a batch of b clouds.

    Attributes
    ----------
    centres
        For every level, indices (b, c) of the centres among the points of the level before.
    neighbours
        For every level, indices (b, c, k) of the points around each centre.

    Notes
    -----
    A grouping depends on the cloud alone and costs more than the network behind it, so training
    computes it once per cloud.
    """

    centres: tuple[Int[Tensor, "b _"], ...]
    neighbours: tuple[Int[Tensor, "b _ _"], ...]

    @classmethod
    def cat(cls, groupings: Sequence["Grouping"]) -> "Grouping":
        """One batch of several batches."""
        centres = zip(*(g.centres for g in groupings), strict=True)
        neighbours = zip(*(g.neighbours for g in groupings), strict=True)
        return cls(
            tuple(torch.cat(level) for level in centres),
            tuple(torch.cat(level) for level in neighbours),
        )

    def to(self, device: torch.device | str) -> "Grouping":
        """The same indices on another device."""
        return Grouping(
            tuple(level.to(device) for level in self.centres),
            tuple(level.to(device) for level in self.neighbours),
        )


def farthest_points(points: Float[Tensor, "b n 3"], count: int) -> Int[Tensor, "b {count}"]:
    """Farthest point sampling, all clouds at once.

    The first point is the one farthest from the centroid, so that the chosen set does not depend
    on the order of the points.
    """
    chosen = [_squared_distance(points, points.mean(dim=1, keepdim=True)).argmax(dim=1)]
    distance = torch.full(points.shape[:2], torch.inf, dtype=points.dtype, device=points.device)
    for _ in range(count - 1):
        latest = _take(points, chosen[-1][:, None])
        distance = torch.minimum(distance, _squared_distance(points, latest))
        chosen.append(distance.argmax(dim=1))
    return torch.stack(chosen, dim=1)


def nearest_groups(
    points: Float[Tensor, "b n 3"],
    centres: Float[Tensor, "b c 3"],
    size: int,
    radius: float | None = None,
) -> Int[Tensor, "b c {size}"]:
    """The `size` nearest points of every centre; those beyond `radius` give way to the nearest."""
    squared = torch.stack([_squared_distance(points, c[:, None]) for c in centres.unbind(1)], 1)
    near, index = squared.topk(size, dim=2, largest=False)
    if radius is None:
        return index
    return torch.where(near <= radius**2, index, index[..., :1])


def _squared_distance(
    points: Float[Tensor, "b n 3"], to: Float[Tensor, "b 1 3"]
) -> Float[Tensor, "b n"]:
    return (points - to).square().sum(dim=2)


def _take(values: Float[Tensor, "b n f"], index: Int[Tensor, "b k"]) -> Float[Tensor, "b k f"]:
    return values.gather(1, index[..., None].expand(-1, -1, values.shape[2]))


class SetAbstraction(nn.Module):
    """One level: points with features → centres with the pooled features of their groups.

    The first layer acts on points and on centres separately, before the points are copied into
    their groups, which is the same map at a fraction of the cost. LayerNorm after the pooling
    keeps the codes of different shapes from collapsing early in training.
    """

    def __init__(self, features: int, width: int, outputs: int) -> None:
        super().__init__()
        self.point = nn.Linear(3 + features, width)
        self.centre = nn.Linear(3, width, bias=False)
        self.shared = nn.Linear(width, outputs)
        self.norm = nn.LayerNorm(outputs)

    def forward(
        self,
        points: Float[Tensor, "b n _"],
        centres: Float[Tensor, "b c 3"],
        neighbours: Int[Tensor, "b c k"],
    ) -> Float[Tensor, "b c _"]:
        """Features (b, c, outputs) of the centres; `points` carries positions, then features."""
        batch, count, size = neighbours.shape
        grouped = _take(self.point(points), neighbours.reshape(batch, count * size))
        grouped = grouped.reshape(batch, count, size, -1) - self.centre(centres)[:, :, None]
        return self.norm(silu(self.shared(silu(grouped))).amax(dim=2))


class PointNet2Encoder(Network):
    """PointNet++: nested neighbourhoods, a shared layer and a maximum in each.

    Parameters
    ----------
    latent
        Dimension d of the code.
    width
        Features of the first level; they double from level to level.
    groups
        Centres and neighbours per centre of every level.
    radii
        Largest distance of a neighbour at every level, or nothing for plain nearest neighbours.
    points, draws
        Size and number of the clouds whose mean code is a shape's, once the encoder is trained.
    """

    origin: Tensor

    def __init__(
        self,
        latent: int = 256,
        width: int = 64,
        groups: Sequence[Sequence[int]] = ((128, 16), (32, 16)),
        radii: Sequence[float | None] | None = None,
        points: int | None = None,
        draws: int | None = None,
    ) -> None:
        super().__init__()
        groups = [list(level) for level in groups]
        radii = [None] * len(groups) if radii is None else list(radii)
        self.settings = {"latent": latent, "width": width, "groups": groups, "radii": radii}
        self.settings |= {"points": points, "draws": draws}
        outputs = [2 * width << level for level in range(len(groups))]
        features = [0, *outputs[:-1]]
        self.levels = nn.ModuleList(
            SetAbstraction(f, o // 2, o) for f, o in zip(features, outputs, strict=True)
        )
        self.whole = nn.Sequential(
            nn.Linear(3 + outputs[-1], 2 * outputs[-1]),
            nn.SiLU(),
            nn.Linear(2 * outputs[-1], 2 * outputs[-1]),
        )
        self.head = nn.Sequential(
            nn.LayerNorm(2 * outputs[-1]), nn.Linear(2 * outputs[-1], latent)
        )
        self.register_buffer("origin", torch.zeros(latent))

    @property
    def latent(self) -> int:
        """Dimension of the code."""
        return int(self.settings["latent"])

    @torch.no_grad()
    def group(self, points: Float[Tensor, "b n 3"]) -> Grouping:
        """Neighbourhoods of every level, from the positions alone."""
        centres, neighbours = [], []
        for (count, size), radius in zip(
            self.settings["groups"], self.settings["radii"], strict=True
        ):
            centres.append(farthest_points(points, count))
            chosen = _take(points, centres[-1])
            neighbours.append(nearest_groups(points, chosen, size, radius))
            points = chosen
        return Grouping(tuple(centres), tuple(neighbours))

    def forward(
        self, points: Float[Tensor, "b n 3"], grouping: Grouping | None = None
    ) -> Float[Tensor, "b d"]:
        """Codes of the clouds, with the code of the sphere subtracted once it is known."""
        grouping = self.group(points) if grouping is None else grouping
        positions, features = points, points
        for level, centres, neighbours in zip(
            self.levels, grouping.centres, grouping.neighbours, strict=True
        ):
            positions = _take(positions, centres)
            pooled = level(features, positions, neighbours)
            features = torch.cat([positions, pooled], dim=2)
        code: Tensor = self.head(self.whole(features).amax(dim=1))
        return code - self.origin

    @torch.no_grad()
    def set_origin(self, sphere: Float[Tensor, "s n 3"]) -> None:
        """Shift all codes so that the mean code of these clouds of S_0 becomes zero.

        Their size and number are kept: codes of other clouds are not relative to S_0.
        """
        self.origin.add_(self(sphere).mean(dim=0))
        self.settings |= {"draws": sphere.shape[0], "points": sphere.shape[1]}
