"""Faces without area, mended with the triangles around them."""

from dataclasses import replace

import numpy as np
from jaxtyping import Int

from gensp.geometry.diagnosis import degenerate_faces
from gensp.geometry.mesh import Mesh
from gensp.geometry.submesh import kept, tidy
from gensp.geometry.topology import half_edges

_ROUNDS = 20
_FLAT = 1e-14  # of the total area; the check refuses 1e-15
_NEEDLE = 1e-4  # shortest over longest side, below which a flat triangle loses that side


def without_flat(mesh: Mesh) -> tuple[Mesh, int]:
    """Collapse needles, flip caps, and drop what has a repeated corner."""
    count = 0
    for _ in range(_ROUNDS):
        flat = degenerate_faces(mesh, _FLAT)
        if not flat.any():
            break
        repeated = (np.diff(np.sort(mesh.faces, axis=1), axis=1) == 0).any(axis=1)
        if repeated.any():
            mesh, dropped = kept(mesh, ~repeated)
        else:
            mesh, dropped = _mended_flat(mesh, np.flatnonzero(flat))
        count += dropped
        if dropped == 0 or len(mesh.faces) == 0:
            break
    return mesh, count


def _mended_flat(mesh: Mesh, flat: Int[np.ndarray, " k"]) -> tuple[Mesh, int]:
    corners = mesh.vertices[mesh.faces[flat]]
    lengths = np.linalg.norm(corners[:, [1, 2, 0]] - corners, axis=2)
    needle = lengths.min(axis=1) <= _NEEDLE * lengths.max(axis=1)
    if needle.any():
        row = flat[needle]
        side = lengths[needle].argmin(axis=1)
        place = np.arange(len(mesh.vertices))
        place[mesh.faces[row, (side + 1) % 3]] = mesh.faces[row, side]
        # Chains of collapses end at a vertex that stays; a cycle is broken next round.
        collapsed = place[place[mesh.faces]]
        return tidy(replace(mesh, faces=collapsed)), int(needle.sum())
    return _flipped_caps(mesh, flat, lengths.argmax(axis=1))


def _flipped_caps(
    mesh: Mesh, flat: Int[np.ndarray, " k"], side: Int[np.ndarray, " k"]
) -> tuple[Mesh, int]:
    """Flip the longest side of caps, where it has one other face that no other cap takes."""
    n = len(mesh.vertices)
    sides = half_edges(mesh.faces)
    key = sides.min(axis=1) * n + sides.max(axis=1)
    order = np.argsort(key, kind="stable")
    own = 3 * flat + side
    low, high = (np.searchsorted(key[order], key[own], side=s) for s in ("left", "right"))
    pair = high - low == 2
    other = np.where(order[low] == own, order[np.minimum(low + 1, len(order) - 1)], order[low])
    face, beside = flat[pair], other[pair] // 3
    free = ~np.isin(beside, flat)
    _, first = np.unique(beside[free], return_index=True)
    chosen = np.flatnonzero(free)[first]
    if len(chosen) == 0:
        return mesh, 0
    cap, near = face[chosen], beside[chosen]
    at, across = side[pair][chosen], other[pair][chosen] % 3
    a, b, tip = (mesh.faces[cap, (at + k) % 3] for k in range(3))
    far = mesh.faces[near, (across + 2) % 3]
    faces = mesh.faces.copy()
    faces[cap], faces[near] = np.stack([a, far, tip], axis=1), np.stack([far, b, tip], axis=1)
    return replace(mesh, faces=faces), len(chosen)
