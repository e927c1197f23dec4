"""Closed surfaces with vertices of many neighbours, as CAD programs write them: fans."""

import numpy as np

from gensp.geometry.mesh import Mesh


def cylinder(valence: int, rings: int) -> Mesh:
    """A cylinder of radius 1 and height 2; the last two vertices have `valence` neighbours."""
    angles = 2 * np.pi * np.arange(valence) / valence
    rim = np.column_stack([np.cos(angles), np.sin(angles)])
    heights = np.repeat(np.linspace(-1, 1, rings), valence)
    vertices = np.column_stack([np.tile(rim, (rings, 1)), heights])
    below = np.arange(valence * (rings - 1))
    onward = below + np.where(below % valence == valence - 1, 1 - valence, 1)
    quads = [[below, onward, onward + valence], [below, onward + valence, below + valence]]
    low, beside, up = below[:valence], onward[:valence], valence * (rings - 1)
    foot = np.full(valence, len(vertices))
    fans = [[foot, beside, low], [foot + 1, low + up, beside + up]]
    faces = np.concatenate([np.column_stack(part) for part in quads + fans])
    return Mesh(np.concatenate([vertices, [[0, 0, -1.0], [0, 0, 1.0]]]), faces, "cylinder")


def bipyramid(valence: int) -> Mesh:
    """Two cones of height 1 on a circle of radius 1; the last two vertices are their tips."""
    angles = 2 * np.pi * np.arange(valence) / valence
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(valence)])
    here, tip = np.arange(valence), np.full(valence, valence)
    onward = (here + 1) % valence
    faces = [np.column_stack([here, onward, tip]), np.column_stack([onward, here, tip + 1])]
    vertices = np.concatenate([rim, [[0, 0, 1.0], [0, 0, -1.0]]])
    return Mesh(vertices, np.concatenate(faces), "bipyramid")
