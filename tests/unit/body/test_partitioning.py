"""How evenly the work of a large body is dealt out, by a model of what its parts cost."""

from itertools import product

import numpy as np

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.body.partitioning import partition
from pdfem_mpi.kernels.hex8 import gauss_positions
from support.bodies import make_scene

#: Seconds, as they were measured when the weights were chosen: of the sweep for a bond, of the cycle of conjugate
#: gradients for any cell, and of an element.
OF_BOND, OF_CELL, OF_ELEMENT = 1.6e-9, 0.28e-6, 0.06e-6
EDGE, RANKS, UNEVEN = 48, 64, 1.15


def bonds_between(cells, cutoff):
    """Bonds of each cell of a lattice of unit cubes with other cells and within, half of what two cells share.

    Parameters
    ----------
    cells : bool, shape (n, n, n)
        Those with points.
    """
    corners = np.array([(i, j, k) for k, (i, j) in product((0, 1), ((0, 0), (1, 0), (1, 1), (0, 1)))], float)
    points = gauss_positions(corners[None])[0]
    reach = int(cutoff) + 1
    found = np.zeros(cells.shape)
    padded = np.pad(cells, reach)
    for offset in product(range(-reach, reach + 1), repeat=3):
        apart = ((points[:, None] + np.array(offset) - points[None]) ** 2).sum(axis=2)
        pairs = np.count_nonzero((apart <= cutoff**2) & (apart > 0.0))
        if pairs:
            there = padded[tuple(slice(reach + d, reach + d + n) for d, n in zip(offset, cells.shape, strict=True))]
            found += 0.5 * pairs * there
    return np.where(cells, found, 0.0)


def test_a_cube_of_elements_and_bonds_costs_all_ranks_about_the_same():
    """Counted with all bonds of the points; the weights count neighbours of cells."""
    body = discretize(make_scene((EDGE, EDGE, EDGE), EDGE // 2, correction="none", solver="cg"))
    owner = partition(body, RANKS)
    place = np.floor(body.mesh.centroids).astype(int)
    cells = np.zeros((EDGE,) * 3, bool)
    cells[tuple(place[body.has_points].T)] = True
    bonds = bonds_between(cells, body.cutoff)[tuple(place.T)]
    cost = OF_BOND * bonds + OF_CELL + OF_ELEMENT * body.has_stiffness
    of_rank = np.bincount(owner, cost, RANKS)
    assert of_rank.max() <= UNEVEN * of_rank.mean(), of_rank.max() / of_rank.mean()
