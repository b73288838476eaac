"""`pdfem check` refuses what a run refuses, and says what it understood."""

import numpy as np
import pytest
from PIL import Image

from pdfem_mpi.deck.cracks import DiscCrack, HalfPlaneCrack
from pdfem_mpi.deck.loads import BodyForce, Support, Traction
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.results import sketch
from pdfem_mpi.results.whole_body import NoPicture
from pdfem_mpi.runs.checking import check_scene
from pdfem_mpi.runs.simulation import Simulation
from support.bodies import make_scene
from support.held import beam
from support.helpers import run_pdfem
from support.random_decks import random_scene
from support.tiny import TINY

FAR = 1e6
DECKS, MORE_DECKS = range(2), range(2, 80)
HELD = (Support(face="x-", x=0.0, y=0.0, z=0.0),)
PULL = (BodyForce(kind="body_force", face="x+", total=(1.0, 0.0, 0.0)),)


def without_supports(scene, rng):
    return {"supports": ()}


def load_beside_the_body(scene, rng):
    place = (FAR, FAR, FAR)
    return {"loads": (*scene.loads, BodyForce(kind="body_force", lower=place, upper=place, total=(1.0, 0.0, 0.0)))}


def support_beside_the_body(scene, rng):
    place = (FAR, FAR, FAR)
    return {"supports": (*scene.supports, Support(lower=place, upper=place, x=0.0))}


def traction_on_any_face(scene, rng):
    face = str(rng.choice(["x-", "x+", "y-", "y+", "z-", "z+"]))
    return {"loads": (*scene.loads, Traction(kind="traction", face=face, total=(0.0, 1.0, 0.0)))}


def supports_that_contradict(scene, rng):
    return {"supports": (Support(face="x-", x=0.0), Support(face="x-", x=1.0), *scene.supports)}


def crack_through_the_body(scene, rng):
    """It leaves the pulled half of a body that is long along x loose."""
    if not scene.has_peridynamics or scene.mesh.kind != "box":
        return {}
    low, high = np.array(scene.mesh.lower), np.array(scene.mesh.upper)
    (_, y, z), (_, top, back), x = 2 * low - high, 2 * high - low, 0.5 * (low[0] + high[0]) + 1e-3 * scene.mesh.spacing
    return {"cracks": (Crack(polygon=((x, y, z), (x, top, z), (x, top, back), (x, y, back))),)}


SPOILS = (
    without_supports, load_beside_the_body, support_beside_the_body, traction_on_any_face, supports_that_contradict,
    crack_through_the_body,
)  # fmt: skip


def refusals(make):
    try:
        make()
    except SceneError as error:
        return error.messages
    return []


def assert_check_refuses_what_a_run_refuses(seed, folder):
    scene, rng, refused = random_scene(seed, folder), np.random.default_rng(seed), 0
    for spoil in (None, *SPOILS):
        spoilt = scene.model_copy(update=spoil(scene, rng)) if spoil else scene
        comm = mpi().COMM_SELF
        run = refusals(lambda: Simulation(spoilt, comm))  # noqa: B023
        assert refusals(lambda: check_scene(spoilt, comm)) == run, (seed, spoil)  # noqa: B023
        refused += bool(run)
    assert refused


@pytest.mark.parametrize("seed", DECKS)
def test_check_refuses_what_a_run_refuses(seed, tmp_path):
    assert_check_refuses_what_a_run_refuses(seed, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("seed", MORE_DECKS)
def test_check_refuses_what_a_run_refuses_of_many_decks(seed, tmp_path):
    assert_check_refuses_what_a_run_refuses(seed, tmp_path)


def test_what_was_understood_is_told():
    crack = Crack(polygon=((5.0, -1.0, -1.0), (5.0, 1.01, -1.0), (5.0, 1.01, 3.0), (5.0, -1.0, 3.0)))
    scene = make_scene((8, 2, 2), 4, supports=HELD, loads=PULL, cracks=(crack,), solver="cg")
    scene = scene.model_copy(update={"material": Material(youngs_modulus=1000.0, critical_stretch=0.01)})
    rows = check_scene(scene, mpi().COMM_SELF, 4)
    assert rows["region elements"] == "finite elements, 16 cells, 32 points; x 0 to 4, y 0 to 2, z 0 to 2"
    assert rows["loads.0"] == "body force of (1, 0, 0) in all on 4 cells; x 7 to 8, y 0 to 2, z 0 to 2"
    assert rows["supports.0"].startswith("x = 0 at 9 points and nodes, y = 0 at 9 points and nodes")
    assert rows["cracks.0"].endswith("bonds; x 5, y -1 to 1.01, z -1 to 3")
    assert rows["free motions"] == "none: supports hold the body"
    assert "critical stretch 0.01, strength E s_0 = 10" in rows["failure"]
    assert rows["cells and points of a rank, about"] == "8 and 40 on each of 4"
    assert rows["time, about"].startswith("20 evaluations for the first equilibrium")
    # sum of nodes and points by hand: 12 + 4 bytes of a point, 12 of a node; every node and cell of the body
    points, nodes = 8 * (16 + 4), 5 * 9
    assert rows["disk, about"].startswith(f"{(12 * points + 12 * nodes + 12 * 81 + 4 * 32) / 1e3:.0f} kB a frame")


def test_cracks_of_every_shape_are_told():
    """Half-planes end where the body does."""
    cracks = (
        DiscCrack(kind="disc", centre=(6.0, 1.0, 1.0), normal=(1.0, 0.0, 0.0), radius=0.5),
        HalfPlaneCrack(kind="half_plane", point=(6.0, 0.9, 0.0), normal=(1.0, 0.0, 0.0), direction=(0.0, -1.0, 0.0)),
    )
    rows = check_scene(make_scene((8, 2, 2), supports=HELD, loads=PULL, cracks=cracks), mpi().COMM_SELF)
    assert rows["cracks.0"].endswith("bonds; x 6, y 0.499981 to 1.50002, z 0.499981 to 1.50002")
    assert rows["cracks.1"].endswith("bonds; x 6, y 0 to 0.9, z 0 to 2")


def test_what_was_understood_is_drawn(tmp_path):
    """Regions, supports, springs, ties, loads; with -n the ranks beside them."""
    pytest.importorskip("pyvista")
    for ranks, width in ((None, 1200), (3, 2400)):
        rows = check_scene(beam(), mpi().COMM_SELF, ranks, tmp_path / "check.png")
        assert rows["picture"] == str(tmp_path / "check.png")
        with Image.open(tmp_path / "check.png") as picture:
            assert picture.size == (width, 900)
            colours = {colour for _, colour in picture.convert("RGB").getcolors(1 << 20)}
        assert len(colours) > 50


def test_why_nothing_is_drawn_is_told(tmp_path, monkeypatch):
    def missing():
        raise NoPicture("pictures in three dimensions need pyvista")

    monkeypatch.setattr(sketch, "load_pyvista", missing)
    rows = check_scene(beam(), mpi().COMM_SELF, None, tmp_path / "check.png")
    assert rows["picture"] == "not drawn: pictures in three dimensions need pyvista"
    assert not list(tmp_path.iterdir())


def test_springs_and_ties_are_told():
    rows = check_scene(beam(), mpi().COMM_SELF)
    # on bonds a row of points beside the line: two of each of two cells
    assert rows["springs.0"].startswith("stiffness (0, 500, 0) in all at 4 points and nodes; x ")
    assert rows["springs.1"].startswith("stiffness (3, 0, 0) in all at 32 points and nodes; x ")
    assert rows["ties.0"].startswith("one displacement along y at 24 points and nodes; x 5.2")
    assert rows["free motions"] == "none: supports hold the body"


def test_free_motions_are_named():
    loads = tuple(
        BodyForce(kind="body_force", face=face, total=(total, 0.0, 0.0)) for face, total in (("x-", -1.0), ("x+", 1.0))
    )
    rows = check_scene(make_scene((4, 2, 2), loads=loads, stepping=Steps(load_factors=(0.5, 1.0))), mpi().COMM_SELF)
    assert rows["free motions"].startswith("6, translation along x, y, z and rotation about x, y, z: no support")
    assert rows["time, about"].startswith("64 evaluations")  # relaxation, 8 a cell of length, two steps


@pytest.mark.parametrize(
    ("old", "new", "arguments", "words"),
    [
        ("spacing", "spacin", (), "Did you mean spacing?"),
        ('face = "x+"', "lower = [9.0, 9.0, 9.0]\nupper = [9.0, 9.0, 9.0]", (), "loads.0 selects no cell"),
        ("[[supports]]", "[[probes]]", (), "probes.0 has no kind"),
        ("total", "total", ("-n", "64"), "64 ranks cannot share 16 cells. Use at most 16 ranks"),
    ],
)
def test_bad_input_is_a_sentence(tmp_path, old, new, arguments, words):
    folder = tmp_path / "a folder"
    folder.mkdir()
    (folder / "a deck.toml").write_text(TINY.replace(old, new, 1))
    result = run_pdfem("check", folder / "a deck.toml", *arguments, cwd=tmp_path)
    assert result.returncode == 64 and words in result.stderr and "Traceback" not in result.stderr, result.stderr
