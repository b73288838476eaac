"""A small notched plate in which a run finds by itself where bonds are needed."""

from __future__ import annotations

from pdfem_mpi.deck.adaptive import Adaptive
from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.peridynamics import Peridynamics
from pdfem_mpi.deck.programs import Events, Solver
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.removals import RemovedBox
from pdfem_mpi.deck.scene import Scene
from support.bodies import YOUNGS_MODULUS

CELLS = (18.0, 12.0, 1.0)
NOTCH = RemovedBox(kind="box", lower=(8.0, 0.0, 0.0), upper=(10.0, 4.0, 1.0))
AUTO = (Region(name="body", model="auto"),)
#: The same with bonds drawn by hand, in all cells but those near the supports.
DRAWN = (
    Region(name="left", model="finite_elements", upper=(3.0, 12.0, 1.0)),
    Region(name="bonds", model="peridynamics", lower=(3.0, 0.0, 0.0), upper=(15.0, 12.0, 1.0)),
    Region(name="right", model="finite_elements", lower=(15.0, 0.0, 0.0)),
)
FAST = {"eta": 2e-2, "inner_iterations": 6, "arrest_tolerance": 1e-4, "report_every": 3, "end_reaction": 0.3}


def plate(regions=AUTO, stepping=None, adaptive=None, remove=(NOTCH,), symmetry=(), **tables):
    """A plate with a notch from its lower edge, pulled along x at held ends; ``adaptive`` are keys of that table."""
    settings = {"growth": 2.5, "buffer_layers": 1, "widening_check": False} | (adaptive or {})
    held = {"layers": 1, "y": 0.0, "z": None if symmetry else 0.0}
    auto = any(region.model == "auto" for region in regions)
    return Scene(
        mesh=BoxMesh(lower=(0.0, 0.0, 0.0), upper=CELLS, spacing=1.0, remove=remove, symmetry=symmetry),
        material=Material(youngs_modulus=YOUNGS_MODULUS, critical_stretch=0.002),
        regions=regions,
        peridynamics=Peridynamics(kinematics="linear", surface_correction="virial"),
        supports=(Support(face="x-", x=-0.02, **held), Support(face="x+", x=0.02, **held)),
        solver=Solver(kind="cg", tolerance=1e-8),
        stepping=Events(kind="events", **FAST) if stepping is None else stepping,
        output=Output(figures=False, damage=True),
        **({"adaptive": Adaptive(**settings)} if auto else {}),
        **tables,
    )


def rows_of(simulation):
    """All rows of a simulation without their wall times. Collective."""
    return [{name: value for name, value in row.items() if name != "wall_seconds"} for row in simulation.steps()]
