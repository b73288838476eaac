"""Small bodies that fail, and what follows a load program to its end."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice

import numpy as np

from pdfem_mpi.deck.loads import BodyForce, Support
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.deck.opening_probe import OpeningProbe
from pdfem_mpi.deck.peridynamics import Crack, Peridynamics
from pdfem_mpi.deck.programs import Events, Solver
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.model.breaking import make_failure
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.stepping import Report, follow_load_program, make_solver
from support.bodies import YOUNGS_MODULUS, Body, build

STRETCH = 0.002
CELLS = (8, 6, 1)
#: A crack through the middle third, and one from the lower edge; their edges lie beside the lattice's planes.
CENTRE, EDGE = (1.9, 4.1), (-1.0, 2.1)
PULLED = (Support(face="x-", x=-0.01), Support(face="x+", x=0.01))
DEAD = tuple(
    BodyForce(kind="body_force", face=face, total=(total, 0.0, 0.0)) for face, total in (("x-", -1.0), ("x+", 1.0))
)


#: A chip on the upper edge between two cracks, on a neck of .8 cells, and a load that tears it off.
CHIP = (BodyForce(kind="body_force", lower=(3.0, 5.0, 0.0), upper=(5.0, 6.0, 1.0), total=(0.0, 30.0, 0.0)),)
#: Self-weight of a strip that is held at one end and guided at the other.
WEIGHT = BodyForce(kind="body_force", lower=(0.0, 0.0, 0.0), density=(0.0, -0.04, 0.0), constant=True)
GRIPS = (Support(face="x-", x=0.0, y=0.0, z=0.0), Support(face="x+", x=0.02, y=0.0))
GUIDED = tuple(Support(face=face, x=x, y=0.0, z=0.0) for face, x in (("x-", -0.01), ("x+", 0.01)))


def chipped(loads=CHIP, **options):
    """A strip, pulled along x at held ends, with a chip on its upper edge that a load of its own pulls along y."""
    upright = [((x, 4.97), (x, 7.0)) for x in (2.99, 5.01)]
    level = [((2.9, 4.97), (3.6, 4.97)), ((4.4, 4.97), (5.1, 4.97))]
    cracks = tuple(Crack(polygon=((*a, -1.0), (*b, -1.0), (*b, 2.0), (*a, 2.0))) for a, b in (*upright, *level))
    scene = strip(crack=None, loads=loads, supports=GUIDED, **options)
    return scene.model_copy(update={"cracks": cracks})


def strip(
    *,
    crack=CENTRE,
    kinematics="linear",
    supports=PULLED,
    loads=(),
    elements=0,
    tolerance=1e-9,
    solver="cg",
    stepping=None,
    noise=0.0,
    seed=0,
    cells=CELLS,
    band=1.0,
    poissons_ratio=0.25,
    **options,
):
    """A strip of unit cells, pulled along x, with a crack at its middle; its ends may not fail.

    Parameters
    ----------
    crack : two floats or None
        Range along y.
    elements : int
        Layers of finite elements at each end.
    band : float
        Width of what may not fail beside them, or at the ends.
    stepping
        `Events` by default; ``options`` are theirs.
    """
    nx, ny, nz = (float(n) for n in cells)
    middle, held = nx / 2.0, elements + band
    regions = [
        Region(name="left", model="peridynamics", lower=(elements, 0, 0), upper=(held, ny, nz), may_fail=False),
        Region(name="middle", model="peridynamics", lower=(held, 0, 0), upper=(nx - held, ny, nz)),
        Region(
            name="right", model="peridynamics", lower=(nx - held, 0, 0), upper=(nx - elements, ny, nz), may_fail=False
        ),
    ]
    if elements:
        regions += [
            Region(name="first", model="finite_elements", upper=(elements, ny, nz)),
            Region(name="last", model="finite_elements", lower=(nx - elements, 0, 0)),
        ]
    corners = () if crack is None else ((crack[0], -1.0), (crack[1], -1.0), (crack[1], nz + 1), (crack[0], nz + 1))
    return Scene(
        mesh=BoxMesh(lower=(0.0, 0.0, 0.0), upper=(nx, ny, nz), spacing=1.0),
        material=Material(youngs_modulus=YOUNGS_MODULUS, poissons_ratio=poissons_ratio, critical_stretch=STRETCH),
        regions=tuple(regions),
        peridynamics=Peridynamics(kinematics=kinematics, stiffness_noise=noise, seed=seed),
        cracks=(Crack(polygon=tuple((middle, y, z) for y, z in corners)),) if corners else (),
        supports=supports,
        loads=loads,
        solver=Solver(kind=solver, tolerance=tolerance),
        stepping=Events(kind="events", **options) if stepping is None else stepping,
    )


def opened(control="opening", loads=(), **options):
    """A strip with a crack from its lower edge whose mouth has a probe; its load follows the opening."""
    scene = strip(crack=EDGE, loads=loads, **options)
    probe = OpeningProbe(kind="opening", name="cmod", one=(3.5, 0.0, 0.5), two=(4.5, 0.0, 0.5))
    name = "cmod" if control == "opening" else None
    events = Events(kind="events", control=control, report_every=1, end_reaction=0.5, opening=name)
    return Scene.model_validate({**dict(scene), "stepping": events, "probes": (probe,)})


@dataclass
class Failing:
    """A body, its failure, its solver, and the rows so far."""

    body: Body
    failure: Failure
    solve: object
    rows: list[Report]

    def follow(self, rows=None):
        """Follow the load program from the state on, for so many rows or to its end; yields them. Collective."""
        program = follow_load_program(self.body.scene, self.solve, self.failure, self.body.state, self.body.case)
        for row in islice(program, rows):
            self.rows.append(row)
            yield row

    def ratio(self):
        """Largest stretch over the critical one at the state. Collective."""
        self.body.internal(self.body.state.u)
        return self.body.forces.largest_ratio(self.failure)

    def middles(self):
        """Midpoints of the bonds broken on this rank, relative to the body's centre, deck units, shape (n, 3)."""
        x = self.body.geometry.point_positions - self.body.share.units.origin
        return x[self.body.geometry.rows_of_points(self.failure.broken_pairs())[0]].mean(axis=1)


def failing(scene, comm=None) -> Failing:
    """Assemble a scene that can fail. Collective."""
    body = build(scene, comm)
    failure = make_failure(scene, body.share, body.model)
    return Failing(body, failure, make_solver(scene, body.share, body.forces, body.case, print), [])


def followed(scene, rows=None, comm=None) -> Failing:
    """Follow a scene for so many rows, or to its end. Collective."""
    run = failing(scene, comm)
    for _ in run.follow(rows):
        pass
    return run


def numbers(row: Report):
    """All of a row but its wall time, as what compares by ``==``."""
    values = {name: value for name, value in vars(row).items() if name != "seconds"}
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values.items()}


def of_bonds(model):
    """What the books of failure need of a model: its communicator, points and bonds."""
    return model.comm, model.points, model.bonds
