"""Sums of the dense blocks of a multifrontal factorisation."""

import numpy as np
from numba import njit


@njit(cache=True)
def extend_add(
    update: np.ndarray,
    place: np.ndarray,
    diagonal: np.ndarray,
    coupling: np.ndarray,
    rest: np.ndarray,
) -> None:
    """Add the lower triangle of a child's update to the blocks of its parent's front.

    `place` is the row and column of the front, ascending, that each row and column of the update
    belongs to; `diagonal`, `coupling` and `rest` are the front's lower triangle in blocks.
    """
    own = len(diagonal)
    for j in range(len(place)):
        column = place[j]
        for i in range(j, len(place)):
            row = place[i]
            if row < own:
                diagonal[row, column] += update[i, j]
            elif column < own:
                coupling[row - own, column] += update[i, j]
            else:
                rest[row - own, column - own] += update[i, j]
