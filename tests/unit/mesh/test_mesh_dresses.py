"""One bar in hundreds of dresses: each gives the clean file's displacements, or is refused by file and line."""

import re

import numpy as np
import pytest

from pdfem_mpi.deck.loads import BodyForce, Support, Traction
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.measure.fields import fields_sha256
from pdfem_mpi.stepping import follow_load_program, make_solver
from support.bodies import Silence, build, make_scene
from support.mesh_dresses import CELLS, make_bar, write_dress

# Another order of nodes and cells adds the terms of forces in another order, and the relative residual of 1e-12 leaves
# its own error of the displacements: both of the largest displacement.
REORDERED = 1e-12


def answer(path, names):
    """Places and displacements of the bar's nodes, and their digest: clamped, propped at its tip, heavy, pulled."""
    scene = make_scene(
        CELLS,
        regions=(Region(name="body", model="finite_elements"),),
        loads=(
            BodyForce(kind="body_force", region="body", density=(0.0, 0.0, -0.01)),
            Traction(kind="traction", total=(0.4, 0.1, 0.0), set=names["end"]),
        ),
        supports=(Support(x=0.0, y=0.0, z=0.0, set=names["clamp"]), Support(z=0.0, set=names["tip"])),
        solver="cg",
        tolerance=1e-12,
        mesh=FileMesh(path=str(path)),
    )
    body = build(scene)
    solver = make_solver(scene, body.share, body.forces, body.case, Silence().line)
    assert len(list(follow_load_program(scene, solver, None, body.state, body.case))) == 1
    fields = body.fields(body.state.u)
    return body.share.mesh.nodes, fields.u_nodes, fields_sha256(fields)


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    """The answer of the plainest file: Abaqus, one block of each kind, numbers from 1."""
    bar = make_bar()
    rows = ["*NODE", *(f"{k}, {x!r}, {y!r}, {z!r}" for k, (x, y, z) in enumerate(bar.nodes.tolist(), 1))]
    rows += ["*ELEMENT, TYPE=C3D8, ELSET=body"]
    rows += [", ".join(map(str, (k, *(cell + 1)))) for k, cell in enumerate(bar.cells, 1)]
    rows += ["*ELEMENT, TYPE=S4, ELSET=end"]
    rows += [", ".join(map(str, (100 + k, *(face + 1)))) for k, face in enumerate(bar.end, 1)]
    for name in ("clamp", "tip"):
        rows += [f"*NSET, NSET={name}", *(f"{place + 1}" for place in getattr(bar, name))]
    path = tmp_path_factory.mktemp("clean") / "bar.inp"
    path.write_text("\n".join(rows) + "\n")
    return answer(path, {name: name for name in ("clamp", "tip", "end")})


def follow(folder, seed, clean):
    """Read the dress of a seed and compare its answer, or its refusal, with what is right."""
    path, names, in_order, poison = write_dress(folder, seed)
    if poison:
        with pytest.raises(SceneError) as caught:
            answer(path, names)
        (message,) = caught.value.messages
        assert str(path) in message and re.search(r": line \d+: ", message) and poison in message, message
        assert re.search(r"\. (Write|Give|Correct|Mesh|Did you mean) ?.*[.?]$", message), message  # the remedy
        return "refused"
    nodes, u, digest = answer(path, names)
    if in_order:
        assert digest == clean[2], path
    order, other = np.lexsort(nodes.T), np.lexsort(clean[0].T)
    np.testing.assert_array_equal(nodes[order], clean[0][other])
    np.testing.assert_allclose(u[order], clean[1][other], rtol=0, atol=REORDERED * np.abs(clean[1]).max())
    return "in order" if in_order else "reordered"


@pytest.mark.parametrize("first", range(0, 30, 10))
def test_thirty_dresses(tmp_path, clean, first):
    """Ten seeds, one of each suffix and more of Abaqus."""
    for seed in range(first, first + 10):
        follow(tmp_path, seed, clean)


@pytest.mark.slow
@pytest.mark.parametrize("first", range(30, 330, 10))
def test_three_hundred_dresses(tmp_path, clean, first):
    """The same for three hundred more."""
    for seed in range(first, first + 10):
        follow(tmp_path, seed, clean)
