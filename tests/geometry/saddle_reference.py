"""Eq. 6–7 and the corrected Appendix A written out literally, as the reference of the tests.

Dense, slow and plain: the matrices by their case tables, the saddle system and its
pseudo-inverse, and the null-space form with 2m tangential unknowns.
"""

import torch
from torch import Tensor

from gensp.geometry.reduced import Cover


def neighbourhoods(cover: Cover) -> list[list[int]]:
    """N_i of every node, as lists of vertices."""
    lists: list[list[int]] = [[] for _ in cover.nodes]
    for i, j in cover.pairs.tolist():
        lists[i].append(j)
    return lists


def cross(q: Tensor) -> Tensor:
    """[q]×, column by column."""
    return torch.stack([torch.linalg.cross(q, axis) for axis in torch.eye(3).to(q)], dim=1)


def appendix_matrices(points: Tensor, cover: Cover, eta: float) -> tuple[Tensor, Tensor, Tensor]:
    """L (m, m), B (3m, 4l) and H (4l, 4l) by the corrected case tables of Appendix A."""
    m, around, nodes = len(points), neighbourhoods(cover), cover.nodes.tolist()
    laplacian = points.new_zeros(m, m)
    coupling = points.new_zeros(3 * m, 4 * len(nodes))
    hessian = points.new_zeros(4 * len(nodes), 4 * len(nodes))
    for j in range(m):
        own = len(around[nodes.index(j)]) if j in nodes else 0
        laplacian[j, j] = own + sum(j in group for group in around)
    for i, (vertex, group) in enumerate(zip(nodes, around, strict=True)):
        columns = slice(4 * i, 4 * i + 4)
        for j in group:
            mutual = j in nodes and vertex in around[nodes.index(j)]
            laplacian[vertex, j] = laplacian[j, vertex] = -2.0 if mutual else -1.0
            q = points[vertex] - points[j]
            block = torch.cat([q[:, None], -cross(q)], dim=1)
            coupling[3 * vertex : 3 * vertex + 3, columns] += block
            coupling[3 * j : 3 * j + 3, columns] -= block
            hessian[4 * i, 4 * i] += q @ q
            hessian[4 * i + 1 : 4 * i + 4, 4 * i + 1 : 4 * i + 4] += (q @ q) * torch.eye(3).to(
                q
            ) - torch.outer(q, q)
        hessian[4 * i, 4 * i] += eta
    return laplacian, coupling, hessian


def appendix_quadratic(points: Tensor, cover: Cover, eta: float) -> Tensor:
    """L^φ = L ⊗ I₃ − B H⁻¹ Bᵀ, as a matrix (3m, 3m)."""
    laplacian, coupling, hessian = appendix_matrices(points, cover, eta)
    identity = torch.eye(3).to(points)
    return torch.kron(laplacian, identity) - coupling @ torch.linalg.solve(hessian, coupling.T)


def brute_force_energy(points: Tensor, cover: Cover, displacement: Tensor, eta: float) -> float:
    """Objective of Eq. 6 at displacement (m, 3), each node by its own least squares."""
    total = 0.0
    for vertex, group in zip(cover.nodes.tolist(), neighbourhoods(cover), strict=True):
        rows, right = [], []
        for j in group:
            q = points[vertex] - points[j]
            rows.append(torch.cat([q[:, None], -cross(q)], dim=1))
            right.append(displacement[vertex] - displacement[j])
        rows.append(points.new_tensor([[eta**0.5, 0, 0, 0]]))
        right.append(torch.zeros(1).to(points))
        matrix, target = torch.cat(rows), torch.cat(right)
        best = torch.linalg.lstsq(matrix, target[:, None]).solution[:, 0]
        total += float((matrix @ best - target).square().sum())
    return total


def saddle_velocity(
    quadratic: Tensor, grad_x: Tensor, forcing: Tensor, *, pseudo_inverse: bool = False
) -> Tensor:
    """Displacements (k, m, 3) from the saddle system of Eq. 7; forcing F v is (m, k)."""
    m, k = forcing.shape
    constraint = torch.zeros(m, 3 * m).to(grad_x)
    for axis in range(3):
        constraint[torch.arange(m), 3 * torch.arange(m) + axis] = grad_x[:, axis]
    zero = torch.zeros(m, m).to(grad_x)
    saddle = torch.cat([torch.cat([quadratic, constraint.T], 1), torch.cat([constraint, zero], 1)])
    right = torch.cat([torch.zeros(3 * m, k).to(grad_x), -forcing])
    if pseudo_inverse:
        solution = torch.linalg.pinv(saddle, hermitian=True, rtol=1e-10) @ right
    else:
        solution = torch.linalg.solve(saddle, right)
    return solution[: 3 * m].T.reshape(k, m, 3)


def null_space_velocity(quadratic: Tensor, grad_x: Tensor, forcing: Tensor) -> Tensor:
    """The same with d = (forced normal part) + N y, N a basis of the null space of C."""
    m, k = forcing.shape
    slope = grad_x.norm(dim=1, keepdim=True)
    forced = (-grad_x[:, :, None] * (forcing / slope**2)[:, None, :]).reshape(3 * m, k)
    _, _, right_vectors = torch.linalg.svd(grad_x[:, None, :])
    basis = torch.block_diag(*right_vectors[:, 1:].transpose(1, 2))
    free = torch.linalg.solve(basis.T @ quadratic @ basis, -basis.T @ quadratic @ forced)
    return (forced + basis @ free).T.reshape(k, m, 3)
