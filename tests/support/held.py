"""One small beam that is held and loaded in every way a deck knows, and breaks."""

from __future__ import annotations

from pdfem_mpi.deck.loads import BodyForce, Force, Pressure, Support, Traction
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.deck.outputs import DisplacementProbe, OpeningProbe
from pdfem_mpi.deck.peridynamics import Peridynamics
from pdfem_mpi.deck.programs import Events, Solver
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.removals import RemovedBox
from pdfem_mpi.deck.restraints import Spring, Tie
from pdfem_mpi.deck.scene import Scene
from support.bodies import YOUNGS_MODULUS

STRETCH = 1e-3


def beam(control="opening", kinematics="linear", stepping=None, solver="cg", tolerance=1e-9, end_opening=None):
    """Half of a notched beam (mirror plane z-) with ends of elements, in three-point bending.

    A roller on a line and a spring on a line carry it, a platen of tied places takes a force on a line; self-weight and
    a pressure stay while it grows, a traction on a box of faces grows with it. Columns of all of them.
    """

    def line(x, y):
        return (x, y, 0.0), (x, y, 2.0)

    mouth = OpeningProbe(kind="opening", name="mouth", one=(6.0, 0.0, 0.5), two=(7.0, 0.0, 0.5))
    events = Events(
        kind="events",
        control=control,
        report_every=1,
        end_reaction=0.5,
        opening="mouth" if control == "opening" else None,
        end_opening=end_opening,
    )
    return Scene(
        mesh=BoxMesh(
            lower=(0.0, 0.0, 0.0),
            upper=(13.0, 4.0, 2.0),
            spacing=1.0,
            symmetry=("z-",),
            remove=(RemovedBox(kind="box", lower=(6.0, 0.0, 0.0), upper=(7.0, 1.0, 2.0)),),
        ),
        material=Material(youngs_modulus=YOUNGS_MODULUS, critical_stretch=STRETCH),
        regions=(
            Region(name="first", model="finite_elements", upper=(2.0, 4.0, 2.0)),
            Region(name="left", model="peridynamics", lower=(2.0, 0.0, 0.0), upper=(4.0, 4.0, 2.0), may_fail=False),
            Region(name="middle", model="peridynamics", lower=(4.0, 0.0, 0.0), upper=(9.0, 4.0, 2.0)),
            Region(name="right", model="peridynamics", lower=(9.0, 0.0, 0.0), may_fail=False),
        ),
        peridynamics=Peridynamics(kinematics=kinematics, surface_correction="none"),
        supports=(Support(name="roller", line=line(1.0, 0.0), x=0.0, y=0.0),),
        springs=(
            Spring(name="spring", line=line(12.0, 0.0), stiffness=(0.0, 500.0, 0.0)),
            Spring(name="bed", face="x+", stiffness=(3.0, 0.0, 0.0)),
        ),
        ties=(Tie(name="platen", lower=(5.0, 3.5, 0.0), upper=(8.0, 4.0, 2.0), of="nodes", along=("y",)),),
        loads=(
            Force(kind="force", name="push", line=line(6.0, 4.0), total=(0.0, -1.0, 0.0)),
            Traction(kind="traction", lower=(2.0, 4.0, 0.0), upper=(4.0, 4.0, 2.0), total=(0.0, -0.1, 0.0)),
            BodyForce(kind="body_force", region="middle", density=(0.0, -1e-3, 0.0), constant=True),
            Pressure(kind="pressure", lower=(0.0, 0.0, 0.0), upper=(0.0, 4.0, 2.0), pressure=5e-3, constant=True),
        ),
        probes=(mouth, DisplacementProbe(kind="displacement", name="tip", point=(6.5, 4.0, 1.0))),
        solver=Solver(kind=solver, tolerance=tolerance),
        stepping=events if stepping is None else stepping,
    )
