"""Mirror planes in decks: what is refused and how it is said, what is told, and what memory is asked for."""

import numpy as np
import pytest

from pdfem_mpi.body import partitioning as partitioning_module
from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.body.meshing import make_mesh
from pdfem_mpi.body.partitioning import partition
from pdfem_mpi.deck.loads import Support, Traction
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.table import DeckError, SceneError
from pdfem_mpi.deck.toml import parse_deck
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.model.loads import make_load_case
from pdfem_mpi.model.model import build_model
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.runs import memory_estimate as memory
from pdfem_mpi.runs.checking import check_scene
from support.bodies import build, local_share, make_scene
from support.mesh_files import write_mesh

SAMPLING = 0.1  # a sample of 128 cells stands for a thousand
EXACT_SAMPLE = 0.03  # bonds of points to their own images are counted as two halves, not as one: here 2 %

DECK = """
[mesh]
lower = [0.0, 0.0, 0.0]
upper = [4.0, 2.0, 2.0]
spacing = 1.0
symmetry = ["x-", "y-"]

[material]
youngs_modulus = 1.0e3

[[regions]]
name = "all"
model = "finite_elements"

[[loads]]
kind = "traction"
face = "x+"
traction = [1.0, 0.0, 0.0]

[[probes]]
kind = "bar"
axis = "x"
stress = 1.0
"""


def problems(*overrides):
    """What a deck is refused with."""
    with pytest.raises(DeckError) as caught:
        parse_deck(DECK, "deck.toml", overrides)
    return "\n".join(caught.value.messages)


def test_the_deck_is_sound():
    assert parse_deck(DECK, "deck.toml", ()).mesh.symmetry == ("x-", "y-")


def test_all_problems_with_mirror_planes_are_told_at_once():
    told = problems('mesh.symmetry=["x+", "x+"]', "supports=[{face = 'x+', x = 0.5}]")
    assert 'mesh.symmetry = ["x+", "x+"] names x+ twice. Name each face once.' in told
    told = problems('mesh.symmetry=["x+"]', "supports=[{face = 'x+', x = 0.5}, {face = 'x+', x = 0.0, y = 0.1}]")
    assert 'loads.0.face = "x+" is a mirror plane (mesh.symmetry = ["x+"])' in told
    assert 'supports.0.x = 0.5 moves the mirror plane "x+"' in told and "supports.1" not in told
    assert 'probes.0.axis = "x" ends at a mirror plane: the probe compares the upper end of the bar' in told
    assert "Model the other half" in told


def test_faces_are_named_as_elsewhere():
    assert 'Use one of "x-", "x+"' in problems('mesh.symmetry=["left"]')
    assert "bar between two mirrors has no end" in problems('mesh.symmetry=["x-", "x+"]')


def test_a_plate_has_its_hole_at_the_mirror_planes():
    """The quarter's hole must fit into the whole plate, and cannot be on two planes across one axis."""
    plate = ('mesh.kind="plate_with_hole"', "mesh.spacing=0.5", "mesh.hole_radius=1.0")
    assert parse_deck(DECK, "deck.toml", plate).mesh.whole_plate == ((-4.0, -2.0, 0.0), (4.0, 2.0, 2.0))
    assert "does not fit: it leaves 0.5 between the hole" in problems(*plate[:2], "mesh.hole_radius=1.5")
    assert "does not fit" in problems(*plate, 'mesh.symmetry=["x-"]')
    told = problems(*plate, 'mesh.symmetry=["x-", "x+", "y-"]')
    assert 'has both faces of x, and the hole lies on a mirror plane. Keep "x-" or "x+"' in told


def test_supports_that_move_nodes_out_of_a_plane_are_refused():
    """Found on the mesh: a box of nodes at a plane, pulled normal to it."""
    scene = make_scene(
        (4, 2, 2), 4, symmetry=("y-",), supports=(Support(lower=(0.0, 0.0, 0.0), upper=(1.0, 1.0, 1.0), y=0.1),)
    )
    share = local_share(scene)
    model = build_model(scene, share, mpi().COMM_SELF)
    with pytest.raises(SceneError, match=r"supports.0.y = 0.1 moves 4 nodes out of a mirror plane"):
        make_load_case(scene, share, model)


def test_a_support_may_repeat_what_a_plane_says():
    free = build(make_scene((4, 2, 2), 4, symmetry=("x-",), loads=())).case
    held = build(make_scene((4, 2, 2), 4, symmetry=("x-",), loads=(), supports=(Support(face="x-", x=0.0),))).case
    assert (free.fixed == held.fixed).all() and free.fixed.sum() == 9


def test_unbalanced_loads_are_told_where_no_plane_holds_them():
    """A half pulled along its plane flies away; pulled out of its plane it does not."""
    along = make_scene((4, 2, 2), 0, symmetry=("y-",))
    with pytest.raises(SceneError, match="no support holds the"):
        build(along.model_copy(update={"loads": along.loads[1:]}))
    across = make_scene((4, 2, 2), 0, symmetry=("x-",))
    assert len(build(across.model_copy(update={"loads": across.loads[1:]})).case.free_motions) == 3


def test_a_region_on_the_other_side_of_a_plane_is_empty():
    scene = make_scene((4, 2, 2), 0, symmetry=("x-",))
    other = Region(name="other", model="peridynamics", upper=(0.0, 2.0, 2.0))
    with pytest.raises(SceneError, match=r"regions.other contains no cell"):
        discretize(scene.model_copy(update={"regions": (*scene.regions, other)}))


def file_scene(tmp_path, mesh, faces, **more):
    """A scene of finite elements on a mesh that is written to a file; its x- and x+ ends are sets of faces."""
    ends = {name: mesh.faces_on_face(face)[1] for name, face in (("left", "x-"), ("right", "x+"))}
    write_mesh(tmp_path / "part.msh", mesh, {"body": np.arange(len(mesh.cells))}, ends)
    entry = FileMesh(path=str(tmp_path / "part.msh"), symmetry=faces)
    regions = (Region(name="all", model="finite_elements"),)
    return make_scene((1, 1, 1), regions=regions, mesh=entry, **more)


def pull(name):
    return Traction(kind="traction", set=name, traction=(1.0, 0.0, 0.0))


def test_a_mesh_file_can_be_a_part(tmp_path):
    """The rollers and external forces of the same cells from a generator."""
    scene = make_scene((4, 2, 2), 4, symmetry=("x-", "z-"), loads=())
    box, loads = make_mesh(scene), (pull("right"),)
    other = build(file_scene(tmp_path, box, ("x-", "z-"), loads=loads)).case
    pulled = Traction(kind="traction", face="x+", traction=(1.0, 0.0, 0.0))
    case = build(scene.model_copy(update={"loads": (pulled,)})).case
    assert case.fixed.sum() == other.fixed.sum() == 9 + 15
    assert np.sort(case.external).tolist() == pytest.approx(np.sort(other.external).tolist())


def test_the_end_of_a_slab_between_two_mirrors_can_be_pulled():
    """All nodes of its faces lie on one plane or the other; the faces do not."""
    scene = make_scene((4, 2, 1), 4, symmetry=("z-", "z+"))
    assert np.abs(build(scene).case.external).sum() == pytest.approx(2.0 / 1000.0)


def test_mesh_files_that_do_not_end_in_a_plane_are_refused(tmp_path):
    """Cells turned by 45 degrees about z touch x- with an edge; nodes a little off z-; both are told at once."""
    mesh = make_mesh(make_scene((2, 2, 2), 2))
    x, y, z = mesh.nodes.T
    turned = np.column_stack([x - y, x + y, z])
    turned[np.flatnonzero(z == 0.0)[2:5], 2] += 1e-4
    with pytest.raises(SceneError) as caught:
        discretize(file_scene(tmp_path, HexMesh(turned, mesh.cells), ("x-", "z-"), loads=()))
    edge, nearly = caught.value.messages
    assert edge.startswith("mesh.symmetry: no face of a cell lies on the mirror plane x- at x = -2.")
    assert nearly.startswith("mesh.symmetry: 3 nodes lie nearly on the mirror plane z- at z = 0, the first at (")


def test_a_set_on_a_mirror_plane_is_not_pulled(tmp_path):
    mesh = make_mesh(make_scene((2, 2, 2), 2))
    with pytest.raises(SceneError, match=r"loads.0.set = left has 4 of 4 faces on a mirror plane"):
        build(file_scene(tmp_path, mesh, ("x-",), loads=(pull("left"), pull("right"))))


def test_memory_counts_images_of_the_own_cell():
    """Sixteen cells, all in the sample, of a slab thinner than the cutoff radius: a seventh of the bonds are such."""
    scene = make_scene((8, 2, 1), 0, symmetry=("z-", "z+"), loads=())
    share = local_share(scene)
    model = build_model(scene, share, mpi().COMM_SELF)
    _, bonds = memory._count_bonds(share, np.arange(16))
    assert bonds == pytest.approx(model.bonds.count, rel=EXACT_SAMPLE)


@pytest.mark.parametrize("faces", [("y-",), ("x-", "y-", "z-"), ("z-", "z+")], ids="".join)
def test_memory_counts_images(faces):
    """Rows and bonds from the sample, images included; without them a thin body would be taken for a small one."""
    scene = make_scene((24, 10, 2), 0, symmetry=faces, loads=())
    share = local_share(scene)
    model = build_model(scene, share, mpi().COMM_SELF)
    rows, bonds = memory._count_bonds(share, share.subdomain.free)
    assert bonds == pytest.approx(model.bonds.count, rel=SAMPLING)
    assert rows == pytest.approx(sum(len(r.offset) - 1 for r in model.bonds.rows), rel=SAMPLING)
    alone = make_scene((24, 10, 2), 0, loads=())
    need = [memory.estimate(s, local_share(s)).bytes for s in (scene, alone)]
    assert need[0] > 1.05 * need[1]


def test_cells_at_a_plane_weigh_their_images(monkeypatch):
    """For the partition a cell at a mirror plane costs what one inside costs."""
    weights = []
    monkeypatch.setattr(partitioning_module, "bisect", lambda x, weight, n: weights.append(weight))
    for faces in ((), ("y-",)):
        partition(discretize(make_scene((1, 9, 1), 0, symmetry=faces, loads=())), 2)
    whole, half = weights
    assert (half[:5] == whole[4]).all() and (half[5:] == whole[5:]).all() and whole[0] < whole[4]


@pytest.mark.parametrize(
    ("faces", "words"),
    [
        (("y-",), "y-: half of the body is modelled"),
        (("x-", "y+", "z-"), "x-, y+, z-: an eighth of the body is modelled"),
        (("z-", "z+"), "z-, z+: a cell of a body without end along z"),
    ],
)
def test_check_tells_the_part(faces, words):
    scene = make_scene((4, 2, 2), 0, symmetry=faces)
    assert check_scene(scene, mpi().COMM_SELF)["mirror planes"] == words
    assert "mirror planes" not in check_scene(make_scene((4, 2, 2), 0), mpi().COMM_SELF)


ACROSS = Crack(polygon=((2.87, -9.0, -9.0), (2.87, 9.0, -9.0), (2.87, 9.0, 9.0), (2.87, -9.0, 9.0)))


@pytest.mark.parametrize(
    ("faces", "free"),
    [
        (("x-",), [3, 6]),  # at the plane; on its own, as its image is
        (("y-",), [3, 3]),
        (("x-", "y-", "z-"), [0, 1]),
        (("z-", "z+"), [3, 3]),
    ],
    ids=str,
)
def test_parts_that_a_crack_leaves_are_held_by_the_planes_they_reach(faces, free):
    """A part that hangs together with its own image across a plane moves only within it."""
    case = build(make_scene((6, 2, 2), 0, symmetry=faces, loads=(), cracks=(ACROSS,))).case
    assert case.parts.count == 2
    motions = {part.part: len(part.motions) for part in case.unsupported}
    assert [motions.get(part, 0) for part in range(2)] == free
