"""Mirror images of cells: copies with reflected components, and the way back of what was added to them.

Image cells stand behind all other cells of a rank. A table is seen as cells of two clusters, ``a[cell][2][rows][4]``.
"""

import numpy as np
from numba import njit, types

from pdfem_mpi.kernels.simd import W

_options = {"cache": True, "nogil": True, "boundscheck": False, "error_model": "numpy"}


@njit(**_options)
def copy_images(a, source, factor):
    """Overwrite the rows of image cells by those of their cells, times a factor for each row.

    Parameters
    ----------
    a : float64, shape (n_cells, 2, n_rows, 4)
        The last ``len(source)`` cells are images.
    source : int64, shape (n_images,)
        Cell that each is an image of; not itself an image.
    factor : int64, shape (n_images, n_rows)
        1 or -1.
    """
    first = a.shape[0] - source.size
    for m in range(source.size):
        for b in range(2):
            for r in range(a.shape[2]):
                for k in range(W):
                    a[first + m, b, r, k] = factor[m, r] * a[source[m], b, r, k]


@njit(**_options)
def return_images(a, source, factor):
    """Add the rows of image cells, times the factors, to those of their cells: the transpose of `copy_images`.

    Parameters
    ----------
    a : int64, shape (n_cells, 2, n_rows, 4)
    source, factor
        As in `copy_images`.
    """
    first = a.shape[0] - source.size
    for m in range(source.size):
        for b in range(2):
            for r in range(a.shape[2]):
                for k in range(W):
                    a[source[m], b, r, k] += factor[m, r] * a[first + m, b, r, k]


@njit(**_options)
def share_own_images(row_start, row_offset, row_data, cell_number, material, finite, counts):
    """Leave of the bonds between a cell and its own images each once, and half of those between a point and its image.

    A bond from point p of a cell to the image of its point q is the mirror image of one from q to an image of p. That
    with ``p < q`` is kept. A bond from p to its own image is its own mirror image, or stands in two rows: one half of
    it belongs to the body that is modelled, and p receives the forces on both of its ends.

    Parameters
    ----------
    row_start, row_offset : int64 (n_points + 1,), uint32 (n_rows + 1,)
        Rows against ghosts and images.
    row_data : float32, shape ((n_rows + 1) * (8 if finite else 4),)
        Stored numbers of `families.fill_rows`; changed.
    cell_number : int64, shape (n_cells,)
        Number of each local cell; an image has that of its cell.
    material : int16, shape (n_cells,)
        Material of each local cell.
    finite : bool
        Layout of ``row_data``.
    counts : int64, shape (n_materials, n_materials)
        Bonds by materials; those taken out are subtracted.
    """
    stride = 2 * W if finite else W
    for i in range(row_start.size - 1):
        p = i % (2 * W)
        for row in range(row_start[i], row_start[i + 1]):
            c = np.int64(row_offset[row]) // (9 * W)
            if cell_number[c // 2] != cell_number[i // (2 * W)]:
                continue
            for k in range(W):
                q = W * (c % 2) + k
                if q == p:
                    row_data[row * stride + k] *= np.float32(0.5)
                elif q < p and row_data[row * stride + k] != 0.0:
                    for s in range(0, stride, W):
                        row_data[row * stride + s + k] = 0.0
                    own = material[i // (2 * W)]
                    counts[own, own] -= 1


_i8 = types.int64[::1]
_factor = types.int64[:, ::1]
SIGNATURES = {
    copy_images: types.void(types.Array(types.float64, 4, "A"), _i8, _factor),
    return_images: types.void(types.Array(types.int64, 4, "A"), _i8, _factor),
    share_own_images: types.void(
        _i8, types.uint32[::1], types.float32[::1], _i8, types.int16[::1], types.boolean, types.int64[:, ::1]
    ),
}
