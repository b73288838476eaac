"""Parts of the body: who hangs together, what holds each part, and mechanisms by name."""

import json

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from pdfem_mpi.deck.loads import BodyForce, Support
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.mesh.generators import box
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.model import parts as components
from pdfem_mpi.model.loads import remove_rigid_motion
from pdfem_mpi.model.mechanisms import describe_motion
from pdfem_mpi.model.motions import left_free
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.peridynamics.clusters import point_rows
from pdfem_mpi.runs.run import run
from pdfem_mpi.solvers.convergence import NotConverged
from pdfem_mpi.stepping import make_solver
from support.bodies import build, make_scene
from support.mesh_files import write_mesh
from support.reporters import Listener

ROUND_OFF = 1e-12  # relative, of sums of some thousand terms rounded to 2**-40 of the largest

HOLD = Support(face="x-", x=0.0, y=0.0, z=0.0)


def cut_at(x, n=12):
    """A crack through the whole section at ``x``."""
    return Crack(polygon=((x, -1.0, -1.0), (x, n, -1.0), (x, n, n), (x, -1.0, n)))


def two_blocks(n_elements=0, **options):
    """A bar of 12 x 3 x 2 cells in two pieces, 8 and 4 cells long."""
    return build(make_scene((12, 3, 2), n_elements, cracks=(cut_at(8.0),), **options))


@pytest.fixture
def hinged_scene(tmp_path):
    """What makes scenes of two blocks of elements, 4 x 2 x 2 cells each, that share an edge along z at (4, 2)."""
    whole = box((0.0, 0.0, 0.0), (8.0, 4.0, 2.0), (8, 4, 2))
    x = whole.centroids
    used, number = np.unique(whole.cells[(x[:, 0] < 4.0) == (x[:, 1] < 2.0)], return_inverse=True)
    write_mesh(tmp_path / "hinge.exo", HexMesh(whole.nodes[used], number.reshape(-1, 8).astype(np.int32)))
    mesh = FileMesh(kind="file", path=str(tmp_path / "hinge.exo"))
    return lambda **options: make_scene((8, 4, 2), 8, mesh=mesh, supports=(HOLD,), **options)


def pushed(x, y, z):
    """A load on the far end."""
    return (BodyForce(kind="body_force", face="x+", total=(x, y, z)),)


def equilibrium(body):
    solve = make_solver(body.scene, body.share, body.forces, body.case, lambda text: None)
    body.state.u[body.case.fixed] = body.case.prescribed[body.case.fixed]
    return solve(body.state, body.case.external)


# --- who hangs together --------------------------------------------------------------------------------------


@pytest.mark.nojit
@pytest.mark.parametrize("options", [{}, {"coupling": "paper_a"}], ids=["B", "A"])
@pytest.mark.parametrize("n_elements", [0, 2, 3])
def test_a_whole_body_is_one_part(n_elements, options):
    parts = build(make_scene((3, 1, 1), n_elements, **options)).case.parts
    assert parts.count == 1
    assert not parts.of.any()


def test_a_cut_at_the_interface_parts_the_elements_from_the_points():
    """Points of the overlap move with their nodes and keep bonds among themselves."""
    body = build(make_scene((8, 3, 2), 4, cracks=(cut_at(4.0),), loads=()))
    assert body.case.parts.count == 2


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_parts_are_the_components_of_the_graph_of_bonds(seed):
    """Random bonds left of a body, against scipy's components of the same graph; the order is that of smallest ids."""
    body = build(make_scene((4, 3, 2), loads=()))
    rng, edges = np.random.default_rng(seed), []
    for rows in body.model.bonds.rows:
        rows.data[rng.random(len(rows.data)) < 0.997] = 0.0
        row, lane = np.nonzero(rows.data.reshape(-1, 4))
        first = np.searchsorted(rows.start, row, side="right") - 1
        edges.append(np.column_stack([first, rows.offset[row].astype(int) // 9 + lane]))
    i, j = np.concatenate(edges).T
    n = 8 * 24
    count, labels = connected_components(sparse.coo_array((np.ones(len(i)), (i, j)), shape=(n, n)), directed=False)
    assert 10 < count < n
    ids = (8 * body.model.points.cell_number[:, None] + np.arange(8)).reshape(-1)
    smallest = np.array([ids[labels == label].min() for label in labels])
    parts = components.find_parts(body.model)
    assert parts.count == count
    np.testing.assert_array_equal(parts.of, np.searchsorted(np.unique(smallest), smallest))


# --- what holds each part ------------------------------------------------------------------------------------


def test_a_loose_part_under_load_is_refused_by_name():
    with pytest.raises(SceneError) as caught:
        two_blocks(loads=pushed(1.0, 0.0, 0.0), supports=(HOLD,))
    (sentence,) = caught.value.messages
    assert "192 points from (8.21132, 0.211325, 0.211325) to (11.7887, 2.78868, 1.78868)" in sentence
    assert "a force of (1, 0, 0)" in sentence
    assert "no support holds the translation along x" in sentence


def test_a_moment_on_a_loose_part_is_a_rotation():
    """Opposite forces with a lever arm on the loose piece: in balance as forces, not as moments."""
    box = {"lower": (10.0, 0.0, 0.0), "upper": (12.0, 3.0, 1.0)}, {"lower": (10.0, 0.0, 1.0), "upper": (12.0, 3.0, 2.0)}
    loads = tuple(
        BodyForce(kind="body_force", total=(0.0, sign, 0.0), **where) for sign, where in zip((1, -1), box, strict=True)
    )
    with pytest.raises(SceneError, match=r"a force of \(0, 0, 0\).*no support holds the rotation about x"):
        two_blocks(loads=loads, supports=(HOLD,))


@pytest.mark.parametrize(
    ("supports", "motions"),
    [
        ((HOLD,), "it"),
        (
            (HOLD, Support(face="x+", x=0.0)),
            "the translation along y, the translation along z and the rotation about x",
        ),
        ((HOLD, Support(face="x+", x=0.0), Support(face="y+", y=0.0)), None),
    ],
)
def test_motions_of_a_part_that_supports_leave_free(supports, motions):
    """The far piece: not held, held at its end face along x, held at a side too, which leaves the near piece's hold."""
    case = two_blocks(loads=(), supports=supports).case
    if motions is None:
        assert [part.names() for part in case.unsupported] == ["the translation along z"]
    else:
        assert [part.names() for part in case.unsupported] == [motions]


def test_pieces_in_balance_are_solved_and_settle():
    """Each piece squeezed across: each is in equilibrium by itself, moves with no mean, and like the bar in one."""
    loads = tuple(
        BodyForce(kind="body_force", face=face, total=(0.0, sign, 0.0)) for face, sign in (("y+", 1.0), ("y-", -1.0))
    )
    body = two_blocks(loads=loads, solver="cg")
    assert len(body.case.unsupported) == 2
    lines = components.describe_unsupported(body.case.parts, body.case.unsupported)
    assert lines[0].startswith("the body is in 2 parts")
    assert equilibrium(body).residual <= 1e-6
    remove_rigid_motion(body.model, body.case, body.state.u)
    u, volume = point_rows(body.state.u), point_rows(body.case.volume)
    x = point_rows(body.model.points.x)
    for part in range(2):
        inside = body.case.parts.of == part
        weight, y = volume[inside], x[inside] - x[inside].mean(axis=0)
        mean = (weight * u[inside]).sum(axis=0), (weight * np.cross(y, u[inside])).sum(axis=0)
        assert np.abs(mean).max() <= ROUND_OFF * (np.abs(weight * u[inside]).sum() * np.abs(y).max())


def test_settling_takes_out_motions_and_leaves_strains():
    """Two pieces moved rigidly, each in its own way: what is left is what was there."""
    body = two_blocks(4, loads=())
    strain = body.of_positions(lambda x: 1e-3 * x * np.array([1.0, -0.25, -0.25]))
    remove_rigid_motion(body.model, body.case, strain)
    moved = strain.copy()

    def rigid(shift, spin):
        return body.of_positions(lambda x: shift + np.cross(spin, x))

    n = 3 * body.model.unknowns.n_points
    of_points = np.repeat((body.case.parts.of[: n // 3] == 1).reshape(-1, 1, 4), 3, axis=1).reshape(-1)
    of_far = np.concatenate([of_points, np.repeat(body.case.parts.of[n // 3 :] == 1, 3)])
    moved += np.where(of_far, rigid([0.2, -0.1, 0.3], [0.1, 0.0, -0.2]), rigid([-0.3, 0.0, 0.1], [0.0, 0.2, 0.1]))
    remove_rigid_motion(body.model, body.case, moved)
    np.testing.assert_allclose(moved, strain, rtol=0, atol=ROUND_OFF * 10)


def test_points_and_lines_have_no_rotation_about_themselves():
    """A single point has three motions, a straight row of points five, everything else six."""
    point, line, box = np.zeros((3, 3)), np.diag([0.0, 2.0, 2.0]), np.diag([1.0, 2.0, 3.0])
    assert [len(left_free(inertia, np.zeros(21))) for inertia in (point, line, box)] == [3, 5, 6]


# --- mechanisms ----------------------------------------------------------------------------------------------


def test_a_hinge_is_named_with_its_part_and_axis(hinged_scene):
    """Rotation about the common edge meets no stiffness: the far block and its rotation are named."""
    body = build(hinged_scene(loads=pushed(0.0, 1.0, 0.0), solver="cg"))
    assert body.case.parts.count == 1
    with pytest.raises(NotConverged) as caught:
        equilibrium(body)
    expected = "from (4, 2, 0) to (8, 4, 2) move, mostly by the rotation about z, with hardly any resistance"
    assert expected in str(caught.value)


def test_a_hinge_that_nothing_turns_is_no_obstacle(hinged_scene):
    """Loads along the hinge do no work on it."""
    assert equilibrium(build(hinged_scene(loads=pushed(0.0, 0.0, 1.0), solver="cg"))).residual <= 1e-6


def test_relaxation_says_what_still_moves(hinged_scene):
    body = build(hinged_scene(loads=pushed(0.0, 1.0, 0.0), solver="adr", max_evaluations=2000))
    with pytest.raises(NotConverged, match=r"Still moving: .* to \(8, 4, 2\) move, mostly by the rotation about z"):
        equilibrium(body)


def ran(scene, out):
    """Exit code, lines and summary of a run."""
    listener = Listener()
    code = run(scene.model_copy(update={"output": Output(fields=False)}), mpi().COMM_SELF, out, "", True, listener)
    return code, "\n".join(listener.lines), json.loads((out / "summary.json").read_text(encoding="utf-8"))


def test_a_run_tells_of_loose_parts(tmp_path):
    """Before it solves, and in the summary."""
    scene = make_scene((12, 3, 2), cracks=(cut_at(8.0),), loads=(), supports=(HOLD,), solver="cg")
    code, lines, summary = ran(scene, tmp_path)
    assert code == 0
    assert "the body is in 2 parts that hang together, 1 of them held by supports\n  192 points from" in lines
    assert summary["parts_at_start"] == {"count": 2, "not_held": 1}


def test_a_run_with_a_mechanism_ends_with_its_name_and_74(hinged_scene, tmp_path):
    code, lines, summary = ran(hinged_scene(loads=pushed(0.0, 1.0, 0.0), solver="cg"), tmp_path / "run")
    assert code == summary["exit_code"] == 74
    assert "mostly by the rotation about z, with hardly any resistance" in summary["reason"]
    assert summary["reason"].rstrip(".") in lines


@pytest.mark.parametrize("mode", range(6))
def test_motions_are_described_by_region_and_kind(mode):
    """Part of a body moves by one rigid mode about its own middle."""
    body = build(make_scene((8, 2, 2), 8, loads=()))
    names = [f"the {kind} {axis}" for kind in ("translation along", "rotation about") for axis in "xyz"]

    def motion(x):
        far = x[:, 0] > 0.5
        y = x - x[far].mean(axis=0)
        turned = np.cross(np.eye(3)[mode % 3], y) if mode > 2 else np.tile(np.eye(3)[mode], (len(x), 1))
        return np.where(far[:, None], turned, 0.0)

    text = describe_motion(body.model, body.of_positions(motion))
    assert text.endswith(f"move, mostly by {names[mode]}")
    if mode < 3:
        assert text.startswith("36 nodes from (5, 0, 0) to (8, 2, 2)")
