"""Assembly of per-triangle 6×6 blocks into one sparse matrix, with the pattern computed once."""

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int


class HessianPattern:
    """Sparsity of the 2n×2n tangent Hessian of a mesh, computed once.

    Attributes
    ----------
    diagonal
        Where the 2n diagonal entries lie among the stored ones.
    """

    def __init__(self, faces: Int[np.ndarray, "m 3"], count: int) -> None:
        rows = np.repeat(faces, 3, axis=1).T.reshape(-1)  # corner u of every pair (u, v)
        columns = np.tile(faces, (1, 3)).T.reshape(-1)  # corner v
        keys, block = np.unique(columns * count + rows, return_inverse=True)
        block_rows, block_columns = keys % count, keys // count
        starts = np.searchsorted(block_columns, np.arange(count + 1))
        height = np.diff(starts)[block_columns]
        rank = np.arange(len(keys)) - starts[block_columns]
        # Entry (2i + r, 2j + s) of a block follows those of the blocks above it in its column.
        top = 4 * starts[block_columns] + 2 * rank
        place = np.stack([[top + r + 2 * s * height for s in (0, 1)] for r in (0, 1)])
        indices = np.empty(4 * len(keys), dtype=np.int32)
        for r in (0, 1):
            for s in (0, 1):
                indices[place[r, s]] = 2 * block_rows + r
        pointers = np.stack([4 * starts[:-1], 4 * starts[:-1] + 2 * np.diff(starts)], axis=1)
        self._indptr = np.append(pointers.reshape(-1), 4 * len(keys)).astype(np.int32)
        self._indices = indices
        self._size = 2 * count
        local = place[:, :, block].reshape(2, 2, 3, 3, len(faces))
        self._scatter = local.transpose(2, 0, 3, 1, 4).reshape(-1)
        on_diagonal = np.flatnonzero(block_rows == block_columns)
        self.diagonal = place[[0, 1], [0, 1]][:, on_diagonal].T.reshape(-1)

    def assemble(
        self, blocks: Float[np.ndarray, "6 6 m"], diagonal: Float[np.ndarray, " k"]
    ) -> scipy.sparse.csc_matrix:
        """Sum the triangles' blocks and add `diagonal` (2n,)."""
        data = np.bincount(self._scatter, blocks.reshape(-1), len(self._indices))
        data[self.diagonal] += diagonal
        entries = (data, self._indices, self._indptr)
        return scipy.sparse.csc_matrix(entries, shape=(self._size, self._size))
