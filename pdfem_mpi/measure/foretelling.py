"""Where the next bond can break: stretches of bonds that are not there, from displacements interpolated to points.

At every cell of the body there are eight points: those of bonds have displacements of their own, those of elements
follow the nodes. The strain of a cell alone would not do: its bonds reach into neighbours with twice of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.body.softening import first_stretches
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.finite_elements.nodes import local_nodes
from pdfem_mpi.kernels.families import CUTOFF_GUARD
from pdfem_mpi.kernels.foretold import between_cells, within_cells
from pdfem_mpi.kernels.interpolation import interpolate
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.model.model import Model
from pdfem_mpi.parallel.comm import largest
from pdfem_mpi.peridynamics.clusters import by_component, point_rows
from pdfem_mpi.peridynamics.gaps import with_gaps
from pdfem_mpi.peridynamics.points import make_points, sums_table

#: Ratios are rounded to multiples of this: twins in a mirror that differ in their last digits are equal.
ROUNDED = 2.0**-20
#: A cell is looked at where a cell within the cutoff radius stretches within itself by this part of the threshold: a
#: bond's stretch is a mean of the strain along it.
WARM = 0.5
#: Cells whose surroundings are listed at a time.
BATCH = 2048


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
        self.share, self.model = share, model
        self.points = with_gaps(share, make_points(replace(share, subdomain=around), share.comm))
        self.cells = np.concatenate([around.free, around.overlap])
        self._S = sums_table(self.points)[0]
        self._connectivity = local_nodes(share)[share.mesh.cells[around.overlap]]
        self._inverse, self._class_of = _limits(scene, share, around.point_cells)
        x = point_rows(self.points.x).reshape(-1, 8, 3)
        self._centres = 0.5 * (x.min(axis=1) + x.max(axis=1))
        radius = np.sqrt(((x - self._centres[:, None]) ** 2).sum(axis=2).max(axis=1))
        self._reach = share.cutoff + 2.0 * float(largest(share.comm, np.array([radius.max(initial=0.0)]))[0])
        self._asked = ~share.found.is_turned[self.cells]

    def place(self, u: np.ndarray) -> np.ndarray:
        """Displacements of the eight points of each of the rank's cells, shape (n_owned, 8, 3). Collective.

        Parameters
        ----------
        u : float64, shape (n_unknowns,), dimension length
        """
        nodes, points, S = self.model.nodes, self.points, self._S
        unknowns = self.model.unknowns
        if unknowns.n_points:
            S[: 2 * points.n_free, 0:3] = by_component(unknowns.of_points(u))
        moved = np.empty((len(nodes.number), 3))
        moved[: nodes.n_owned] = unknowns.of_nodes(u)
        nodes.halo.scatter_forward(moved)
        interpolate(S, points.n_free, self._connectivity, moved)
        points.halo.scatter_forward(S.reshape(-1, 2, 9, W)[:, :, 0:3])
        return S[: 2 * points.n_owned, 0:3].reshape(-1, 2, 3, W).swapaxes(2, 3).reshape(-1, 8, 3)

    def ratios(self, u: np.ndarray, threshold: float) -> np.ndarray:
        """Largest foretold stretch over the critical one, of the rank's cells that are not turned.

        Parameters
        ----------
        u : float64, shape (n_unknowns,), dimension length
        threshold : float
            Ratios well below it may be told too small; 0: all are right.

        Returns
        -------
        float64, shape (n_owned,)
            0 for other cells.
        """
        self.place(u)
        S = self._S.reshape(-1)
        ratio = np.zeros(len(self._centres))
        rest = S, self._class_of, self._inverse, self.share.cutoff**2
        within_cells(*rest, ratio)
        chosen = self._worth_a_look(ratio, WARM * threshold)
        gaps = self.points.gaps
        surface = (gaps.cutoff, gaps.corners, gaps.planes, *gaps.near) if gaps else NO_SURFACE
        for cells, start, others in self._surroundings(chosen):
            between_cells(cells, start, others, *rest, *surface, ratio)
        found = np.rint(ratio[: len(self.cells)] / ROUNDED) * ROUNDED
        return np.where(self._asked, found, 0.0)

    def _worth_a_look(self, ratio: np.ndarray, least: float) -> np.ndarray:
        """Cells of the rank that have a cell near that stretches within itself; int64."""
        from scipy.spatial import cKDTree

        asked = np.flatnonzero(self._asked)
        if least == 0.0 or not len(asked):
            return asked
        warm = ratio >= least
        if not warm.any():
            return np.empty(0, np.int64)
        distance, _ = cKDTree(self._centres[warm]).query(self._centres[asked], distance_upper_bound=self._reach)
        return asked[np.isfinite(distance)]

    def _surroundings(self, chosen: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Some of the cells at a time, where their lists begin, and the cells within reach of each; int64."""
        from scipy.spatial import cKDTree

        if not len(chosen):
            return
        tree = cKDTree(self._centres)
        for first in range(0, len(chosen), BATCH):
            cells = chosen[first : first + BATCH]
            lists = tree.query_ball_point(self._centres[cells], self._reach)
            start = np.concatenate([[0], np.cumsum([len(found) for found in lists])]).astype(np.int64)
            yield cells, start, np.concatenate(lists).astype(np.int64)


NO_SURFACE = (
    0.0, np.empty((0, 9)), *2 * (np.empty((0, 4)),), np.zeros(3), 1.0, *4 * (np.zeros(1, np.int64),),
)  # fmt: skip


def _limits(scene: Scene, share: Share, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One over the critical stretch by classes of points, and the class of some cells: material, and if it may fail."""
    stretch = first_stretches(scene, share.units.length, share.cutoff / (1.0 + CUTOFF_GUARD))
    finite = np.isfinite(stretch)
    inverse = np.where(finite, 1.0 / share.units.numbers(np.where(finite, stretch, 1.0)), 0.0)
    n = len(inverse)
    whole = np.zeros((2 * n, 2 * n))
    whole[:n, :n] = inverse
    never = np.array([region.may_fail is False for region in scene.regions])[share.region[cells]]
    return whole, share.material[cells].astype(np.int64) + n * never
