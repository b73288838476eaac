"""The same bits on every processor, also where the ranks of one run are on different ones.

Environment variables make the libraries take a processor for another one: OpenBLAS its loops for LAPACK, numpy its
loops for each instruction set, numba the code that it compiles.
"""

import json
import subprocess
import sys

import pytest

from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.toml import write_deck
from pdfem_mpi.system.launcher import LaunchError, mpirun_command
from support.bodies import make_scene
from support.helpers import ROOT, outside_launcher
from support.restarts import differing, outcome

FINISHED = 0
#: What the libraries choose here: with AVX-512 where this processor has it. To name one that it is not would end in an
#: illegal instruction.
ITSELF = {}
HASWELL = {"OPENBLAS_CORETYPE": "Haswell", "NPY_DISABLE_CPU_FEATURES": "X86_V4,AVX512_ICL,AVX512_SPR"}
SANDYBRIDGE = {"OPENBLAS_CORETYPE": "Sandybridge", "NPY_DISABLE_CPU_FEATURES": "X86_V3,X86_V4,AVX512_ICL,AVX512_SPR"}
#: Code for a processor without AVX-512; kernels are compiled for it once, into a cache of their own.
COMPILED_FOR_ANOTHER = HASWELL | {"NUMBA_CPU_NAME": "znver3"}
AS_ANOTHER = """
import json, os, sys
from pdfem_mpi.system.launcher import rank_by_launcher
processors = json.loads(sys.argv.pop(1))
os.environ.update(processors[rank_by_launcher()])  # before numpy and numba are there
from pdfem_mpi.command.cli import main
sys.exit(main())
"""
HELD = (
    Support(face="x-", x="1e-3 * sin(y) ** 3", y="2e-4 * exp(z) * cos(x)", z=0.0),
    Support(face="x+", x="f * 1e-2", y=0.0, z=0.0),
)
NO_LOADS = {"loads": (), "output": Output(figures=False, fields=["displacement", "stress", "principal_stresses"])}
SCENES = {
    "coupled": lambda: make_scene((8, 3, 3), 4, supports=HELD, solver="cg", **NO_LOADS),
    "finite": lambda: make_scene((6, 3, 2), 3, kinematics="finite", solver="cg", output=NO_LOADS["output"]),
    "fitted": lambda: make_scene(
        (5, 4, 3), correction="fitted", solver="cg", poissons_ratio=0.3, output=NO_LOADS["output"]
    ),
}


def run(folder, scene, processors):
    """Run a scene on as many ranks as processors are given; return all of its results."""
    folder.mkdir()
    (folder / "deck.toml").write_text(write_deck(scene))
    try:
        start, additions = ([], {}) if len(processors) == 1 else mpirun_command(len(processors))
    except LaunchError as error:
        pytest.skip(str(error))
    words = ["-c", AS_ANOTHER, json.dumps(processors), "run", folder / "deck.toml", "--out", folder / "run"]
    done = subprocess.run(
        [*start, sys.executable, *map(str, words)],
        cwd=ROOT, env=outside_launcher(**additions), capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    assert done.returncode == FINISHED, done.stdout + done.stderr
    return outcome(folder / "run")


def test_two_processors_in_one_run(tmp_path):
    """Of all that LAPACK, BLAS and numpy choose by the processor nothing is in the results."""
    expected = run(tmp_path / "one", SCENES["coupled"](), [ITSELF])
    assert not differing(run(tmp_path / "two", SCENES["coupled"](), [HASWELL, SANDYBRIDGE]), expected)


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_processors_alone_and_mixed(tmp_path, scene):
    """One and two ranks, with kernels compiled for this processor and for one without AVX-512."""
    mixes = [ITSELF], [HASWELL], [SANDYBRIDGE], [COMPILED_FOR_ANOTHER], [ITSELF, COMPILED_FOR_ANOTHER]
    mixes += [SANDYBRIDGE, ITSELF], [HASWELL, HASWELL]
    expected, *others = (run(tmp_path / str(k), SCENES[scene](), mix) for k, mix in enumerate(mixes))
    for mix, found in zip(mixes[1:], others, strict=True):
        assert not differing(found, expected), mix


MESHES = """
from pdfem_mpi.mesh.generators import plate_with_hole
for width, height, thickness, radius, spacing in ((40.0, 30.0, 1.0, 6.0, 1.0), (4.3, 6.1, 0.1, 0.7, 0.1)):
    half = (0.5 * width, 0.5 * height, 0.5 * thickness)
    print(plate_with_hole(tuple(-h for h in half), half, radius, spacing).sha256())
"""


def test_meshes_of_plates_with_a_hole():
    """The first was another without AVX2, the second without AVX-512, while equations were sorted with ties."""
    found = [
        subprocess.run(
            [sys.executable, "-c", MESHES],
            cwd=ROOT, env=outside_launcher(**processor), capture_output=True, text=True, timeout=300, check=True,
        ).stdout
        for processor in (ITSELF, HASWELL, SANDYBRIDGE)
    ]  # fmt: skip
    assert found[0] and found[0] == found[1] == found[2]
