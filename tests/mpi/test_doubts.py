"""Bands that cannot part, steps of cracks and signs of motions are the same on any number of ranks."""

import pytest

from pdfem_mpi import Simulation, read_deck
from pdfem_mpi.body.cutting import share_of
from pdfem_mpi.body.meshing import make_mesh
from pdfem_mpi.deck.displacements import Rotation
from pdfem_mpi.deck.loads import Support
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.runs.crack_fronts import default_extension, doubtful_extensions
from pdfem_mpi.runs.sealed_regions import describe_sealed_regions
from support.bodies import make_scene
from support.helpers import assert_all

pytestmark = pytest.mark.mpi(min_size=2)

BAR = {
    "mesh": {"lower": [0.0, 0.0, 0.0], "upper": [14.0, 2.0, 2.0], "spacing": 1.0},
    "peridynamics": {"surface_correction": "virial", "kinematics": "linear"},
    "supports": [{"face": "x-", "x": 0.0, "y": 0.0, "z": 0.0}, {"face": "x+", "x": 0.05}],
}


def bands():
    """A bar whose second region is too narrow to part, and whose fourth is not."""
    walls = (0.0, 2.0, 4.0, 6.0, 11.0, 14.0)
    regions = [
        {"name": f"part {k}", "model": "peridynamics", "lower": [walls[k], 0.0, 0.0], "upper": [walls[k + 1], 2.0, 2.0]}
        | ({} if k % 2 else {"may_fail": False})
        for k in range(5)
    ]
    return read_deck(BAR | {"material": {"youngs_modulus": 1e3, "critical_stretch": 0.004}, "regions": regions})


def cracked():
    """A bar with a crack along it, and a probe whose step is too short."""
    corners = [[-1.0, 1.0, -1.0], [5.0, 1.0, -1.0], [5.0, 1.0, 3.0], [-1.0, 1.0, 3.0]]
    probe = {"kind": "energy_release", "name": "tip", "direction": [1.0, 0.0, 0.0], "extension": 0.3}
    tables = {
        "regions": [{"name": "all", "model": "peridynamics"}],
        "cracks": [{"polygon": corners}],
        "probes": [probe],
    }
    return read_deck(BAR | {"material": {"youngs_modulus": 1e3}} | tables)


def test_doubts_are_the_same_on_any_ranks(comm):
    def told(group):
        scene, body = bands(), cracked()
        parts, pieces = (share_of(one, group, make_mesh(one)) for one in (scene, body))
        length = default_extension(body, pieces, body.probes[0])
        return [*describe_sealed_regions(scene, parts), *doubtful_extensions(body, pieces), length]

    expected, found = told(mpi().COMM_SELF), told(comm)
    assert_all(
        comm, [str(text)[:18] for text in expected] == ["warning: regions.1", "warning: probes.0.", "1.0"], expected
    )
    assert_all(comm, found == expected, f"{found} is not {expected}")


def test_turned_bodies_and_cycles_have_the_same_bits(comm):
    turn = Rotation(axis=(1.0, 1.0, 1.0), point=(4.0, 1.5, 0.0), angle=0.01)
    turned = tuple(Support(face=face, rotation=turn) for face in ("x-", "x+"))
    cycled = Support(face="x-", x=0.0, y=0.0, z=0.0), Support(face="x+", x="0.01*sin(2*pi*f)")

    def told(group):
        rows = []
        for supports, factor in ((turned, 1.0), (cycled, 0.75)):
            scene = make_scene((8, 3, 3), 4, correction="virial", loads=(), supports=supports, solver="cg")
            row = Simulation(scene, group).solve(factor)
            rows += [row["displacement"], row["reaction"], row["evaluations"]]
        return rows

    expected, found = told(mpi().COMM_SELF), told(comm)
    assert_all(comm, abs(expected[3] + 0.01) <= 1e-15, f"the cycle goes back: {expected[3]}")
    assert_all(comm, found == expected, f"{found} is not {expected}")
