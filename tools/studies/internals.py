"""All that studies use of the package's inside, in one place: each name leaves when a public one takes its place."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pdfem_mpi import __version__
from pdfem_mpi.body.areas import find_boundary
from pdfem_mpi.body.share import Share, share_of
from pdfem_mpi.command import study
from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.peridynamics import Peridynamics
from pdfem_mpi.deck.programs import Events, Solver
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.toml import parse_deck, read_deck, write_deck
from pdfem_mpi.kernels import bond_failure as failure_kernels
from pdfem_mpi.kernels.exact_sums import add_products
from pdfem_mpi.kernels.hex8 import GAUSS_POINTS
from pdfem_mpi.measure.bar import measure_bar
from pdfem_mpi.measure.fields import gather_fields
from pdfem_mpi.measure.geometry import gather_geometry
from pdfem_mpi.mesh.generators import box, plate_with_hole
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.model.breaking import make_failure
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.loads import LoadCase, make_load_case
from pdfem_mpi.model.model import Model, build_model
from pdfem_mpi.model.state import State, new_state
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.peridynamics.clusters import point_rows
from pdfem_mpi.peridynamics.critical_stretches import UNBREAKABLE
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.peridynamics.fit import equations, fit
from pdfem_mpi.peridynamics.fit.operator import Operator
from pdfem_mpi.peridynamics.making_bonds import make_bonds
from pdfem_mpi.results.plots import STYLE
from pdfem_mpi.results.study_files import CURVES
from pdfem_mpi.stepping import follow_load_program, ledger, make_solver
from pdfem_mpi.stepping.steps import break_bonds
from pdfem_mpi.system.launcher import mpirun_command, prepare_environment

__all__ = [
    "CURVES",
    "GAUSS_POINTS",
    "STYLE",
    "UNBREAKABLE",
    "Assembled",
    "Events",
    "Failure",
    "FileMesh",
    "HexMesh",
    "Material",
    "Operator",
    "Peridynamics",
    "Region",
    "Scene",
    "Solver",
    "Support",
    "__version__",
    "add_products",
    "assemble",
    "box",
    "break_bonds",
    "equations",
    "failure_kernels",
    "find_boundary",
    "fit",
    "follow_load_program",
    "gather_fields",
    "gather_geometry",
    "ledger",
    "make_bonds",
    "make_failure",
    "make_solver",
    "measure_bar",
    "mpirun_command",
    "parse_deck",
    "plate_with_hole",
    "point_rows",
    "prepare_environment",
    "read_deck",
    "share_of",
    "study",
    "write_deck",
]


@dataclass(frozen=True)
class Assembled:
    """A scene on this rank alone, ready to be solved; model units."""

    scene: Scene
    share: Share
    model: Model
    load: LoadCase
    forces: Forces
    state: State

    def stored(self) -> np.ndarray:
        """Stored numbers of all slots for bonds."""
        return np.concatenate([rows.data for rows in self.model.bonds.rows]).astype(float)


def assemble(scene: Scene, fits: tuple[Path, ...] = ()) -> Assembled:
    """A scene's body, equations, loads and state; fits of bond factors are looked for and kept in some folders."""
    share = share_of(scene, mpi().COMM_SELF)
    model = build_model(scene, share, mpi().COMM_SELF, fits)
    state = new_state(model)
    load = make_load_case(scene, share, model)
    return Assembled(scene, share, model, load, Forces(model, state.bounds), state)
