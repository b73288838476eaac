"""Dense algebra with a written order of operations: products, eigenvalues, equations, orthonormal rows.

LAPACK and BLAS choose their loops by the processor, and with them the last digits. These loops are the same everywhere,
so that ranks on different processors agree bit by bit. Matrices are small, or have one small side; the large ones have
kernels of their own (`banded`, `fronts`).

Eigenvalues are found by Jacobi's rotations (Golub & Van Loan, Matrix Computations, section 8.5), equations by Gauss's
elimination with pivots from the column.
"""

import math

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.simd import W, fma, hsum, load, splat, store

#: Sweeps of rotations after which a matrix is let be; eight are many.
MOST_SWEEPS = 60
#: An entry beside the diagonal smaller than this fraction of the root of its two diagonal entries' product is none.
NOTHING = 2.0**-60
#: Rows of the second factor that are passed over together.
TOGETHER = 64

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def add_product(a, b, result):
    """Add ``a b``; an entry's terms are added in the order of the columns of ``a``.

    Parameters
    ----------
    a, b, result : float64, shapes (n, k), (k, m), (n, m)
    """
    for first in range(0, a.shape[1], TOGETHER):
        last = min(first + TOGETHER, a.shape[1])
        for i in range(a.shape[0]):
            for c in range(first, last):
                x = a[i, c]
                for j in range(b.shape[1]):
                    result[i, j] += x * b[c, j]


@njit(**_options)
def decompose(matrices, values, vectors):
    """Eigenvalues of symmetric matrices in rising order, and their vectors in columns.

    Parameters
    ----------
    matrices : float64, shape (n, m, m)
        Destroyed.
    values, vectors : float64, shapes (n, m) and (n, m, m)
        Overwritten.
    """
    m = matrices.shape[1]
    for t in range(matrices.shape[0]):
        a, v = matrices[t], vectors[t]
        for i in range(m):
            for j in range(m):
                v[i, j] = 1.0 if i == j else 0.0
        for _ in range(MOST_SWEEPS):
            rotated = False
            for p in range(m - 1):
                for q in range(p + 1, m):
                    beside = a[p, q]
                    if not abs(beside) > NOTHING * math.sqrt(abs(a[p, p])) * math.sqrt(abs(a[q, q])):
                        continue
                    rotated = True
                    theta = (a[q, q] - a[p, p]) / (2.0 * beside)
                    tangent = (1.0 if theta >= 0.0 else -1.0) / (abs(theta) + math.sqrt(theta * theta + 1.0))
                    cosine = 1.0 / math.sqrt(tangent * tangent + 1.0)
                    sine = tangent * cosine
                    a[p, p] -= tangent * beside
                    a[q, q] += tangent * beside
                    a[p, q] = 0.0
                    a[q, p] = 0.0
                    for k in range(m):
                        if k != p and k != q:
                            x, y = a[k, p], a[k, q]
                            a[k, p] = a[p, k] = cosine * x - sine * y
                            a[k, q] = a[q, k] = sine * x + cosine * y
                        x, y = v[k, p], v[k, q]
                        v[k, p] = cosine * x - sine * y
                        v[k, q] = sine * x + cosine * y
            if not rotated:
                break
        for i in range(m):
            values[t, i] = a[i, i]
        for i in range(1, m):  # a place is found from the right, so that equal ones keep their order
            j = i
            while j > 0 and values[t, j] < values[t, j - 1]:
                values[t, j], values[t, j - 1] = values[t, j - 1], values[t, j]
                for k in range(m):
                    v[k, j], v[k, j - 1] = v[k, j - 1], v[k, j]
                j -= 1


@njit(**_options)
def eliminate(matrices, right):
    """Solve ``A x = b`` for each matrix; a singular one gives numbers that are not finite.

    Parameters
    ----------
    matrices : float64, shape (n, m, m)
        Destroyed.
    right : float64, shape (n, m, k)
        Overwritten by the solutions.
    """
    m, n_right = right.shape[1], right.shape[2]
    for t in range(matrices.shape[0]):
        a, b = matrices[t], right[t]
        for p in range(m):
            best = p
            for i in range(p + 1, m):
                if abs(a[i, p]) > abs(a[best, p]):
                    best = i
            if best != p:
                for j in range(m):
                    a[p, j], a[best, j] = a[best, j], a[p, j]
                for j in range(n_right):
                    b[p, j], b[best, j] = b[best, j], b[p, j]
            for i in range(p + 1, m):
                factor = a[i, p] / a[p, p]
                for j in range(p + 1, m):
                    a[i, j] -= factor * a[p, j]
                for j in range(n_right):
                    b[i, j] -= factor * b[p, j]
        for p in range(m - 1, -1, -1):
            for j in range(n_right):
                x = b[p, j]
                for i in range(p + 1, m):
                    x -= a[p, i] * b[i, j]
                b[p, j] = x / a[p, p]


@njit(inline="always")
def dot_rows(a, i, b, j, n):
    """Product of row ``i`` of a flat table and row ``j`` of another, of length ``n``, summed in four lanes at first."""
    whole = n // W * W
    total = splat(0.0)
    for k in range(0, whole, W):
        total = fma(load(a, i * n + k), load(b, j * n + k), total)
    result = hsum(total)
    for k in range(whole, n):
        result += a[i * n + k] * b[j * n + k]
    return result


@njit(inline="always")
def take_row(amount, a, i, b, j, n):
    """Take ``amount`` times row ``i`` of a flat table from row ``j`` of another."""
    whole = n // W * W
    factor = splat(-amount)
    for k in range(0, whole, W):
        store(b, j * n + k, fma(factor, load(a, i * n + k), load(b, j * n + k)))
    for k in range(whole, n):
        b[j * n + k] -= amount * a[i * n + k]


@njit(**_options)
def make_orthonormal(rows, count, n, least):
    """Gram and Schmidt's method: the longest row that is left comes next, and each is made orthogonal twice.

    Parameters
    ----------
    rows : float64, shape (count * n,)
        Overwritten; the first that the result counts are orthonormal.
    count, n : int
    least : float
        A row shorter than this fraction of the longest one is none.

    Returns
    -------
    int
    """
    top = 0.0
    for j in range(count):
        best, longest = j, -1.0
        for i in range(j, count):
            square = dot_rows(rows, i, rows, i, n)
            if square > longest:
                best, longest = i, square
        if best != j:
            for k in range(n):
                rows[j * n + k], rows[best * n + k] = rows[best * n + k], rows[j * n + k]
        for i in range(j):
            take_row(dot_rows(rows, i, rows, j, n), rows, i, rows, j, n)
        length = math.sqrt(dot_rows(rows, j, rows, j, n))
        top = max(top, length)
        if not length > least * top:
            return j
        for k in range(n):
            rows[j * n + k] /= length
        for i in range(j + 1, count):
            take_row(dot_rows(rows, j, rows, i, n), rows, j, rows, i, n)
    return count


@njit(**_options)
def remove_rows(rows, count, x):
    """Take its parts along orthonormal rows out of a vector.

    Parameters
    ----------
    rows : float64, shape (count * n,)
    count : int
    x : float64, shape (n,)
        Overwritten.
    """
    amounts = np.empty(count)
    for i in range(count):
        amounts[i] = dot_rows(rows, i, x, 0, x.size)
    for i in range(count):
        take_row(amounts[i], rows, i, x, 0, x.size)


_f8, _table, _tables = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
_int, _real = types.int64, types.float64
SIGNATURES = {
    add_product: types.void(_table, _table, _table),
    decompose: types.void(_tables, _table, _tables),
    eliminate: types.void(_tables, _tables),
    make_orthonormal: _int(_f8, _int, _int, _real),
    remove_rows: types.void(_f8, _int, _f8),
}


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Lengths of vectors along the last axis."""
    return np.sqrt((vectors * vectors).sum(axis=-1))


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Sum over the last axis of ``a`` and the first of ``b``, in their order; other axes stay."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    rows = np.ascontiguousarray(a.reshape(math.prod(a.shape[:-1]), a.shape[-1]))
    columns = np.ascontiguousarray(b.reshape(b.shape[0], math.prod(b.shape[1:])))
    result = np.zeros((len(rows), columns.shape[1]))
    add_product(rows, columns, result)
    return result.reshape(a.shape[:-1] + b.shape[1:])


def eigen(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues of symmetric matrices (..., m, m) in rising order, (..., m), and their vectors in columns."""
    matrices = np.asarray(matrices, float)
    m = matrices.shape[-1]
    work = matrices.reshape(math.prod(matrices.shape[:-2]), m, m).copy()
    values, vectors = np.empty((len(work), m)), np.empty(work.shape)
    decompose(work, values, vectors)
    return values.reshape(matrices.shape[:-1]), vectors.reshape(matrices.shape)


def solve(matrices: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solutions of ``A x = b``, for matrices (..., m, m) and right sides (..., m, k) or, of one matrix, (m,)."""
    matrices, right = np.asarray(matrices, float), np.asarray(right, float)
    m = matrices.shape[-1]
    work = matrices.reshape(math.prod(matrices.shape[:-2]), m, m).copy()
    solutions = right.reshape(len(work), m, right.shape[-1] if right.ndim == matrices.ndim else 1).copy()
    eliminate(work, solutions)
    return solutions.reshape(right.shape)


def orthonormal_rows(rows: np.ndarray, least: float = 0.0) -> np.ndarray:
    """An orthonormal basis of what rows (count, n) span, but for directions below ``least`` of the longest row."""
    count, n = rows.shape
    work = np.array(rows, float).reshape(-1)
    return work.reshape(count, n)[: make_orthonormal(work, count, n, least)]


def without_components(rows: np.ndarray, x: np.ndarray) -> np.ndarray:
    """A vector (n,) without its parts along orthonormal rows (count, n)."""
    if not len(rows):
        return x
    result = np.array(x, float)
    remove_rows(rows.reshape(-1), len(rows), result)
    return result
