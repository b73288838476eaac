"""Mirror images of a rank's cells, and a halo that refreshes them and takes back what was added to them.

Images carry the bonds across mirror planes. They need no messages of their own: an image within the cutoff radius of an
owned cell is that of an owned cell or of a ghost, since a mirror never brings points nearer to each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.kernels.reflections import copy_images, return_images
from pdfem_mpi.parallel.halo import Halo

#: What travels, component by component: the axes whose reflection changes its sign.
VECTOR = ((0,), (1,), (2,))
MAGNITUDES = ((), (), ())
SCALAR = ((),)
MIXED_PRODUCTS = ((0, 1), (1, 2), (2, 0))
#: Any of these.
Parity = tuple[tuple[int, ...], ...]


@dataclass(frozen=True)
class Images:
    """Image cells of a rank, which stand behind its owned cells and ghosts.

    Attributes
    ----------
    source : int64, shape (n_images,)
        Local index of the owned cell or ghost that each is an image of.
    reflection : int64, shape (n_images,)
        Number of the reflection, from 1, the same on all ranks.
    sign : float64, shape (n_images, 3)
        ``x = sign x_source + shift``; 1 or -1.
    shift : float64, shape (n_images, 3), dimension length
    """

    source: np.ndarray
    reflection: np.ndarray
    sign: np.ndarray
    shift: np.ndarray

    def factors(self, parity: Parity) -> np.ndarray:
        """1 or -1 for each image and component; int64, shape (n_images, n_components)."""
        columns = [np.prod(self.sign[:, list(axes)], axis=1) for axes in parity]
        return np.stack(columns, axis=1).astype(np.int64)


class MirroredHalo:
    """A `Halo` of cells with images behind the ghosts; the same verbs, on tables (n_cells, 2, n_components, 4).

    Parameters
    ----------
    halo : Halo
        Of owned cells and ghosts.
    images : Images
    parity : Parity
        Of what travels.
    """

    def __init__(self, halo: Halo, images: Images, parity: Parity = VECTOR):
        self.halo, self.images, self.factors = halo, images, images.factors(parity)
        self.n_real = halo.n_owned + halo.n_ghost
        self.n_owned, self.n_ghost, self.n_lent = halo.n_owned, halo.n_ghost, halo.n_lent
        self.neighbours = halo.neighbours

    def scatter_forward(self, a: np.ndarray) -> None:
        """Overwrite ghosts by the rows of their owners, and images by reflected ones. float64."""
        self.start_forward(a)
        self.finish_forward(a)

    def scatter_reverse(self, a: np.ndarray) -> None:
        """Add images, reflected back, and ghosts to the rows of their owners. int64; ghosts are changed."""
        self.start_reverse(a)
        self.finish_reverse(a)

    def start_forward(self, a: np.ndarray) -> None:
        """Send the owned rows that neighbours hold as ghosts."""
        self.halo.start_forward(a[: self.n_real])

    def finish_forward(self, a: np.ndarray) -> None:
        """Wait for the ghosts, and reflect them and the owned rows into the images."""
        self.halo.finish_forward(a[: self.n_real])
        copy_images(a, self.images.source, self.factors)

    def start_reverse(self, a: np.ndarray) -> None:
        """Add the images to the rows they are images of, and send the ghosts to their owners."""
        return_images(a, self.images.source, self.factors)
        self.halo.start_reverse(a[: self.n_real])

    def finish_reverse(self, a: np.ndarray) -> None:
        """Wait for the rows that neighbours hold as ghosts, and add them to the owned rows."""
        self.halo.finish_reverse(a[: self.n_real])

    def scatter_smallest(self, a: np.ndarray) -> None:
        """Lower the rows of owners to the smallest of their copies, then overwrite the ghosts; images stay."""
        self.halo.scatter_smallest(a[: self.n_real])

    def test(self) -> None:
        """Let messages progress."""
        self.halo.test()


def halo_for(halo: Halo | MirroredHalo, parity: Parity) -> Halo | MirroredHalo:
    """The halo for rows of another parity than the one it was made for; without mirrors the same halo."""
    return MirroredHalo(halo.halo, halo.images, parity) if isinstance(halo, MirroredHalo) else halo
