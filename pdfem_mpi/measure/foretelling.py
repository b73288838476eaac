"""Where the next bond can break: stretches of bonds that are not there, from displacements interpolated to points.

At every cell of the body there are eight points: those of bonds have displacements of their own, those of elements
follow the nodes. The strain of a cell alone would not do: its bonds reach into neighbours with twice of it.

Who asks says from which ratio on it matters. How far each cell is strained is told first, from its nodes or points
alone; only near to what is strained that far are bonds looked at, and what surrounds a cell is found once. What was
told of a state bounds what may be told of the next: only what cells were strained by since counts (`Ceilings`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pdfem_mpi.body.lattice_planes import bond_sizes
from pdfem_mpi.body.share import Share
from pdfem_mpi.body.softening import first_stretches
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.finite_elements.nodes import local_nodes
from pdfem_mpi.kernels.cell_strains import ROWS, strains_by_nodes, strains_by_points
from pdfem_mpi.kernels.foretold import follow_nodes, raise_ratios
from pdfem_mpi.kernels.hex8 import REFERENCE_NODES
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.measure.ceilings import Ceilings
from pdfem_mpi.measure.seams import Seams
from pdfem_mpi.measure.surroundings import Surroundings
from pdfem_mpi.model.model import Model
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.peridynamics.clusters import by_component
from pdfem_mpi.peridynamics.gaps import with_gaps
from pdfem_mpi.peridynamics.points import Points, make_points

#: Ratios are rounded to multiples of this: twins in a mirror that differ in their last digits are equal.
ROUNDED = 2.0**-20
#: A bond's stretch is a mean of the strain along it, and of what opens between cells with points of their own. What is
#: known of the strain is so much below what it may be, inside of cells that are no parallelepipeds.
NEARLY = 1.1
#: Cells whose corners are so much nearer to those of a parallelepiped, relative to the edges, are one.
STRAIGHT = 1e-6
#: Bonds that are looked at are told from this part of what matters on, so that a cell need not be looked at again soon.
TOLD_FROM = 0.5
#: Strains are bounded roughly below this part of what matters.
ROUGHLY = 0.25


class Foretelling:
    """Stretches of all bonds that a body could have, at given displacements.

    Parameters
    ----------
    scene : Scene
    share : Share
        Of a region that is found.
    model : Model

    Attributes
    ----------
    cells : int64, shape (n_owned,)
        The rank's cells, by their places in the share, in the order of rows.
    """

    def __init__(self, scene: Scene, share: Share, model: Model):
        around = share.found.around
        points = with_gaps(share, make_points(replace(share, subdomain=around), share.comm, weighted=False))
        self.share, self.model = share, model
        self.cells = np.concatenate([around.free, around.overlap])
        self._real = np.concatenate([self.cells, around.ghosts])
        self._n_free, self._halo, self._images = points.n_free, points.halo, points.images
        gaps = points.gaps
        self._surface = (gaps.cutoff, gaps.corners, gaps.planes, *gaps.near) if gaps else NO_SURFACE
        self._S = _table(points)
        self._connectivity = local_nodes(share)[share.mesh.cells[around.overlap]]
        corners = share.nodes[share.mesh.cells[self.cells]]
        self._inverse, self._tapered = _inverse_in_the_middle(corners), _tapered(corners)
        self._steep = 0.5 * np.sqrt((self._inverse**2).sum(axis=2)).sum(axis=1)
        self._seams = Seams.of(share, self._real, len(self.cells))
        self._limits, self._class_of = _limits(scene, share, around.point_cells)
        self._asked = ~share.found.is_turned[self.cells]
        self._steepest = np.where(self._asked, self._limits.max(axis=1)[self._class_of[: len(self.cells)]], 0.0)
        self._ceilings = Ceilings(len(self.cells))
        self._lent, self._source = _lent(points), np.arange(len(points.cell_number))
        if points.images:
            self._source[len(self._source) - len(points.images.source) :] = points.images.source
        self._surroundings = Surroundings(share, points)

    @property
    def _by_cell(self) -> np.ndarray:
        """The table as [cell][cluster][row][lane]."""
        return self._S.reshape(-1, 2, ROWS, W)

    def place(self, u: np.ndarray) -> np.ndarray:
        """Displacements of the eight points of each of the rank's cells, shape (n_owned, 8, 3). Collective.

        Parameters
        ----------
        u : float64, shape (n_unknowns,), dimension length
        """
        self._displace(np.arange(self._n_free, len(self.cells)), self._move(u))
        return self._by_cell[: len(self.cells), :, 0:3].swapaxes(2, 3).reshape(-1, 8, 3)

    def ratios(self, u: np.ndarray, least: np.ndarray | float, damaged: np.ndarray | None = None) -> np.ndarray:
        """Largest foretold stretch over the critical one, of the rank's cells that are not turned. Collective.

        Parameters
        ----------
        u : float64, shape (n_unknowns,), dimension length
        least : float64, shape (n_owned,), or float
            What is not above this does not matter.
        damaged : bool, shape (n_cells of the share,), optional
            Cells at the ends of broken bonds, as far as this rank knows: they tell nothing of what is beyond these.

        Returns
        -------
        float64, shape (n_owned,)
            0 where it does not matter, and for other cells.
        """
        own, comm, ceilings = len(self.cells), self.share.comm, self._ceilings
        least = np.maximum(least - ROUNDED, 0.0) + np.zeros(own)
        moved = self._move(ceilings.change(u))
        steepest, enough = self._steepest, ROUGHLY * float(least.min(initial=np.inf) / max(self._limits.max(), 1e-300))
        strain, opening = self._strains(moved, enough, damaged)
        chosen = self._surroundings.near_larger(strain, opening, ceilings.room(least, steepest))
        if not (searched := int(sum_integers(comm, np.array([len(chosen)]))[0])):
            return np.zeros(own)
        moved, needed, ratio = self._move(u), self._lent.copy(), np.zeros(len(self._class_of))
        needed[self._source[self._surroundings.marked(chosen)]] = True
        self._displace(self._n_free + np.flatnonzero(needed[self._n_free : own]), moved)
        rest = self._S, self._class_of, self._limits, self.share.cutoff**2
        ratio[:own] = TOLD_FROM * least
        raise_ratios(*self._surroundings.rows, chosen, *rest, *self._surface, ratio)
        if ceilings.are_due(searched, self.share.counts.cells):
            rise = self._surroundings.largest_rise(strain, opening, steepest)
            ceilings.renew(u, rise, chosen, ratio)
        found = np.rint(ratio[:own] / ROUNDED) * ROUNDED
        return np.where(ratio[:own] > least, found, 0.0)

    def most_strained(self, u: np.ndarray, cells: np.ndarray) -> float:
        """The ratio of a cell that is strained most, of chosen ones on all ranks: the largest is not below. Collective.

        Parameters
        ----------
        cells : bool, shape (n_owned,)
        """
        strain = np.where(self._asked & cells, self._strains(self._move(u), 0.0)[0][: len(self.cells)], 0.0)
        (top,) = largest(self.share.comm, np.array([strain.max(initial=0.0)]))
        first = np.where((strain == top) & (strain > 0.0), 0.0, np.inf)
        return float(largest(self.share.comm, np.array([self.ratios(u, first).max(initial=0.0)]))[0])

    def _move(self, u: np.ndarray) -> np.ndarray:
        """Give free points and nodes their displacements; those of the rank's nodes, (n_nodes, 3). Collective."""
        nodes, unknowns = self.model.nodes, self.model.unknowns
        if unknowns.n_points:
            free = self._by_cell[: self._n_free]
            free[:, :, 0:3] = by_component(unknowns.of_points(u)).reshape(-1, 2, 3, W)
        moved = np.empty((len(nodes.number), 3))
        moved[: nodes.n_owned] = unknowns.of_nodes(u)
        nodes.halo.scatter_forward(moved)
        return moved

    def _displace(self, cells: np.ndarray, moved: np.ndarray) -> None:
        """Displace the points of some cells that follow nodes, and copies of what others lent. Collective."""
        follow_nodes(cells, self._n_free, self._connectivity, moved, self._S)
        self._halo.scatter_forward(self._by_cell[:, :, 0:3])

    def _strains(self, moved: np.ndarray, enough: float, damaged: np.ndarray | None = None) -> tuple:
        """How far bonds may stretch by the strain of each cell, about where below ``enough``, and by gaps beside it.

        Of ghosts and images too; a bond's stretch is at most the sum of the largest of both around it.

        Collective.
        """
        strain = np.zeros(len(self._class_of))
        free, own = self._n_free, len(self.cells)
        shapes = self._inverse, self._steep, self._tapered
        strains_by_points(self._S, *(rows[:free] for rows in shapes[::2]), enough / NEARLY, strain[:free])
        shapes = *(rows[free:] for rows in shapes), self._S, free
        strains_by_nodes(self._connectivity, *shapes, moved, enough / NEARLY, strain[free:own])
        strain[:own] *= NEARLY
        halo, torn = self._halo.halo if self._images else self._halo, np.zeros(len(self._real), np.int64)
        if damaged is not None:
            torn[:] = damaged[self._real]
            halo.scatter_reverse(torn)
            halo.scatter_forward(torn)
            strain[:own][torn[:own] > 0] = np.inf
        opening, seams = np.zeros(len(strain)), self._seams
        if seams.there_are:
            self._displace(seams.cells[(seams.cells >= free) & (seams.cells < own)], moved)
            seams.open(self._S, self._inverse, torn > 0, opening)
        for number in (strain, opening):
            halo.scatter_forward(number[: halo.n_owned + halo.n_ghost])
        return strain[self._source], opening[self._source]


NO_SURFACE = (
    0.0, np.empty((0, 9)), *2 * (np.empty((0, 4)),), np.zeros(3), 1.0, *4 * (np.zeros(1, np.int64),),
)  # fmt: skip


def _table(points: Points) -> np.ndarray:
    """The table of displacements, 0, and positions that the kernels read."""
    S = np.zeros((points.n_clusters, ROWS, W))
    S[:, 3:6] = by_component(points.x)
    return S.reshape(-1)


def _lent(points: Points) -> np.ndarray:
    """Whether other ranks have copies of a cell; bool, shape (n_cells,). Collective."""
    halo = points.halo.halo if points.images else points.halo
    copies = np.zeros(halo.n_owned + halo.n_ghost, np.int64)
    copies[halo.n_owned :] = 1
    halo.scatter_reverse(copies)
    lent = np.zeros(len(points.cell_number), bool)
    lent[: halo.n_owned] = copies[: halo.n_owned] > 0
    return lent


def _inverse_in_the_middle(corners: np.ndarray) -> np.ndarray:
    """``d r_k / d x_d`` in the middle of cells, shape (n, 3, 3), from their corners, (n, 8, 3)."""
    along = np.zeros((len(corners), 3, 3))
    for a in range(8):
        along += 0.125 * REFERENCE_NODES[a][:, None] * corners[:, a, None, :]
    across = np.stack([np.cross(along[:, k - 2], along[:, k - 1]) for k in range(3)], axis=1)
    return across / (along * across).sum(axis=2)[:, :1, None]


def _tapered(corners: np.ndarray) -> np.ndarray:
    """Which cells are no parallelepipeds, from their corners, (n, 8, 3); bool, shape (n,)."""
    along = np.zeros((len(corners), 3, 3))
    for a in range(8):
        along += 0.125 * REFERENCE_NODES[a][:, None] * corners[:, a, None, :]
    middle, off = corners.mean(axis=1), np.zeros(len(corners))
    for a in range(8):
        straight = middle + (REFERENCE_NODES[a][:, None] * along).sum(axis=1)
        off = np.maximum(off, np.abs(corners[:, a] - straight).max(axis=1))
    return off > STRAIGHT * np.abs(along).max(axis=(1, 2))


def _limits(scene: Scene, share: Share, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One over the critical stretch by classes of points, and the class of some cells: material, and if it may fail."""
    stretch = first_stretches(scene, *bond_sizes(scene, share))
    finite = np.isfinite(stretch)
    inverse = np.where(finite, 1.0 / share.units.numbers(np.where(finite, stretch, 1.0)), 0.0)
    n = len(inverse)
    whole = np.zeros((2 * n, 2 * n))
    whole[:n, :n] = inverse
    never = np.array([region.may_fail is False for region in scene.regions])[share.region[cells]]
    return whole, share.material[cells].astype(np.int64) + n * never
