"""Linear elastic fracture mechanics: a crack under energy control grows, in the mean, at the bonds' own G_c.

The release rate is ``G = -load^2 dU/dA`` with the strain energy U at unit load of the same body with ideal cracks of
several lengths. The length of a grown crack is that of the ideal crack of the same stiffness: where bonds broke one by
one, nothing else tells where it ends. ``G_c`` is the energy at critical stretch of the bonds that a plane cuts in the
intact body. ``G / G_c`` at the loads of the next breaks is a saw-tooth, from below .8 to above 1.3, one tooth for each
layer of points: means are taken over the growth of several cells. The first break is not compared with anything: it
is a quantity of the lattice.
"""

from functools import cache

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.deck.toml import parse_deck
from support.bodies import build
from support.failing import failing
from support.helpers import ROOT
from support.measure import released

LOWEST, HIGHEST = 0.90, 1.12  # of the mean of G / G_c(own bonds)
GROWTH = 4.0  # cells, at least
FIRST_TEETH = 1.0  # cells until the saw-tooth is steady: an ideal crack is sharper than a grown one
SMALL = 1e-3  # load factor of the ideal cracks: nothing breaks
CLOSED = 1e-10

CASES = {
    "double cantilever": (  # 1.07 is found
        "double_cantilever.toml",
        ["mesh.lower=[-0.6,0.0,-0.05]", "mesh.upper=[0.6,2.4,0.05]", "stepping.eta=0.03"],
        np.arange(1.01, 2.0, 0.1),
    ),
    "double cantilever, longer": (  # 1.07
        "double_cantilever.toml",
        ["mesh.lower=[-0.6,0.0,-0.05]", "mesh.upper=[0.6,3.2,0.05]"],
        np.arange(1.01, 2.3, 0.1),
    ),
    "centre crack": (  # 1.10
        "plate_centre_crack.toml",
        ["mesh.lower=[-1.6,-1.6,-0.05]", "mesh.upper=[1.6,1.6,0.05]"],
        np.arange(0.51, 1.3, 0.1),
    ),
    "double cantilever, plane strain": (  # 1.005: between mirror planes the crack has no free face
        "double_cantilever.toml",
        [
            "mesh.lower=[-0.6,0.0,0.0]",
            "mesh.upper=[0.6,2.4,0.1]",
            'mesh.symmetry=["z-","z+"]',
            "stepping.eta=0.03",
            "peridynamics.surface_correction=virial",
            "regions.held.upper=[0.6,0.2,0.1]",
            "regions.beam.lower=[-0.6,0.2,0.0]",
            "supports.0.lower=[-0.6,0.0,0.0]",
            "supports.0.upper=[-0.2,0.1,0.1]",
            "supports.1.lower=[0.2,0.0,0.0]",
            "supports.1.upper=[0.6,0.1,0.1]",
        ],
        np.arange(1.01, 2.0, 0.1),
    ),
}  # all one cell thick
#: In plane strain nothing but the bulk's bonds is cut.
STRAINED = (0.97, 1.05)


def with_tip(scene, tip):
    """The scene with its crack as long as ``tip`` says; a crack at the centre stays there."""
    polygon = scene.cracks[0].polygon
    centred = min(y for _, y, _ in polygon) == -max(y for _, y, _ in polygon)
    moved = tuple((x, tip if y > 0 else -tip if centred else y, z) for x, y, z in polygon)
    ends = 2 if centred else 1
    steps = Steps(load_factors=(SMALL,))
    return ends, scene.model_copy(update={"cracks": (Crack(polygon=moved),), "stepping": steps})


def own_fracture_energy(scene):
    """Energy at critical stretch of the bonds that the crack's plane cuts, per area, model units; between mirror planes
    that of the bulk.
    """
    if scene.mesh.symmetry:
        material, length = scene.material, scene.mesh.spacing
        return material.energy_at_failure(material.critical_stretch, length, 2.5) / (material.youngs_modulus * length)
    body = build(scene.model_copy(update={"cracks": ()}), loaded=False)
    thickness = (scene.mesh.upper[2] - scene.mesh.lower[2]) / body.share.units.length
    across = released(body, 0.0, (3.0, 0.75 * thickness))  # six cells along the crack, all of the thickness
    return across / (6.0 * thickness) * scene.material.critical_stretch**2


def grown(deck, overrides, tips):
    """Follow the deck until its crack has grown by ``GROWTH`` cells.

    Returns
    -------
    length : float64
        Of the crack, in cells, at each row.
    ratio : float64
        ``G / G_c`` there.
    rows : list of Report
    """
    scene = parse_deck((ROOT / "jobs" / deck).read_text(encoding="utf-8"), deck, overrides)
    energies = []
    for tip in tips:
        ends, ideal = with_tip(scene, tip)
        energies += [row.stored / SMALL**2 for row in failing(ideal).follow()]
    lengths = ends * tips / scene.mesh.spacing
    thickness = (scene.mesh.upper[2] - scene.mesh.lower[2]) / scene.mesh.spacing
    slope = CubicSpline(lengths, energies).derivative()
    own = own_fracture_energy(scene)
    run = failing(scene)
    length, ratio = [], []
    for row in run.follow():
        stiffness = row.stored / row.load_factor**2
        length.append(np.interp(-stiffness, -np.array(energies), lengths))
        ratio.append(-(row.load_factor**2) * slope(length[-1]) / thickness / own)
        if length[-1] > length[0] + FIRST_TEETH + GROWTH:
            break
    return np.array(length), np.array(ratio), run.rows


@pytest.mark.parametrize(
    "name", [name if name == "double cantilever" else pytest.param(name, marks=pytest.mark.slow) for name in CASES]
)
def test_crack_grows_at_its_own_fracture_energy(name):
    """Mean G / G_c over four cells of growth, after the first: .90 to 1.12, in plane strain .97 to 1.05; the ledger
    closes all along.
    """
    length, ratio, rows = grown(*CASES[name])
    steady = length > length[0] + FIRST_TEETH
    assert length[-1] - length[0] >= FIRST_TEETH + GROWTH
    growth, means = np.diff(length[steady]), 0.5 * (ratio[steady][1:] + ratio[steady][:-1])
    low, high = STRAINED if "plane strain" in name else (LOWEST, HIGHEST)
    assert low <= means @ growth / growth.sum() <= high, ratio
    assert rows[0].broken == 0
    assert all(row.event == "critical" for row in rows)
    assert max(abs(row.ledger_error) for row in rows) <= CLOSED


#: Of the fracture energy relative to that at 1/4, against the formula: the crack band widens from 0.4 on, which no
#: plane of bonds knows of. Found: 0.963, 0.993 and 0.924 at 0.1, 0.33 and 0.4.
RELATIVE = 0.1


@cache
def mean_energy(nu):
    """Mean G over that of the bonds across a plane in plane strain, and the formula's share of the dilatation."""
    deck, overrides, tips = CASES["double cantilever"]
    overrides = [*overrides, 'mesh.symmetry=["z-","z+"]', f"material.poissons_ratio={nu}"]
    length, ratio, rows = grown(deck, overrides, tips)
    assert max(abs(row.ledger_error) for row in rows) <= CLOSED
    steady = length > length[0] + FIRST_TEETH
    growth, means = np.diff(length[steady]), 0.5 * (ratio[steady][1:] + ratio[steady][:-1])
    return means @ growth / growth.sum()


@pytest.mark.slow
@pytest.mark.parametrize("nu", [0.1, 0.33, 0.4])
def test_fracture_energy_at_any_poissons_ratio(nu):
    """A crack grows at the energy from which the critical stretch is taken, as well as it does at 1/4."""
    assert mean_energy(nu) == pytest.approx(mean_energy(0.25), rel=RELATIVE)
