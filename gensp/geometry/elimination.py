"""Exact elimination of the constrained reduced model to 6l unknowns (torch; Eq. 7, Appendix A).

With d_j = (forced part)_j + T_j y_j, the residual of pair (i, j) is

    r_ij = U_ij u_i + T_j y_j + c_ij,    U = (Q_ij, −T_i),  u_i = (x_i, y_i),

and c_ij the difference of the forced parts. Pairs join nodes to vertices only, so the tangential
unknowns of all vertices that are not nodes have diagonal blocks (deg_j + ε) I₂ and go in closed
form. What is left is one dense positive definite system in the u_i, equal to the saddle system of
the paper.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from gensp.geometry.reduced import Cover, pair_matrices

# Blocks (row, column, 6×6) of the matrix and blocks (row, 6×k) of the right-hand side.
_Terms = tuple[tuple[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]


def least_deforming(
    points: Float[Tensor, "m 3"],
    cover: Cover,
    bases: Float[Tensor, "m 3 2"],
    forced: Float[Tensor, "m 3 k"],
    *,
    scale_weight: float,
    ridge: float,
) -> tuple[Float[Tensor, "k l 4"], Float[Tensor, "k m 3"]]:
    """Node deformations x and displacements d = forced + T y of least energy (Eq. 7).

    Minimises the objective of Eq. 6 plus ε‖d‖² over x and y, for k forced parts at once.
    """
    return _Elimination(points, cover, bases, forced, ridge).solve(scale_weight)


class _Elimination:
    """The pairs of a cover with their matrices U, constants c and free vertices."""

    def __init__(
        self,
        points: Float[Tensor, "m 3"],
        cover: Cover,
        bases: Float[Tensor, "m 3 2"],
        forced: Float[Tensor, "m 3 k"],
        ridge: float,
    ) -> None:
        self.cover, self.bases, self.forced, self.ridge = cover, bases, forced, ridge
        node, vertex = cover.pairs.unbind(dim=1)
        slot = torch.full((len(points),), -1, device=points.device)
        slot[cover.nodes] = torch.arange(len(cover.nodes), device=points.device)
        self.node, self.vertex, self.other = node, vertex, slot[vertex]
        self.matrix = torch.cat([pair_matrices(points, cover), -bases[cover.centres]], dim=2)
        self.constant = forced[vertex] - forced[cover.centres]
        self.free = self.other < 0
        degree = torch.bincount(vertex[self.free], minlength=len(points))
        self.pivot = (degree.to(points) + ridge)[:, None, None]

    def solve(self, scale_weight: float) -> tuple[Float[Tensor, "k l 4"], Float[Tensor, "k m 3"]]:
        """Node deformations x and displacements d of every direction."""
        kept = self._kept_unknowns(scale_weight)
        pull = (self.matrix @ kept[self.node] + self.constant)[self.free]
        vertex = self.vertex[self.free]
        gathered = torch.zeros_like(self.forced).index_add(0, vertex, pull)
        tangential = -(self.bases.mT @ gathered) / self.pivot
        tangential = tangential.index_copy(0, self.cover.nodes, kept[:, 4:])
        displacements = self.forced + self.bases @ tangential
        return kept[:, :4].permute(2, 0, 1), displacements.permute(2, 0, 1)

    def _kept_unknowns(self, scale_weight: float) -> Float[Tensor, "l 6 k"]:
        count = len(self.cover.nodes)
        parts = [self._pairs(), self._node_pairs(), self._schur_complement()]
        rows, columns, blocks = (torch.cat([part[0][i] for part in parts]) for i in range(3))
        places, moments = (torch.cat([part[1][i] for part in parts]) for i in range(2))
        system = blocks.new_zeros(count * count, 6, 6)
        system = system.index_add(0, rows * count + columns, blocks)
        system = system.reshape(count, count, 6, 6).transpose(1, 2).reshape(6 * count, -1)
        weights = system.new_tensor([scale_weight, 0, 0, 0, self.ridge, self.ridge])
        rhs = moments.new_zeros(count, 6, moments.shape[2]).index_add(0, places, moments)
        solution = _solve(system + torch.diag(weights.repeat(count)), rhs.flatten(0, 1))
        return solution.reshape(rhs.shape)

    def _pairs(self) -> _Terms:
        """‖U u_i + c‖² of every pair."""
        transposed = self.matrix.mT
        return (
            (self.node, self.node, transposed @ self.matrix),
            (self.node, -transposed @ self.constant),
        )

    def _node_pairs(self) -> _Terms:
        """What T_j y_j adds where vertex j is itself a node and its y_j is kept."""
        tied = ~self.free
        node, other = self.node[tied], self.other[tied]
        basis = self.bases[self.vertex[tied]]
        extra = torch.cat([basis.new_zeros(len(basis), 3, 4), basis], dim=2)
        mixed = self.matrix[tied].mT @ extra
        return (
            (
                torch.cat([other, node, other]),
                torch.cat([other, other, node]),
                torch.cat([extra.mT @ extra, mixed, mixed.mT]),
            ),
            (other, -extra.mT @ self.constant[tied]),
        )

    def _schur_complement(self) -> _Terms:
        """What eliminating y_j = −T_jᵀ Σ (U u_i + c) / (deg_j + ε) takes away."""
        node, vertex = self.node[self.free], self.vertex[self.free]
        tangent = self.bases[vertex].mT @ self.matrix[self.free]
        constant = torch.zeros_like(self.forced).index_add(0, vertex, self.constant[self.free])
        reduced = (self.bases.mT @ constant / self.pivot)[vertex]
        left, right = _sharing(vertex, len(self.bases))
        scaled = (tangent / self.pivot[vertex])[right]
        return (
            (node[left], node[right], -tangent[left].mT @ scaled),
            (node, tangent.mT @ reduced),
        )


def _sharing(vertex: Int[Tensor, " e"], count: int) -> tuple[Int[Tensor, " s"], Int[Tensor, " s"]]:
    """All ordered couples of pairs that have their vertex in common."""
    order = torch.argsort(vertex, stable=True)
    sizes = torch.bincount(vertex, minlength=count)
    start = torch.cumsum(sizes, dim=0) - sizes
    repeats = sizes[vertex[order]]
    left = torch.repeat_interleave(order, repeats)
    first = torch.repeat_interleave(torch.cumsum(repeats, dim=0) - repeats, repeats)
    within = torch.arange(len(left), device=vertex.device) - first
    return left, order[start[vertex[left]] + within]


def _solve(matrix: Float[Tensor, "n n"], rhs: Float[Tensor, "n k"]) -> Float[Tensor, "n k"]:
    """Solution of a positive definite system, with its exact first derivative.

    One step of iterative refinement against a factor held fixed: d(A⁻¹b) = A⁻¹(db − dA A⁻¹b)
    needs no derivative of the factorisation.
    """
    factor = torch.linalg.cholesky(matrix.detach())
    guess = torch.cholesky_solve(rhs.detach(), factor)
    return guess + torch.cholesky_solve(rhs - matrix @ guess, factor)
