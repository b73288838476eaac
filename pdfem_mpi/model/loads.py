"""Loads and supports of a deck as vectors over the unknowns, and the rigid motions they leave free.

All vectors are in model units, at load factor 1. The owner of a node sums its loads over all cells around it, in the
order of the mesh, so that any number of ranks finds the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.loads import BodyForce, Force
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.kernels.dense import product, solve
from pdfem_mpi.model.balance import find_unbalanced, remove_free_motion, without_equilibrium
from pdfem_mpi.model.body_forces import density, lump_on_nodes, point_forces
from pdfem_mpi.model.factor_formulas import Following
from pdfem_mpi.model.gauges import Gauge, gauge_of
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.motions import combine, free_motions, rigid_gram, rigid_modes
from pdfem_mpi.model.one_way import one_way
from pdfem_mpi.model.parts import Parts, UnsupportedPart, find_parts, find_unsupported
from pdfem_mpi.model.restraints import problems_of_restraints, tie
from pdfem_mpi.model.supports import prescribe
from pdfem_mpi.model.thermal import Thermal, make_thermal
from pdfem_mpi.model.tractions import traction_forces
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.peridynamics.clusters import cluster_layout


@dataclass(frozen=True)
class LoadCase:
    """External forces and prescribed displacements at load factor 1.

    Attributes
    ----------
    external : float64, shape (n_unknowns,), dimension force
    fixed : bool, shape (n_unknowns,)
        Unknowns with a prescribed displacement, those normal to mirror planes included.
    prescribed : float64, shape (n_unknowns,), dimension length
        Their displacements; 0 elsewhere.
    volume : float64, shape (n_unknowns,), dimension length^3, or None
        Share of the body's volume that each unknown stands for, where some motion is free.
    free_motions : float64, shape (n_modes, 6)
        Rigid motions that no support and no mirror plane holds, as combinations of `rigid_modes`.
    untied_motions : float64, shape (n_more_modes, 6)
        The same without ties.
    rigid_gram : float64, shape (6, 6)
        Products of the rigid modes over the body's volume; empty where no motion is free.
    parts : Parts
        Which unknowns hang together.
    unsupported : tuple of UnsupportedPart
        Parts with motions of their own that no support holds; empty for a body in one piece.
    held : tuple of three int64 arrays, for each support
        Unknowns that it prescribes along x, y and z.
    moves : tuple of bool
        Supports that prescribe something else than 0 at some load factor.
    reach : float, dimension length
        Largest prescribed displacement.
    load : float, dimension force
        Resultant of the external forces that push one way (those along the axes, or those against them).
    thermal : Thermal or None
        The strain of a change of temperature, whose forces are part of ``external``.
    grows, lost : bool
        Whether ``load`` is that of loads that grow; else it is that of constant ones, beside which there are none, or
        all that grew is ``lost``, off what came loose.
    taken : float64, shape (3,), dimension force
        Sums of the forces along x, y and z that loads put on held places, where supports take them at once; NaN where
        there are none.
    constant : float64, shape (n_unknowns,), dimension force, or None
        Forces that act whatever the load factor is.
    following : tuple of Following
        Prescribed displacements that are formulas of the load factor.
    opening : Gauge or None
        What the load program controls, where it is an opening.
    """

    external: np.ndarray
    fixed: np.ndarray
    prescribed: np.ndarray
    volume: np.ndarray | None
    free_motions: np.ndarray
    untied_motions: np.ndarray
    rigid_gram: np.ndarray
    parts: Parts
    unsupported: tuple[UnsupportedPart, ...]
    held: tuple[tuple[np.ndarray, ...], ...]
    moves: tuple[bool, ...]
    reach: float
    load: float
    taken: np.ndarray
    constant: np.ndarray | None = None
    following: tuple[Following, ...] = ()
    opening: Gauge | None = None
    thermal: Thermal | None = None
    grows: bool = True
    lost: bool = False

    @property
    def of_loads(self) -> np.ndarray:
        """The forces that ``load`` is of, at load factor 1, without those of thermal strain; shape (n_unknowns,)."""
        if not self.grows:
            return self.constant
        return self.external if self.thermal is None else self.external - np.where(self.fixed, 0, self.thermal.forces)

    def forces(self, load_factor: float) -> np.ndarray:
        """The external forces at a load factor; float64, shape (n_unknowns,)."""
        if self.constant is None:
            return load_factor * self.external
        return load_factor * self.external + self.constant

    def displace(self, u: np.ndarray, load_factor: float) -> None:
        """Give the fixed unknowns their displacements at a load factor."""
        u[self.fixed] = load_factor * self.prescribed[self.fixed]
        for part in self.following:
            u[part.index] = part.at(load_factor)


def make_load_case(scene: Scene, share: Share, model: Model) -> LoadCase:
    """Assemble the deck's loads and supports for this rank, and check that free motions are balanced. Collective.

    Raises
    ------
    SceneError
        Selections without cells or nodes, tractions on peridynamic cells, supports that contradict each other,
        loads that are not in balance along a motion no support holds.
    """
    messages: list[str] = []
    external = _forces(scene, share, model, messages, constant=False)
    constant = _forces(scene, share, model, messages, constant=True) if any(x.constant for x in scene.loads) else None
    prescription = prescribe(scene, share, model, messages)
    fixed = ~np.isnan(prescription.amounts)
    messages += problems_of_restraints(share, model, fixed)
    if messages:
        raise SceneError(messages)

    prescribed = np.zeros(model.n_unknowns)
    prescribed[fixed] = prescription.amounts[fixed]
    held = tuple(
        tuple(np.flatnonzero((prescription.holders == k) & (model.unknowns.components() == d)) for d in range(3))
        for k in range(len(scene.supports))
    )
    taken = _on_held(model, external if constant is None else external + constant, fixed)
    external[fixed] = 0.0
    if constant is not None:
        constant[fixed] = 0.0
    free, parts = free_motions(model, fixed), find_parts(model)
    unsupported = find_unsupported(model, parts, fixed) if parts.count > 1 else ()
    volume = _volume(share, model) if len(free) or unsupported else None
    load = one_way(model, external)
    case = LoadCase(
        external=external,
        fixed=fixed,
        prescribed=prescribed,
        volume=volume,
        free_motions=free,
        untied_motions=free_motions(model, fixed, tied=False) if model.ties else free,
        rigid_gram=rigid_gram(model, volume) if len(free) else np.empty((0, 0)),
        parts=parts,
        unsupported=unsupported,
        held=held,
        moves=tuple(r > 0.0 or x.follows_factor for r, x in zip(prescription.reach, scene.supports, strict=True)),
        reach=max(prescription.reach, default=0.0),
        load=load or (0.0 if constant is None else one_way(model, constant)),
        taken=taken,
        constant=constant,
        following=prescription.following,
        opening=_controlled(scene, share, model),
        grows=constant is None or load > 0.0,
    )
    for forces in (external,) if constant is None else (external, constant):
        if messages := find_unbalanced(model, free, parts, unsupported, forces):
            raise SceneError(messages)
    return _with_thermal(scene, share, model, case)


def _with_thermal(scene: Scene, share: Share, model: Model, case: LoadCase) -> LoadCase:
    """The load case with the forces of thermal strain, which are in balance by themselves. Collective."""
    thermal = make_thermal(scene, share, model)
    if thermal is None:
        return case
    external = tie(model, case.external + np.where(case.fixed, 0.0, thermal.forces))
    return replace(case, external=external, thermal=thermal)


def _forces(scene: Scene, share: Share, model: Model, messages: list[str], constant: bool) -> np.ndarray:
    """Forces of the loads that grow, or of those that are constant, over the unknowns. Collective."""
    on_cells, on_nodes, on_points = _sum_loads(scene, share, messages, constant)
    lump_on_nodes(share, on_cells, on_nodes)
    on_free_points = point_forces(share, model, on_cells)
    if model.points and on_points.any():
        on_free_points += cluster_layout(on_points[share.subdomain.free])
    return tie(model, _join(share, model, on_free_points, on_nodes))


def _controlled(scene: Scene, share: Share, model: Model) -> Gauge | None:
    """The opening that the load program controls, if it does."""
    name = getattr(scene.stepping, "opening", None)
    return None if name is None else gauge_of(share, model, share.probes[f"{name}.opening"])


def _sum_loads(scene: Scene, share: Share, messages: list[str], constant: bool):
    """Body forces per volume of cells, and tractions on nodes and on the points of cells. Collective.

    Of the loads that are constant, or of the others.

    Returns
    -------
    on_cells, on_nodes, on_points : float64, shapes (n_cells, 3), (n_nodes, 3), (n_cells, 8, 3)
    """
    on_cells = np.zeros((len(share.mesh.cells), 3))
    on_nodes = np.zeros((len(share.nodes), 3))
    on_points = np.zeros((len(share.mesh.cells), 8, 3))
    selections = share.selections
    for index, (load, chosen) in enumerate(zip(scene.loads, selections.loads, strict=True)):
        if load.constant != constant:
            continue
        messages += selections.problems["loads"][index]
        if chosen is None:
            continue
        try:
            if isinstance(load, BodyForce):
                on_cells[chosen.cells] += density(share, load, chosen.cells)
            elif isinstance(load, Force):
                force = share.units.numbers(np.array(load.total) / share.units.force)
                on_nodes[chosen.nodes] += chosen.node_parts[:, None] * force
                np.add.at(on_points, tuple(chosen.points.T), chosen.point_parts[:, None] * force)
            else:
                nodal, of_points = traction_forces(share, load, chosen, f"loads.{index}")
                on_nodes += nodal
                on_points += of_points
        except SceneError as error:
            messages += error.messages
    return on_cells, on_nodes, on_points


def without_loads_on_loose_parts(model: Model, case: LoadCase) -> tuple[LoadCase, list[UnsupportedPart]]:
    """The load case less the loads of parts that no equilibrium holds now; those parts. Collective."""
    rows, parts = without_equilibrium(model, case.fixed, case.external)
    external = np.where(rows, 0.0, case.external)
    if case.constant is None:
        return replace(case, external=external, load=one_way(model, external)), parts
    others, more = without_equilibrium(model, case.fixed, case.constant)
    external, constant = (np.where(rows | others, 0.0, forces) for forces in (case.external, case.constant))
    load = one_way(model, external)
    lost, load = case.grows and not load, load or one_way(model, constant)
    known = {part.text for part in parts}
    parts += [part for part in more if part.text not in known]
    return replace(case, external=external, constant=constant, load=load, lost=lost), parts


def _volume(share: Share, model: Model) -> np.ndarray:
    """Share of the body's volume that each unknown stands for; float64, shape (n_unknowns,)."""
    ones = np.ones((len(share.mesh.cells), 3))
    on_nodes = np.zeros((len(share.nodes), 3))
    lump_on_nodes(share, ones, on_nodes)
    return _join(share, model, point_forces(share, model, ones), on_nodes)


def _on_held(model: Model, external: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Sums along x, y and z of forces on held unknowns, NaN where no load is; float64, shape (3,). Collective."""
    along, force = model.unknowns.components()[fixed], external[fixed]
    sides = [np.where(along == d, force, 0.0) for d in range(3)]
    ones = np.ones_like(force)
    sums = exact_dots(model.comm, [(values, ones) for side in sides for values in (side, np.abs(side))]).reshape(3, 2)
    return np.where(sums[:, 1] > 0.0, sums[:, 0], np.nan)


def remove_rigid_motion(model: Model, case: LoadCase, u: np.ndarray) -> None:
    """Take free rigid motions out of a displacement: its mean, or that of each unsupported part, vanishes. Collective.

    Parameters
    ----------
    u : float64, shape (n_unknowns,)
        Overwritten.
    """
    if case.parts.count > 1:
        remove_free_motion(model, case.parts, case.unsupported, case.volume, u)
        return
    if not len(case.free_motions):
        return
    weighted = case.volume * u
    work = exact_dots(model.comm, ((weighted, mode) for mode in rigid_modes(model)))
    motions = case.free_motions
    kept = product(product(motions, case.rigid_gram), motions.T)
    u -= combine(model, product(solve(kept, product(motions, work)), motions))
    tie(model, u)


def _join(share: Share, model: Model, on_points: np.ndarray, on_nodes: np.ndarray) -> np.ndarray:
    """The flat vector over the unknowns; where there is nothing but zeros, no page of it is written."""
    joined = np.zeros(model.n_unknowns)
    if on_points.any():
        model.unknowns.of_points(joined)[:] = on_points
    if model.nodes:
        model.unknowns.of_nodes(joined)[:] = on_nodes[share.subdomain.owned_nodes]
    return joined
