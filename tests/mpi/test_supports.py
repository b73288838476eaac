"""What supports prescribe, and what is refused of them, is the same on any number of ranks."""

import pytest

from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.parallel.comm import mpi
from support.bodies import build, make_scene
from support.helpers import assert_all

pytestmark = pytest.mark.mpi(min_size=2)


@pytest.mark.parametrize("n_elements", [0, 4, 8])
def test_contradictions_on_the_way_are_told_alike(comm, n_elements):
    """Of supports along the whole body, and one at its end that a single rank may see; 2 reaches the mirror."""
    supports = (
        Support(face="z-", z="1e-3*x*f^2", x="1e-3*f"),
        Support(face="y+", z="1e-3*x*f", x=1e-3),
        Support(face="x+", z=8e-3, y="f*(1-f)"),
    )
    scene = make_scene((8, 3, 3), n_elements, loads=(), supports=supports, symmetry=("y-",))
    scene = Scene.model_validate({**dict(scene), "stepping": Steps(kind="steps", load_factors=(0.4, 1.0))})
    told = []
    for ranks in (comm, mpi().COMM_SELF):
        with pytest.raises(SceneError) as caught:
            build(scene, ranks)
        told.append(caught.value.messages)
    assert_all(comm, told[0] == told[1] and len(told[0]) >= 2, f"{told}")
    assert_all(comm, all("at load factor 0.4" in text or "mirror plane" in text for text in told[0]), f"{told}")
