"""Critical stretches of the bonds between points of two classes, as the deck wants them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pdfem_mpi.body.lattice_planes import bond_sizes
from pdfem_mpi.body.share import Share
from pdfem_mpi.body.softening import BondLaw, first_stretches, laws_of_bonds
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError

#: Critical stretch of bonds that do not break: far above any stretch, and its square is finite.
UNBREAKABLE = 1e100
#: Classes of points that one byte tells apart.
MOST_CLASSES = 256


def point_classes(scene: Scene, share: Share) -> np.ndarray:
    """Class of the points of each cell, by which bonds know their critical stretch; int64, shape (n_cells,).

    The cell's region. Peridynamic cells that follow nodes all the same, by which fitted factors join bodies, count as
    a region more each: that of their cells beside them, numbered behind all regions. Of a region that is found there
    are three: with points that follow nodes, with bonds that are held, and with bonds that may fail.
    """
    if share.found:
        kinds = np.where(share.found.is_turned, 2, np.where(share.found.is_held, 1, 0))
        return share.region + len(scene.regions) * kinds
    joint = share.is_peridynamic & share.is_overlap
    classes = share.region.astype(np.int64)
    classes[joint] = len(scene.regions) + np.searchsorted(share.joint_regions, classes[joint])
    return classes


def critical_stretches(scene: Scene, share: Share) -> np.ndarray:
    """Critical stretch of the bonds between points of two classes, float64, shape (n_classes, n_classes).

    Of bonds that soften it is the stretch at which they begin to.
    """
    of_materials = first_stretches(scene, *bond_sizes(scene, share))
    material, breaks = _by_class(scene, share)
    stretches = np.where(of_materials < UNBREAKABLE, share.units.numbers(of_materials), UNBREAKABLE)
    critical = stretches[material[:, None], material]
    return np.where(breaks, critical, UNBREAKABLE)


def bond_laws(scene: Scene, share: Share) -> tuple[list[BondLaw], np.ndarray]:
    """Laws of a scene with bonds that soften, and which of them holds between points of two classes.

    Returns
    -------
    laws : list of BondLaw
    which : int64, shape (n_classes, n_classes)
        Of bonds that do not break, any.
    """
    laws, which = laws_of_bonds(scene, *bond_sizes(scene, share))
    material, breaks = _by_class(scene, share)
    limits = [replace(law.teeth, limit=share.units.numbers(law.teeth.limit)) for law in laws]
    laws = [replace(law, teeth=teeth) for law, teeth in zip(laws, limits, strict=True)]
    return laws, np.where(breaks, which[material[:, None], material], 0)


def _by_class(scene: Scene, share: Share) -> tuple[np.ndarray, np.ndarray]:
    """Material of each class, and whether bonds between two classes may break."""
    if share.found:
        return _by_class_found(scene, share)
    regions = [*scene.regions, *(scene.regions[k] for k in share.joint_regions)]
    if len(regions) > MOST_CLASSES:
        raise SceneError([
            f"regions are {len(scene.regions)}, and those with joints of fitted bodies count twice where bonds may "
            f"break: {len(regions)} in all, and at most {MOST_CLASSES} can be told apart. Join some of them."
        ])  # fmt: skip
    material = np.array([share.materials.names.index(region.material) for region in regions])
    may = np.array([region.may_fail is not False for region in regions])
    # All points of element regions follow nodes; a deck that says so lets bonds between them break.
    follows = np.array([k >= len(scene.regions) or r.model != "peridynamics" for k, r in enumerate(regions)])
    allowed = ~follows | np.array([lets_overlap_fail(region) for region in regions])
    return material, may[:, None] & may & (~(follows[:, None] & follows) | (allowed[:, None] & allowed))


def _by_class_found(scene: Scene, share: Share) -> tuple[np.ndarray, np.ndarray]:
    """The same where the run finds the region: of bonds with an end that may fail, and none that is held."""
    n = len(scene.regions)
    material = np.tile([share.materials.names.index(region.material) for region in scene.regions], 3)
    may = np.tile([region.may_fail is not False for region in scene.regions], 3) & (np.arange(3 * n) // n != 1)
    free = np.arange(3 * n) // n == 2
    return material, may[:, None] & may & (free[:, None] | free)


def lets_overlap_fail(region: Region) -> bool:
    """Whether the deck says of a region of elements that bonds between points of its overlap may break."""
    return region.model == "finite_elements" and region.may_fail is True
