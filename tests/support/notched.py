"""A plate with a crack on one mirror plane and across another one, whole or in part, pulled apart."""

from itertools import islice

import pytest

from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.deck.peridynamics import Crack, Peridynamics
from pdfem_mpi.deck.programs import Events, Solver
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.model.breaking import make_failure
from pdfem_mpi.stepping import follow_load_program, make_solver
from support.bodies import build

UPPER = (3.0, 3.0, 1.0)
ARREST = 1e-9
ROWS = 30  # of several hundred: later, bonds that are tied up to round-off break one batch sooner or later
#: Its ends are no midpoints of bonds, which round-off would cut on one side only.
CRACK = Crack(polygon=((0.0, -1.13, -9.0), (0.0, 1.13, -9.0), (0.0, 1.13, 9.0), (0.0, -1.13, 9.0)))


def notched(faces, nu=0.25):
    """6 x 6 x 2 cells about the origin, or the part that mirror planes at 0 leave, pulled along x."""
    lower = tuple(0.0 if f"{axis}-" in faces else -high for axis, high in zip("xyz", UPPER, strict=True))
    return Scene(
        mesh=BoxMesh(lower=lower, upper=UPPER, spacing=1.0, symmetry=faces),
        material=Material(youngs_modulus=1000.0, poissons_ratio=nu, critical_stretch=0.01),
        regions=(Region(name="all", model="peridynamics"),),
        peridynamics=Peridynamics(kinematics="linear"),
        cracks=(CRACK,),
        supports=tuple(Support(face=f, x=s) for f, s in (("x+", 0.05), ("x-", -0.05)) if f not in faces),
        solver=Solver(kind="cg", tolerance=1e-9),
        stepping=Events(kind="events", report_every=1, arrest_tolerance=ARREST),
    )


def pull(scene, comm=None, n_rows=ROWS, at_each=None):
    """The body, its books and the first rows of its history; ``at_each(body, failure)`` is called at each row."""
    body = build(scene, comm)
    failure = make_failure(scene, body.share, body.model)
    solver = make_solver(scene, body.share, body.forces, body.case, pytest.fail)
    rows = []
    for row in islice(follow_load_program(scene, solver, failure, body.state, body.case), n_rows):
        rows.append(row)
        if at_each:
            at_each(body, failure)
    return body, failure, rows
