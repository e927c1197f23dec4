"""Nearest positive semidefinite matrices of many small symmetric blocks."""

import numpy as np
from numba import njit

_SWEEPS = 60  # rotations of one eigenvalue: some three are the rule
_TINY = 1e-100  # a square that is nothing beside the largest entry, which is one, and no underflow


@njit(cache=True)
def tridiagonalise(a: np.ndarray, q: np.ndarray, d: np.ndarray, e: np.ndarray) -> None:
    """QᵀAQ = tridiag(e, d, e) by Householder reflections (Golub & Van Loan, §8.3.1).

    A symmetric (n, n), largest entry one, is overwritten; e[k] stands beside d[k] and d[k + 1].
    """
    n = len(d)
    v, w = np.empty(n), np.empty(n)
    for i in range(n):
        for j in range(n):
            q[i, j] = 1.0 if i == j else 0.0
    for k in range(n - 2):
        v[k + 1], rest = a[k + 1, k], 0.0
        for i in range(k + 2, n):
            v[i] = a[i, k]
            rest += v[i] * v[i]
        square = rest + v[k + 1] * v[k + 1]
        if rest > _TINY:
            pivot = -np.copysign(np.sqrt(square), v[k + 1])
            v[k + 1] -= pivot
            beta = 2.0 / (rest + v[k + 1] * v[k + 1])
            _reflect(a, q, v, w, beta, k + 1)
            e[k] = pivot
        else:
            e[k] = v[k + 1]
    for k in range(n):
        d[k] = a[k, k]
    e[n - 2] = a[n - 1, n - 2]


@njit(cache=True)
def _reflect(
    a: np.ndarray, q: np.ndarray, v: np.ndarray, w: np.ndarray, beta: float, first: int
) -> None:
    """A ← HAH on the rows and columns from `first` on, and Q ← QH, of H = 1 − β v vᵀ."""
    n = len(v)
    along = 0.0
    for i in range(first, n):
        total = 0.0
        for j in range(first, n):
            total += a[i, j] * v[j]
        w[i] = beta * total
        along += w[i] * v[i]
    for i in range(first, n):
        w[i] -= 0.5 * beta * along * v[i]
    for i in range(first, n):
        for j in range(first, n):
            a[i, j] -= v[i] * w[j] + w[i] * v[j]
    for i in range(n):
        total = 0.0
        for j in range(first, n):
            total += q[i, j] * v[j]
        for j in range(first, n):
            q[i, j] -= beta * total * v[j]


@njit(cache=True)
def diagonalise(d: np.ndarray, e: np.ndarray, q: np.ndarray) -> bool:
    """Eigenvalues into d, eigenvectors into the columns of Q, by implicit QR with shifts (§8.3.3).

    Says whether it converged, which values that are no numbers prevent.
    """
    last = len(d) - 1
    for _ in range(_SWEEPS * len(d)):
        while last > 0 and _negligible(d, e, last - 1):
            e[last - 1] = 0.0
            last -= 1
        if last == 0:
            return True
        first = last - 1
        while first > 0 and not _negligible(d, e, first - 1):
            first -= 1
        _chase(d, e, q, first, last)
    return False


@njit(cache=True)
def _negligible(d: np.ndarray, e: np.ndarray, k: int) -> bool:
    return bool(abs(e[k]) <= 1e-16 * (abs(d[k]) + abs(d[k + 1])) or e[k] * e[k] <= _TINY)


@njit(cache=True)
def _chase(d: np.ndarray, e: np.ndarray, q: np.ndarray, first: int, last: int) -> None:
    """One QR step with Wilkinson's shift on the unreduced block from `first` to `last`."""
    half = 0.5 * (d[last - 1] - d[last])
    off = e[last - 1]
    shift = d[last] - off * off / (half + np.copysign(np.sqrt(half * half + off * off), half))
    x, z = d[first] - shift, e[first]
    for k in range(first, last):
        length = np.sqrt(x * x + z * z)
        c, s = (x / length, z / length) if length > 0.0 else (1.0, 0.0)
        if k > first:
            e[k - 1] = length
        a, b, g = d[k], e[k], d[k + 1]
        d[k] = c * c * a + 2.0 * c * s * b + s * s * g
        d[k + 1] = s * s * a - 2.0 * c * s * b + c * c * g
        e[k] = c * s * (g - a) + (c * c - s * s) * b
        if k + 1 < last:
            x, z = e[k], s * e[k + 1]
            e[k + 1] *= c
        for i in range(len(d)):
            left, right = q[i, k], q[i, k + 1]
            q[i, k] = c * left + s * right
            q[i, k + 1] = c * right - s * left


@njit(cache=True)
def raise_negative(blocks: np.ndarray) -> bool:
    """Take the negative part out of every symmetric block of (n, n, m), in place.

    Says whether all could be diagonalised.
    """
    n, _, m = blocks.shape
    a, q, d, e = np.empty((n, n)), np.empty((n, n)), np.empty(n), np.empty(n)
    for t in range(m):
        scale = 0.0  # squares of the entries must not overflow
        for i in range(n):
            for j in range(n):
                a[i, j] = blocks[i, j, t]
                if not np.isfinite(a[i, j]):
                    return False
                scale = max(scale, abs(a[i, j]))
        if scale == 0.0:
            continue
        a /= scale
        tridiagonalise(a, q, d, e)
        if not diagonalise(d, e, q):
            return False
        for k in range(n):
            if d[k] < 0.0:
                for i in range(n):
                    for j in range(n):
                        blocks[i, j, t] -= scale * d[k] * q[i, k] * q[j, k]
    return True
