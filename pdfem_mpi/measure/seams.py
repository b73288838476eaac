"""What opens between cells that share nodes and not points: bonds across it stretch though no cell is strained."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.kernels.cell_strains import gaps_between
from pdfem_mpi.parallel.comm import sum_integers

#: Bonds from one cell to the next are at least as long as this part of a cell's height.
GAP = 1.0 - 3.0**-0.5


@dataclass(frozen=True)
class Seams:
    """Cells with a node of one that has points of its own: what is between them may open.

    Attributes
    ----------
    cells : int64, shape (n,)
        Among the rank's cells and ghosts, in the order of rows.
    nodes : int32, shape (n, 8)
        Their nodes, numbered among themselves.
    held : bool, shape (n_nodes, 3)
        Components that mirror planes hold.
    there_are : bool
        On any rank.
    """

    cells: np.ndarray
    nodes: np.ndarray
    held: np.ndarray
    there_are: bool

    @classmethod
    def of(cls, share: Share, real: np.ndarray, n_owned: int) -> Seams:
        """Those of the rank's cells and ghosts ``real``, places in the share. Collective."""
        free = share.found.is_turned | share.found.is_held
        beside = np.zeros(len(share.nodes), bool)
        beside[share.mesh.cells[free]] = True
        cells = np.flatnonzero(beside[share.mesh.cells[real]].any(axis=1))
        used, nodes = np.unique(share.mesh.cells[real[cells]], return_inverse=True)
        held = share.mirrors.normal_components(share.nodes[used], share.mesh.tolerance / share.units.length)
        count = np.array([np.count_nonzero(cells < n_owned)])
        there_are = bool(sum_integers(share.comm, count)[0])
        return cls(cells, nodes.reshape(-1, 8).astype(np.int32), np.ascontiguousarray(held), there_are)

    def open(self, S: np.ndarray, inverse: np.ndarray, torn: np.ndarray, opening: np.ndarray) -> None:
        """Tell what bonds may stretch by across the gaps beside each own cell, at most.

        Gaps beside cells that are torn do not count: bonds across these reach into them, and are looked at anyway.

        Parameters
        ----------
        S : float64, shape (n_cells * 48,), dimension length
            Displacements and positions of points, as of `strains_by_nodes`.
        inverse : float64, shape (n_owned, 3, 3), dimension length^-1
        torn : bool, shape (n_owned + n_ghosts,)
        opening : float64, shape (n_cells,), dimension 1
            Overwritten for own cells here.
        """
        whole = ~torn[self.cells]
        cells, apart = self.cells[whole], np.empty(np.count_nonzero(whole))
        gaps_between(S, cells, self.nodes[whole], self.held, *np.empty((2, len(self.held), 3)), apart)
        here = cells < len(inverse)
        cells = cells[here]
        # a bond crosses one face for each GAP of a cell's height along it; the heights are 2 / |d r_k / d x|
        crossings = 0.5 * np.sqrt((inverse[cells] ** 2).sum(axis=(1, 2))) / GAP
        opening[cells] = apart[here] * crossings
