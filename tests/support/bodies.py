"""Small bodies for tests: scenes of unit cubes, assembled on one rank or on the ranks of a communicator."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from unittest.mock import patch

import numpy as np

from pdfem_mpi.body.cutting import share_of
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.loads import BodyForce, Traction
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.deck.peridynamics import Coupling, Peridynamics
from pdfem_mpi.deck.programs import Solver
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.toml import parse_deck
from pdfem_mpi.measure.fields import Fields, gather_fields
from pdfem_mpi.measure.geometry import Geometry, gather_geometry
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.loads import LoadCase, make_load_case
from pdfem_mpi.model.model import Model, build_model
from pdfem_mpi.model.state import State, new_state
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.peridynamics.clusters import cluster_layout, point_rows
from pdfem_mpi.runs.run import run
from support.helpers import ROOT
from support.reporters import Silence

YOUNGS_MODULUS = 1000.0


def box_regions(cells, n_elements):
    """Finite elements in the first ``n_elements`` layers along x, peridynamics in the others."""
    x = float(n_elements)
    if n_elements <= 0:
        return (Region(name="bonds", model="peridynamics"),)
    if n_elements >= cells[0]:
        return (Region(name="elements", model="finite_elements"),)
    y, z = float(cells[1]), float(cells[2])
    return (
        Region(name="elements", model="finite_elements", upper=(x, y, z)),
        Region(name="bonds", model="peridynamics", lower=(x, 0.0, 0.0)),
    )


def tension(cells, n_elements, force=1.0):
    """Opposite forces on both ends along x: tractions on elements, body forces on peridynamic cells."""
    loads = []
    for face, sign, elements in (("x-", -1.0, n_elements > 0), ("x+", 1.0, n_elements >= cells[0])):
        total = (sign * force, 0.0, 0.0)
        loads.append(
            Traction(kind="traction", face=face, total=total)
            if elements
            else BodyForce(kind="body_force", face=face, total=total)
        )
    return tuple(loads)


def make_scene(
    cells,
    n_elements=0,
    *,
    regions=None,
    kinematics="linear",
    correction="appendix_a",
    signs="free",
    internal_length=None,
    coupling="paper",
    overlap=1,
    loads=None,
    supports=(),
    solver="adr",
    tolerance=1e-6,
    max_evaluations=20_000,
    poissons_ratio=0.25,
    symmetry=(),
    **tables,
):
    """Return a scene of unit cubes with a corner at the origin: elements at small x, peridynamics at large x."""
    tables.setdefault(
        "mesh", BoxMesh(lower=(0.0, 0.0, 0.0), upper=tuple(map(float, cells)), spacing=1.0, symmetry=symmetry)
    )
    return Scene(
        material=Material(youngs_modulus=YOUNGS_MODULUS, poissons_ratio=poissons_ratio),
        regions=box_regions(cells, n_elements) if regions is None else regions,
        peridynamics=Peridynamics(
            kinematics=kinematics, surface_correction=correction, signs=signs, internal_length=internal_length
        ),
        coupling=Coupling(kind=coupling, overlap=overlap),
        loads=tension(cells, n_elements) if loads is None else loads,
        supports=supports,
        solver=Solver(kind=solver, tolerance=tolerance, max_evaluations=max_evaluations),
        **tables,
    )


def bar_of_cubes(ranks, n_elements=0, tolerance=1e-3):
    """Return a scene of as many cubes of 6 x 6 x 6 cells as ranks, in a row."""
    return make_scene((6 * ranks, 6, 6), n_elements, correction="none", solver="cg", tolerance=tolerance)


@dataclass
class Body:
    """A scene and all that a run makes of it before it solves; model units, one rank's share."""

    scene: Scene
    share: Share
    model: Model
    case: LoadCase | None
    forces: Forces
    state: State

    @cached_property
    def geometry(self) -> Geometry | None:
        """The whole body on rank 0. Collective when first asked for."""
        return gather_geometry(self.share)

    def internal(self, u):
        """Force on the unknowns at displacements ``u``, without loads. Collective."""
        force = np.empty(self.model.n_unknowns)
        self.forces.evaluate_surely(np.ascontiguousarray(u), np.zeros_like(force), force)
        return force

    def fields(self, u):
        """Displacements of all points and nodes at ``u``; None except on rank 0. Collective."""
        self.internal(u)
        return gather_fields(self.share, self.forces, u)

    def of_positions(self, displacement):
        """Unknowns that take the values of a function of positions, shape (n, 3) to (n, 3), model units."""
        model, parts = self.model, []
        if model.points:
            x = model.points.x[: 3 * model.unknowns.n_points].reshape(-1, 3, 4).swapaxes(1, 2).reshape(-1, 3)
            parts.append(cluster_layout(displacement(x)))
        if model.nodes:
            parts.append(displacement(model.nodes.x[: model.nodes.n_owned]).reshape(-1))
        return np.concatenate(parts)


def build(scene, comm=None, loaded=True):
    """Assemble a scene as ``run`` does, on this rank alone unless a communicator is given. Collective."""
    comm = mpi().COMM_SELF if comm is None else comm
    share = share_of(scene, comm)
    model = build_model(scene, share, comm)
    case = make_load_case(scene, share, model) if loaded else None
    state = new_state(model)
    return Body(scene, share, model, case, Forces(model, state.bounds), state)


def bond_list(body):
    """All bonds of a body on one rank: positions (n, 3), ends i and j, and the first stored number of each bond.

    With linear kinematics that is ``c exp(-r^2) g_ij w_i w_j / r^3``, with finite ``c exp(-r^2) g_ij w_i w_j / (2 r)``.
    """
    bonds = body.model.bonds
    stride = 8 if bonds.finite else 4
    found = []
    for rows in bonds.rows:
        n = len(rows.offset) - 1
        i = np.repeat(np.repeat(np.arange(len(rows.start) - 1), np.diff(rows.start)), 4)
        j = (4 * (rows.offset[:-1].astype(np.int64) // 36)[:, None] + np.arange(4)).reshape(-1)
        stored = rows.data.reshape(-1, stride)[:n, :4].reshape(-1).astype(float)
        there = stored != 0.0
        found.append((i[there], j[there], stored[there]))
    return point_rows(body.model.points.x), *(np.concatenate(arrays) for arrays in zip(*found, strict=True))


def local_share(scene):
    """The whole body of a scene as the share of this rank alone."""
    return share_of(scene, mpi().COMM_SELF)


def geometry_of(scene):
    """The shape of a scene's body, on this rank alone."""
    return gather_geometry(local_share(scene))


def fields_of_positions(geometry, displacement):
    """Fields that take the values of a function of positions, shape (n, 3) to (n, 3), in the deck's units."""
    nodes = geometry.node_positions
    return Fields(
        displacement(geometry.point_positions) if geometry.has_points.any() else None,
        displacement(nodes) if len(nodes) else None,
    )


def run_deck(name, out, *overrides):
    """Run a deck of ``jobs/`` on this rank alone, without pictures and fields, and return its summary."""
    path = ROOT / "jobs" / name
    text = path.read_text(encoding="utf-8")
    scene = parse_deck(text, str(path), (*overrides, "output.fields=false", "output.figures=false"))
    # the user's cache knows fits of earlier tests
    with patch("pdfem_mpi.runs.run.fit_folders", lambda out: (out,)):
        code = run(scene, mpi().COMM_SELF, Path(out), text, True, Silence())
    summary = json.loads((Path(out) / "summary.json").read_text(encoding="utf-8"))
    assert code == 0, summary["reason"]
    return summary
