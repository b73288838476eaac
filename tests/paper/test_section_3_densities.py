"""Sections 3.1 and 3.3: fictitious densities (11), masses (21)-(22) and the limit of stability.

Central differences with a time step of 1 are stable while no eigenvalue of ``Lambda^-1 K`` exceeds 4.
"""

import numpy as np
import pytest

from support.bodies import build, make_scene
from support.measure import largest_eigenvalue

STABILITY_LIMIT = 4.0
# largest eigenvalue with g_ij in eq. 11 on cubic cells, and with g_ij in the bonds but not in the densities:
# measured with an independent program, printed to two and one digits
WITH_G, WITH_G_TOLERANCE = 2.99, 0.01
WITHOUT_G, WITHOUT_G_TOLERANCE = 10.2, 0.3  # also depends on how many corners the body has
POWER_ITERATION_ERROR = 2e-3  # relative, of 200 iterations; elements have the closest neighbours in their spectrum


@pytest.mark.parametrize("cells", [(12, 4, 4), (8, 8, 8)], ids=["bar", "block"])
def test_peridynamic_densities_with_the_bond_factors(cells):
    """Eq. 11 with g_ij: the largest eigenvalue is 2.99, the same for bars and blocks."""
    found = largest_eigenvalue(build(make_scene(cells)))
    assert found == pytest.approx(WITH_G, abs=WITH_G_TOLERANCE)


def test_peridynamic_densities_as_printed_are_unstable():
    """Eq. 11 without g_ij, as printed: the largest eigenvalue is 10.2, beyond the limit of 4."""
    corrected = build(make_scene((8, 8, 8)))
    printed = build(make_scene((8, 8, 8), correction="none")).model.mass
    found = largest_eigenvalue(corrected, printed)
    assert found == pytest.approx(WITHOUT_G, abs=WITHOUT_G_TOLERANCE)


@pytest.mark.parametrize(
    ("cells", "n_elements", "options"),
    [
        ((12, 4, 4), 6, {}),
        ((12, 4, 4), 6, {"coupling": "paper_a"}),
        ((12, 4, 4), 6, {"overlap": 3}),
        ((12, 3, 5), 4, {"coupling": "paper_a", "overlap": 2}),
        ((12, 8, 1), 6, {}),
        ((8, 8, 8), 0, {"correction": "none"}),
        ((12, 8, 1), 0, {}),
        ((12, 4, 4), 12, {}),
        ((4, 1, 1), 4, {}),
        ((6, 6, 6), 6, {"poissons_ratio": 0.45}),
    ],
    ids=[
        "coupled", "coupled, reading A", "overlap 3", "reading A, overlap 2", "coupled plate", "no correction",
        "plate of one cell", "elements", "row of elements", "nearly incompressible elements",
    ],
)  # fmt: skip
def test_every_model_is_stable(cells, n_elements, options):
    """Eqs 11, 22 and 29: no eigenvalue of ``M^-1 K`` exceeds 4, nodes of the overlap included."""
    body = build(make_scene(cells, n_elements, **options))
    assert 1.0 < largest_eigenvalue(body) * (1 + POWER_ITERATION_ERROR) < STABILITY_LIMIT


@pytest.mark.parametrize("coupling", ["paper", "paper_a"])
def test_masses_of_the_overlap_are_not_wasteful(coupling):
    """Nodes of the overlap may carry no more than the limit asks for: a vector on them alone passes 1/4 of it."""
    body = build(make_scene((8, 4, 4), 4, coupling=coupling))
    n = 3 * body.model.unknowns.n_points
    number = np.unique(body.model.overlap.connectivity)
    on_overlap = np.zeros(body.model.n_unknowns, bool)
    on_overlap[n:].reshape(-1, 3)[number] = True
    mass = np.where(on_overlap, body.model.mass, np.inf)
    assert STABILITY_LIMIT / 4 < largest_eigenvalue(body, mass) < STABILITY_LIMIT


def test_masses_have_the_units_of_a_stiffness():
    """The masses of a body in other units of length and stress are the same in model units, to the bit."""
    scene = make_scene((6, 3, 3), 3)
    mesh = scene.mesh.model_copy(update={"upper": (0.75, 0.375, 0.375), "spacing": 0.125})
    material = scene.material.model_copy(update={"youngs_modulus": 1.0e7})
    regions = tuple(
        region.model_copy(
            update={
                "lower": region.lower and tuple(x / 8 for x in region.lower),
                "upper": region.upper and tuple(x / 8 for x in region.upper),
            }
        )
        for region in scene.regions
    )
    smaller = scene.model_copy(update={"mesh": mesh, "material": material, "regions": regions})
    assert (build(smaller).model.mass == build(scene).model.mass).all()
