"""What a fit of bond factors asks of the whole body: its name, area vectors and slack; made when it is asked for.

A fit that is found on disk needs nothing but the name.
"""

from __future__ import annotations

import hashlib

import numpy as np

from pdfem_mpi.body.areas import Boundary, area_vectors, find_boundary, restore_compatibility
from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.body.fitted_bodies import meets_another
from pdfem_mpi.deck.materials import BOND_POISSONS_RATIO
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.kernels.hex8 import gauss_positions, gauss_volumes
from pdfem_mpi.mesh.hexmesh import FACES
from pdfem_mpi.mesh.part import MeshPart
from pdfem_mpi.mesh.quality import CORNERS

#: Free surfaces change alone while this takes at most so many times the change of all. Uniform strains of bodies
#: jittered by 10 % then err as much (1.9 times the change: .063 against .058 eps Delta) or more (4.9 times: .38
#: against .067).
DEARER = 3.0
#: Edges at a corner are at right angles, and neighbours equally long, within this.
SQUARE = 1e-6


class Boundaries:
    """The boundaries of the bodies of a scene whose bond factors are to be fitted.

    It is the one thing of a share that keeps the whole body: a model that is made lets go of it.

    Parameters
    ----------
    whole : Discretization
    mesh : MeshPart
        The rank's cells.
    hollow : bool
        Whether bonds may end at the surface of cells without points, too.

    Attributes
    ----------
    boxes : float64, shape (n_bodies, 2, 3), dimension length
        Lower and upper corners of the bodies, model units.
    thin : int
        Cells at which a body is too thin for a fit.
    first_thin : float64, shape (3,), or None
        Where the first of them is, the deck's units.
    """

    def __init__(self, whole: Discretization, mesh: MeshPart, hollow: bool):
        self._whole, self._mesh, self._hollow = whole, mesh, hollow
        self.thin = len(whole.thin)
        self.first_thin = whole.mesh.centroids[whole.thin[0]] if self.thin else None
        self.boxes = np.empty((whole.n_bodies, 2, 3))
        for number in range(whole.n_bodies):
            nodes = whole.nodes[np.unique(whole.mesh.cells[whole.body == number])]
            self.boxes[number] = nodes.min(axis=0), nodes.max(axis=0)

    @classmethod
    def of(cls, scene: Scene, whole: Discretization, mesh: MeshPart) -> Boundaries | None:
        """Those of a scene; None where nothing is to be fitted."""
        wanted = scene.peridynamics.surface_correction == "fitted" and whole.n_bodies
        return cls(whole, mesh, scene.mesh.may_have_hollows) if wanted else None

    def fingerprint(self, settings: str) -> str:
        """Hexadecimal name of a fit; ``settings`` are all it depends on beside the body."""
        return fingerprint(self._whole, settings, self._hollow)

    def areas_and_slack(self, bounded: bool) -> tuple[np.ndarray, float, np.ndarray]:
        """Area vectors of the points of the rank's cells, the largest change a body needed, and points that get slack.

        Returns
        -------
        areas : float64, shape (n_cells, 8, 3), dimension length^2
        change : float
        slack : bool, shape (n_cells, 8)
        """
        whole, cells = self._whole, self._mesh.cell_id
        boundary = find_boundary(whole.mesh, whole.nodes, whole.body)
        areas, change = compatible_areas(whole, boundary)
        slack = np.zeros(len(whole.mesh.cells), bool)
        if bounded:
            slack[skewed_corners(whole, boundary)] = True
        return areas[cells], change, np.repeat(slack[cells, None], 8, axis=1)


def fingerprint(discretization: Discretization, settings: str, hollow: bool = False) -> str:
    """Hexadecimal name of a fit: everything it depends on. The units of stress and length are not among it."""
    mesh, chosen = discretization.mesh, discretization.has_points
    digest = hashlib.sha256(f"{settings} {discretization.cutoff!r}".encode())
    if _is_volumetric(discretization):
        digest.update(b"volumetric")  # other area vectors
    moduli = discretization.materials.own_bond_modulus[discretization.material[chosen]]
    digest.update(np.unique(moduli).tobytes() if discretization.n_bodies == 1 else moduli.tobytes())
    digest.update(np.ascontiguousarray(discretization.body[chosen]).tobytes())
    digest.update(np.ascontiguousarray(discretization.nodes[mesh.cells[chosen]]).tobytes())
    digest.update(np.ascontiguousarray(mesh.cells[chosen], np.int64).tobytes())
    digest.update(np.ascontiguousarray(_beside_others(discretization)).tobytes())
    if hollow:
        cells, sides = mesh.boundary
        digest.update(b"bonds inside" + discretization.nodes[mesh.cells[cells[:, None], FACES[sides]]].tobytes())
    return digest.hexdigest()


def _beside_others(discretization: Discretization) -> np.ndarray:
    """Cells with points that touch a cell without, or of another body: bool, shape (n_cells,)."""
    mesh, body = discretization.mesh, discretization.body
    touch = mesh.neighbours(body < 0)
    if discretization.n_bodies > 1:
        touch |= meets_another(mesh, body)
    return discretization.has_points & touch


def _is_volumetric(discretization: Discretization) -> bool:
    """Whether bonds have a volumetric part beside them."""
    return bool((discretization.poissons_ratio[discretization.has_points] != BOND_POISSONS_RATIO).any())


def _moments(discretization: Discretization, number: int) -> np.ndarray:
    """Volume and first moments of the points of a body, model units; float64, shape (4,)."""
    corners = discretization.nodes[discretization.mesh.cells[discretization.body == number]]
    w, x = gauss_volumes(corners).reshape(-1), gauss_positions(corners).reshape(-1, 3)
    return np.append(w.sum(), (w[:, None] * x).sum(axis=0))


def compatible_areas(discretization: Discretization, boundary: Boundary) -> tuple[np.ndarray, float]:
    """Area vectors of all cells' points, shape (n_cells, 8, 3), model units; and the largest change a body needed.

    Those beside cells without points, or of another body, stay: there the nodal forces are the same integrals. Where
    too few others are left, as of a body all inside others or of a fibre's ends, they share in the change.
    """
    n_cells = len(discretization.has_points)
    areas = area_vectors(boundary, n_cells)
    beside, largest_change = _beside_others(discretization), 0.0
    volumetric = _is_volumetric(discretization)
    for number in range(discretization.n_bodies):
        cells = np.unique(boundary.cell[discretization.body[boundary.cell] == number])
        x = gauss_positions(discretization.nodes[discretization.mesh.cells[cells]]).reshape(-1, 3)
        own = areas[cells].reshape(-1, 3)
        used = (own != 0.0).any(axis=1)
        changeable = np.repeat(~beside[cells], 8)[used]
        moments = _moments(discretization, number) if volumetric else None
        changed, change = restore_compatibility(x[used], own[used], np.ones(len(changeable), bool), moments)
        if change and changeable.any():
            of_free, more = restore_compatibility(x[used], own[used], changeable, moments)
            if more <= DEARER * change:
                changed, change = of_free, more
        own[used] = changed
        areas[cells] = own.reshape(-1, 8, 3)
        largest_change = max(largest_change, change)
    return areas, largest_change


def skewed_corners(discretization: Discretization, boundary: Boundary) -> np.ndarray:
    """Cells with three or more boundary faces that have cells other than right-angled ones within the cutoff radius.

    All bonds of a corner's point lie in one octant of a regular grid. Their xyz moment has to vanish, which positive
    factors can only do where points lie exactly in its planes.
    """
    from scipy.spatial import cKDTree

    mesh = discretization.mesh
    corners = np.flatnonzero(np.bincount(boundary.cell, minlength=len(mesh.cells)) >= 3)
    nodes = discretization.nodes[mesh.cells]
    edges = nodes[:, CORNERS] - nodes[:, :, None]
    length = np.sqrt((edges**2).sum(axis=-1))
    angle = np.abs((edges[:, :, 0] * edges[:, :, 1]).sum(axis=-1) / (length[:, :, 0] * length[:, :, 1]))
    for a, b in ((1, 2), (2, 0)):
        angle = np.maximum(
            angle, np.abs((edges[:, :, a] * edges[:, :, b]).sum(axis=-1) / (length[:, :, a] * length[:, :, b]))
        )
    skewed = np.flatnonzero(discretization.has_points & (angle.max(axis=1) > SQUARE))
    if not len(skewed) or not len(corners):
        return np.empty(0, np.int64)
    centres = discretization.units.places(mesh.centroids)
    reach = discretization.cutoff + float(length.max())
    near, _ = cKDTree(centres[skewed]).query(centres[corners], distance_upper_bound=reach)
    return corners[np.isfinite(near)]
