"""The bonds of a rank: search, rows, surface correction (appendix A), fictitious masses (eq. 11). Collective."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pdfem_mpi.body.materials import MaterialTable
from pdfem_mpi.kernels import families, surface_correction
from pdfem_mpi.kernels.cracks import cut_rows
from pdfem_mpi.kernels.failure import add_noise
from pdfem_mpi.kernels.images import share_own_images
from pdfem_mpi.kernels.peridynamics import add_densities
from pdfem_mpi.kernels.simd import PATTERN, W
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.parallel.halo import Halo
from pdfem_mpi.peridynamics.images import MAGNITUDES, Images, MirroredHalo, halo_for

#: Response constant ``c = 9 k / (pi l^4)`` (eq. 2) per Young's modulus in model units, where
#: ``k = E / (3 (1 - 2 nu)) = 2/3``.
BULK_MODULUS = 2.0 / 3.0
RESPONSE_CONSTANT = 9.0 * BULK_MODULUS / math.pi


@dataclass(frozen=True)
class Points:
    """Collocation points of the local cells: owned free cells, owned overlap cells, ghosts, mirror images.

    Attributes
    ----------
    n_free, n_owned : int
        Numbers of owned cells with free points, and of all owned cells with points.
    cell_number : int64, shape (n_cells,)
        Global number of each local cell among the cells with points; point ids are ``8 number + g``. An image has the
        number of its cell.
    material : int16, shape (n_cells,)
        Material of each local cell.
    x : float64, shape (n_cells * 24,), dimension length
        Positions in cluster layout ``[cluster][component][lane]``, two clusters a cell.
    volume : float64, shape (n_cells * 8,), dimension length^3
        Integration weights ``w``.
    halo : Halo or MirroredHalo
        Exchange of blocks of one cell whose rows are components of vectors (`images.halo_for` for others).
    images : Images or None
        None without mirror planes.
    n_numbers : int
        Cells with points in the whole mesh; needed with images.
    body : int32, shape (n_cells,), or None
        Body of each local cell, where there are several: no bonds between them.
    """

    n_free: int
    n_owned: int
    cell_number: np.ndarray
    material: np.ndarray
    x: np.ndarray
    volume: np.ndarray
    halo: Halo | MirroredHalo
    images: Images | None = None
    n_numbers: int = 0
    body: np.ndarray | None = None

    @property
    def cell_key(self) -> np.ndarray:
        """What tells a cell and its images apart on all ranks: its number, which rises with each image; int64."""
        key = self.cell_number.copy()
        if self.images:
            key[len(key) - len(self.images.reflection) :] += self.n_numbers * self.images.reflection
        return key

    @property
    def n_clusters(self) -> int:
        """Local clusters, ghosts included."""
        return 2 * len(self.cell_number)


@dataclass(frozen=True)
class Rows:
    """Half-list rows: one point against one cluster of four points (see kernels/families.py)."""

    start: np.ndarray
    offset: np.ndarray
    data: np.ndarray

    @property
    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the kernels take."""
        return self.start, self.offset, self.data


@dataclass(frozen=True)
class Bonds:
    """Bonds this rank computes, each bond of the body on exactly one rank.

    Attributes
    ----------
    interior, boundary : Rows
        Rows against owned clusters, and against clusters of ghosts and images.
    finite : bool
        Finite (else linear) kinematics: eight (else four) stored numbers a row.
    cutoff : float, dimension length
        Guarded cutoff radius: no bond is longer.
    rows_of_point : int32, shape (n_clusters * 4,)
    rows_at_cluster : int32, shape (n_clusters,)
        Rows against others that a point has, and rows of others against a cluster.
    by_material : int64, shape (n_materials, n_materials)
        Bonds on this rank, from the material of the row's point to that of its cluster.
    strongest : float, dimension force
        Largest force of a bond per unit stretch, on all ranks.
    stiffest : float, dimension force / length
        Largest half of that over the bond's length, on all ranks.
    """

    interior: Rows
    boundary: Rows
    finite: bool
    cutoff: float
    rows_of_point: np.ndarray
    rows_at_cluster: np.ndarray
    by_material: np.ndarray
    strongest: float
    stiffest: float

    @property
    def added(self) -> np.ndarray:
        """How often a point's sum receives a term through its own rows; int64, shape (n_clusters * 4,)."""
        return W * self.rows_of_point.astype(np.int64)

    @property
    def taken(self) -> np.ndarray:
        """How often a point's sum receives a term through rows at its cluster; int64, shape (n_clusters * 4,)."""
        return np.repeat(self.rows_at_cluster.astype(np.int64), W)

    @property
    def count(self) -> int:
        """Bonds on this rank."""
        return int(self.by_material.sum())

    @property
    def rows(self) -> tuple[Rows, Rows]:
        """Interior and boundary rows."""
        return self.interior, self.boundary


def pattern_for(bound: float) -> tuple[float, float]:
    """Quantum that holds terms up to ``bound``, and the constant that rounds to it.

    Returns
    -------
    quantum, pattern : float
        The smallest power of two with ``bound <= 2**50 quantum``, and ``M = 1.5 * 2**52 quantum``.
    """
    quantum = 2.0 ** (math.frexp(bound)[1] - 50) if bound > 0 else 2.0**-1000
    return quantum, PATTERN * quantum


def integer_bits(x: float) -> int:
    """Bit pattern of a float64 as a signed integer."""
    return int(np.float64(x).view(np.int64))


def find_bonds(points: Points, cutoff: float, finite: bool) -> tuple[Rows, Rows]:
    """Search the families of the owned points and allocate their rows, counted first.

    Without ghosts and images nothing is searched among them.

    Returns
    -------
    interior, boundary : Rows
        With offsets, and stored numbers still 0.
    """
    n_clusters = points.n_clusters
    centre, radius = np.empty((n_clusters, 3)), np.empty(n_clusters)
    families.cluster_balls(points.x, centre, radius)
    lower = centre.min(axis=0) if n_clusters else np.zeros(3)
    extent = (centre.max(axis=0) if n_clusters else np.zeros(3)) - lower
    bin_size = max(0.5 * cutoff, float((max(np.prod(np.maximum(extent, cutoff)), 1e-300) / 2**22) ** (1 / 3)))
    bins = (extent / bin_size).astype(np.int64) + 1
    place = np.minimum(((centre - lower) / bin_size).astype(np.int64), bins - 1)
    flat = (place[:, 2] * bins[1] + place[:, 1]) * bins[0] + place[:, 0]
    bin_index = np.argsort(flat, kind="stable")
    bin_start = np.searchsorted(flat[bin_index], np.arange(int(bins.prod()) + 1))

    n_owned = 2 * points.n_owned
    found = []
    for ghosts in (False, True):
        if ghosts and n_clusters == n_owned:
            start, offset = np.zeros(1, np.int64), np.zeros(1, np.uint32)
            found.append(Rows(start, offset, np.zeros(2 * W if finite else W, np.float32)))
            break
        start = np.zeros(W * n_owned + 1, np.int64)
        search = (
            0, n_owned, points.x, n_owned, ghosts, points.cell_number, centre, radius, cutoff,
            lower, bin_size, bins, bin_start, bin_index, start,
        )  # fmt: skip
        candidates = np.empty(n_clusters, np.int64)
        families.find_rows(*search, np.empty(0, np.uint32), candidates)
        offset = np.zeros(int(start[-1]) + 1, np.uint32)  # one padding row: the sweeps read one row ahead
        families.find_rows(*search, offset, candidates)
        found.append(Rows(start, offset, np.zeros(len(offset) * (2 * W if finite else W), np.float32)))
    return tuple(found)


def _within_bodies(points: Points, rows: Rows, finite: bool) -> Rows:
    """The rows of points against clusters of their own body."""
    n = np.diff(rows.start)
    own, other = np.repeat(np.arange(len(n)) // (2 * W), n), rows.offset[:-1] // np.uint32(2 * 9 * W)
    keep = points.body[own] == points.body[other]
    start = np.concatenate([[0], np.cumsum(keep)])[rows.start]
    offset = np.append(rows.offset[:-1][keep], np.uint32(0))
    return Rows(start, offset, np.zeros(len(offset) * (2 * W if finite else W), np.float32))


def make_bonds(
    comm, points: Points, materials: MaterialTable, cutoff: float, finite: bool, correction: str
) -> tuple[Bonds, float]:
    """Build the bonds of the owned points with their surface correction in them.

    Parameters
    ----------
    materials : MaterialTable
        Those that ``points.material`` counts.
    cutoff : float, dimension length
        Guarded cutoff radius.
    correction : "none", "appendix_a" or "virial"

    Returns
    -------
    bonds : Bonds
    remaining : float
        Largest ``|G / g_inf - 1|`` before the last update, of the virial stress ``|S / E - 1|``; 0 without correction.
    """
    interior, boundary = find_bonds(points, cutoff, finite)
    if points.body is not None:
        interior, boundary = (_within_bodies(points, rows, finite) for rows in (interior, boundary))
    of_point = np.zeros(points.n_clusters * W, np.int64)
    at_cluster = np.zeros(points.n_clusters, np.int64)
    for rows in (interior, boundary):
        families.count_rows(rows.start, rows.offset, of_point, at_cluster)
    of_point, at_cluster = of_point.astype(np.int32), at_cluster.astype(np.int32)

    constants = RESPONSE_CONSTANT * materials.bond_modulus

    def filled(factor):
        counts, strongest = np.zeros(constants.shape, np.int64), np.zeros(2)
        for rows in (interior, boundary):
            families.fill_rows(
                *rows.arrays, points.x, points.volume, factor, constants, points.material, cutoff, finite, strongest,
                counts,
            )  # fmt: skip
        if points.images:
            share_own_images(*boundary.arrays, points.cell_number, points.material, finite, counts)
        return Bonds(
            interior, boundary, finite, cutoff, of_point, at_cluster, counts, *largest(comm, strongest).tolist()
        )

    bonds = filled(np.empty(0))
    if correction == "none":
        return bonds, 0.0
    factor, remaining = _appendix_a(comm, points, materials, bonds, virial=correction == "virial")
    return filled(factor), remaining


def _appendix_a(
    comm, points: Points, materials: MaterialTable, bonds: Bonds, virial: bool = False
) -> tuple[np.ndarray, float]:
    """Iterate the correction vectors towards the response, or the virial stress, of an infinite body.

    Returns
    -------
    factor : float64, shape (n_clusters * 12,)
        Cluster layout, ghosts included.
    remaining : float
        Largest ``|G / g_inf - 1|`` before the last update, on all ranks.
    """
    T, integers = sums_table(points)
    T[:, 0:3] = 1.0
    blocks = T.reshape(-1, 2, 9, W)
    # of Young's modulus 1
    infinite_response = 1.0 if virial else surface_correction.INFINITE_RESPONSE * BULK_MODULUS
    target = np.repeat(infinite_response * materials.youngs_modulus[points.material[: points.n_owned]], 2)
    halo = halo_for(points.halo, MAGNITUDES)
    remaining = 0.0
    longest = max(1.0, 0.5 * bonds.cutoff) if virial else 1.0
    for _ in range(surface_correction.SWEEPS):
        widest = float(largest(comm, np.array([T[:, 0:3].max(initial=0.0)]))[0])
        quantum, pattern = start_sums(T, bonds.added + bonds.taken, bonds.strongest * widest * longest)
        for rows in bonds.rows:
            surface_correction.add_responses(*rows.arrays, T.reshape(-1), integers, pattern, bonds.finite, virial)
        halo.scatter_reverse(blocks.view(np.int64)[:, :, 6:9])
        worst = surface_correction.update_factors(
            2 * points.n_owned,
            T.reshape(-1),
            integers,
            points.volume,
            quantum,
            target,
        )
        remaining = float(largest(comm, np.array([worst]))[0])
        halo.scatter_forward(blocks[:, :, 0:3])
    return np.ascontiguousarray(T[:, 0:3]).reshape(-1), remaining


def fictitious_masses(points: Points, bonds: Bonds) -> np.ndarray:
    """``lambda_i w_i`` of the owned points (eq. 11 with g_ij), for a time step of 1.

    Returns
    -------
    float64, shape (n_owned * 8,), dimension force / length
        By cluster and lane.
    """
    T, integers = sums_table(points)
    quantum, pattern = start_sums(T, bonds.added + bonds.taken, bonds.stiffest)
    for rows in bonds.rows:
        add_densities(*rows.arrays, T.reshape(-1), integers, pattern, bonds.finite)
    halo_for(points.halo, MAGNITUDES).scatter_reverse(T.view(np.int64).reshape(-1, 2, 9, W)[:, :, 6:9])
    sums = T.view(np.int64)[: 2 * points.n_owned, 6:9] * quantum
    return np.ascontiguousarray(sums.max(axis=1)).reshape(-1)


def sums_table(points: Points) -> tuple[np.ndarray, np.ndarray]:
    """A table with the positions in rows 3-5, for kernels that sum over bonds, and its flat view as integers."""
    T = np.zeros((points.n_clusters, 9, W))
    T[:, 3:6] = points.x.reshape(-1, 3, W)
    return T, T.view(np.int64).reshape(-1)


def start_sums(T: np.ndarray, terms: np.ndarray, bound: float) -> tuple[float, float]:
    """Write integer start values that take back the patterns the kernel will add.

    Parameters
    ----------
    T : float64, shape (n_clusters, 9, 4)
        Rows 6-8 are overwritten.
    terms : int64, shape (n_clusters * 4,)
        How often each point's sum receives a term.
    bound : float
        Of a term.

    Returns
    -------
    quantum, pattern : float
    """
    quantum, pattern = pattern_for(bound)
    with np.errstate(over="ignore"):
        T.view(np.int64)[:, 6:9] = (-terms * integer_bits(pattern)).reshape(-1, 1, W)
    return quantum, pattern


def perturbed(points: Points, bonds: Bonds, amplitude: float, seed: int) -> Bonds:
    """Multiply every bond's stiffness by a factor within ``1 +- amplitude``, the same on any ranks; in place."""
    with np.errstate(over="ignore"):
        for rows in bonds.rows:
            add_noise(*rows.arrays, points.cell_number, amplitude, seed, bonds.finite)
    widest = 1.0 + amplitude
    return replace(bonds, strongest=widest * bonds.strongest, stiffest=widest * bonds.stiffest)


def cut_bonds(comm, points: Points, bonds: Bonds, polygon: np.ndarray, normal: np.ndarray) -> int:
    """Cut the bonds that cross a plane polygon. Collective.

    Parameters
    ----------
    polygon : float64, shape (n_corners, 3), dimension length
    normal : float64, shape (3,)

    Returns
    -------
    int
        Bonds cut on all ranks.
    """
    across, up = np.sort(np.argsort(np.abs(normal), kind="stable")[:2])
    cut = sum(
        cut_rows(*rows.arrays, points.x, polygon, normal, int(across), int(up), bonds.finite) for rows in bonds.rows
    )
    return int(sum_integers(comm, np.array([cut]))[0])


def count_by_material(comm, bonds: Bonds) -> np.ndarray:
    """Undirected bonds of the whole body between materials a and b, symmetric. Collective.

    Returns
    -------
    int64, shape (n_materials, n_materials)
    """
    counts = sum_integers(comm, bonds.by_material)
    return counts + counts.T - np.diag(np.diag(counts))


def total_bonds(comm, bonds: Bonds | None) -> int:
    """Undirected bonds of the whole body. Collective."""
    return int(sum_integers(comm, np.array([bonds.count if bonds else 0]))[0])
