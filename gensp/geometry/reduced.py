"""The reduced deformation model of the implicit regulariser (torch; Eq. 6, Appendix A).

A few deformation nodes carry a scaling s_i and a linearised rotation c_i each. With
q_ij = p_i − p_j and x_i = (s_i; c_i), node i and its neighbour j disagree by

    r_ij = A_i q_ij − (d_i − d_j) = Q_ij x_i − (d_i − d_j),    Q_ij = (q_ij, −[q_ij]×).
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True)
class Cover:
    """Deformation nodes and their overlapping neighbourhoods, as node–vertex pairs.

    `nodes` (l,) are vertices; a pair (i, j) says that vertex j lies in the neighbourhood N_i of
    the i-th node. Vertices that are nodes themselves lie in neighbourhoods of other nodes.
    """

    nodes: Int[Tensor, " l"]
    pairs: Int[Tensor, "e 2"]

    @property
    def centres(self) -> Int[Tensor, " e"]:
        """The vertex of the node of every pair."""
        return self.nodes[self.pairs[:, 0]]

    def to(self, device: torch.device | str) -> "Cover":
        """The same cover on another device."""
        return Cover(self.nodes.to(device), self.pairs.to(device))


@torch.no_grad()
def farthest_points(points: Float[Tensor, "m 3"], count: int) -> Int[Tensor, " l"]:
    """Farthest point sampling: each point is the one farthest from those before it.

    The first is the farthest from the centroid, so the choice does not hang on the order.
    """
    chosen = torch.empty(count, dtype=torch.long, device=points.device)
    latest = (points - points.mean(dim=0)).square().sum(dim=1).argmax()
    distance = torch.full_like(points[:, 0], torch.inf)
    for i in range(count):
        chosen[i] = latest
        distance = torch.minimum(distance, (points - points[latest]).square().sum(dim=1))
        latest = distance.argmax()
    return chosen


@torch.no_grad()
def deformation_cover(points: Float[Tensor, "m 3"], nodes: int, neighbours: int = 3) -> Cover:
    """Farthest-point nodes; every vertex joins its nearest nodes (Eq. 6).

    Every node also joins its own nearest vertices, so that three neighbours fix its rotation on
    any mesh. The neighbourhoods overlap, because a vertex lies in `neighbours` of them.

    Parameters
    ----------
    points
        Vertices of the discretised level set.
    nodes
        Number l of deformation nodes, at least 2 and at most m.
    neighbours
        How many nodes each vertex joins.
    """
    centres = farthest_points(points, min(nodes, len(points)))
    distance = torch.cdist(points[centres], points)
    distance[torch.arange(len(centres)), centres] = torch.inf  # no node neighbours itself
    near_nodes = distance.topk(min(neighbours, len(centres) - 1), dim=0, largest=False).indices
    near_vertices = distance.topk(min(neighbours, len(points) - 1), largest=False).indices
    joined = torch.zeros_like(distance, dtype=torch.bool)
    joined.scatter_(0, near_nodes, True)
    joined.scatter_(1, near_vertices, True)
    return Cover(centres, joined.nonzero())


def cross_matrices(q: Float[Tensor, "e 3"]) -> Float[Tensor, "e 3 3"]:
    """[q]×, the matrices of the cross products with q."""
    x, y, z = q.unbind(dim=1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=1).reshape(-1, 3, 3)


def pair_matrices(points: Float[Tensor, "m 3"], cover: Cover) -> Float[Tensor, "e 3 4"]:
    """Q_ij = (q_ij, −[q_ij]×) of every pair (Appendix A)."""
    q = points[cover.centres] - points[cover.pairs[:, 1]]
    return torch.cat([q[:, :, None], -cross_matrices(q)], dim=2)


def local_deformations(
    points: Float[Tensor, "m 3"],
    cover: Cover,
    displacements: Float[Tensor, "k m 3"],
    *,
    scale_weight: float,
) -> Float[Tensor, "k l 4"]:
    """Best scaling and rotation (s_i; c_i) of every node for given displacements (Eq. 6).

    s = Σ q·e / (Σ‖q‖² + η) and c = (Σ ‖q‖² I − q qᵀ)⁻¹ Σ q × e with e = d_i − d_j: the blocks of
    H⁻¹ Bᵀ d, where scaling and rotation do not mix.
    """
    node, vertex = cover.pairs.unbind(dim=1)
    matrices = pair_matrices(points, cover)
    stretch = displacements[:, cover.centres] - displacements[:, vertex]
    moments = torch.einsum("era,ker->eka", matrices, stretch)
    count = len(cover.nodes)
    rhs = moments.new_zeros(count, *moments.shape[1:]).index_add(0, node, moments)
    hessian = _node_hessians(matrices, node, count, scale_weight)
    return torch.linalg.solve(hessian, rhs.transpose(1, 2)).permute(2, 0, 1)


def reduced_energy(
    points: Float[Tensor, "m 3"],
    cover: Cover,
    displacements: Float[Tensor, "k m 3"],
    *,
    scale_weight: float,
) -> Float[Tensor, " k"]:
    """Deformation dᵀ L^φ d of displacements, pair by pair (Eq. 6, Appendix A).

    Zero exactly for rigid motions; a scaling costs only its η term, which Eq. 6 has once a node.
    """
    local = local_deformations(points, cover, displacements, scale_weight=scale_weight)
    return residual_energy(points, cover, displacements, local, scale_weight=scale_weight)


def residual_energy(
    points: Float[Tensor, "m 3"],
    cover: Cover,
    displacements: Float[Tensor, "k m 3"],
    local: Float[Tensor, "k l 4"],
    *,
    scale_weight: float,
) -> Float[Tensor, " k"]:
    """Σ ‖r_ij‖² + η Σ s_i² at given node deformations: the objective of Eq. 6."""
    node, vertex = cover.pairs.unbind(dim=1)
    rotated = torch.einsum("era,kea->ker", pair_matrices(points, cover), local[:, node])
    residual = rotated - displacements[:, cover.centres] + displacements[:, vertex]
    return residual.square().sum(dim=(1, 2)) + scale_weight * local[..., 0].square().sum(dim=1)


def reduced_quadratic(
    points: Float[Tensor, "m 3"], cover: Cover, *, scale_weight: float
) -> Float[Tensor, "n n"]:
    """The dense matrix L^φ = L ⊗ I₃ − B H⁻¹ Bᵀ of Appendix A, n = 3m; for small m and checks.

    The appendix prints B H B⁻¹, η once a neighbour, and an indefinite L; see docs/paper.md.
    """
    node, vertex = cover.pairs.unbind(dim=1)
    centre, matrices = cover.centres, pair_matrices(points, cover)
    m, count = len(points), len(cover.nodes)
    incidence = points.new_zeros(len(node), m)
    rows = torch.arange(len(node), device=points.device)
    incidence[rows, centre], incidence[rows, vertex] = 1.0, -1.0
    # Pair by pair, L = Σ (e_i − e_j)(e_i − e_j)ᵀ counts mutual neighbours twice, as it must.
    laplacian = torch.kron(incidence.T @ incidence, torch.eye(3).to(points))
    coupling = points.new_zeros(m, count, 3, 4)
    coupling = coupling.index_put((centre, node), matrices, accumulate=True)
    coupling = coupling.index_put((vertex, node), -matrices, accumulate=True)
    hessian = _node_hessians(matrices, node, count, scale_weight)
    solved = torch.linalg.solve(hessian, coupling.permute(1, 3, 0, 2).reshape(count, 4, 3 * m))
    return laplacian - coupling.permute(0, 2, 1, 3).reshape(3 * m, 4 * count) @ solved.reshape(
        4 * count, 3 * m
    )


def _node_hessians(
    matrices: Float[Tensor, "e 3 4"], node: Int[Tensor, " e"], count: int, scale_weight: float
) -> Float[Tensor, "l 4 4"]:
    """The diagonal blocks of H (Appendix A): Σ_j QᵀQ, with η once on the scaling."""
    blocks = matrices.new_zeros(count, 4, 4)
    blocks = blocks.index_add(0, node, matrices.transpose(1, 2) @ matrices)
    return blocks + scale_weight * torch.diag(matrices.new_tensor([1.0, 0.0, 0.0, 0.0]))
