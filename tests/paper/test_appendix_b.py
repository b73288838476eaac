"""Appendix B: Poisson's ratio and displacements of a plate against thickness, internal length and cutoff radius.

Plates of 18 x 8 cells: the ends are 4 cells from the place x0 (eq. B1), enough for trends.
What the paper says and what the full size gives is in docs/paper.md.
"""

import pytest

from support.bodies import run_deck
from support.measure import lattice_of

STRAIN, X0, Y0 = 18750.0 / 1.0e7, 2.5, 1.0
SPACING = 0.5
DENSITY = 18750.0 / SPACING  # of the body force in one layer of cells, so that the stress is that of the paper

# Printed limits of Poisson's ratio: two dimensions, three dimensions
THIN, THICK = 1.0 / 3.0, 1.0 / 4.0
LATTICE = 0.015  # the corrected lattice has .24 instead of .25, and a plate of 8 cells is not yet thick
CUTOFF_CONVERGED = 0.01  # of u_x, from r_c = 2.5 l on: the stiffness left out there is 1.4 %, of which appendix A
# restores what its first moment sees


@pytest.fixture(scope="module")
def plate(tmp_path_factory):
    """Displacement at x0 of plates, each run once: thickness in cells, and lengths in cells."""
    found = {}

    def run(thickness, internal_length=1.0, cutoff=2.5, deck="appendix_b_pd.toml"):
        key = thickness, internal_length, cutoff, deck
        if key not in found:
            half = 0.5 * thickness * SPACING
            overrides = [f"mesh.spacing={SPACING}", f"mesh.lower=[-4.5,-2.0,{-half}]", f"mesh.upper=[4.5,2.0,{half}]"]
            if deck == "appendix_b_pd.toml":
                length = internal_length * SPACING
                overrides += [f"peridynamics.internal_length={length}", f"peridynamics.cutoff_radius={cutoff * length}"]
                overrides += [f"loads.{k}.density=[{sign * DENSITY},0.0,0.0]" for k, sign in ((0, 1), (1, -1))]
            out = tmp_path_factory.mktemp("plate")
            found[key] = run_deck(deck, out, *overrides)["probes"]["x0"]
        return found[key]

    return run


def poissons_ratio(u):
    """Eq. B3."""
    return -(u[1] / Y0) / (u[0] / X0)


def test_finite_elements_hold_the_closed_form(plate):
    """Figs B3 to B5: the finite-element plate has u_x = strain x, u_y = -nu strain y, whatever its thickness."""
    u = plate(2, deck="appendix_b_fe.toml")
    assert u[0] == pytest.approx(STRAIN * X0, rel=1e-7)  # the deck's tolerance, 1e-8
    assert poissons_ratio(u) == pytest.approx(0.25, abs=1e-7)


@pytest.mark.parametrize("internal_length", [1.0, 1.25])
def test_poissons_ratio_falls_with_thickness_from_a_third_toward_a_quarter(plate, internal_length):
    """Fig. B2: "approaches its theoretical value of 1/4 with increasing plate thickness"."""
    found = [poissons_ratio(plate(thickness, internal_length)) for thickness in (1, 2, 4)]
    assert THIN > found[0] > found[1] > found[2]
    if internal_length == 1.0:  # the thickest plate is four internal lengths thick
        assert found[2] == pytest.approx(THICK, abs=LATTICE)


@pytest.mark.parametrize("thickness", [1, 2, 4])
def test_poissons_ratio_rises_with_the_internal_length(plate, thickness):
    """Fig. B2: "the Poisson's ratio increases with increasing internal length, especially for thin plates"."""
    assert poissons_ratio(plate(thickness, 1.25)) > poissons_ratio(plate(thickness, 1.0))


def test_displacements_fall_with_thickness_but_not_to_those_of_elements(plate):
    """Fig. B3: both components come nearer to the closed form; "converge to the finite element method" is not found.

    Appendix A leaves thick bodies 4 to 5 % too soft (section 3 of it matches another moment than stiffness).
    """
    found = [plate(thickness) for thickness in (1, 2, 4)]
    u_x = [u[0] / (STRAIN * X0) for u in found]
    assert u_x[0] > u_x[1] > u_x[2] > 1.03
    u_y = [u[1] / (-0.25 * STRAIN * Y0) for u in found]
    assert u_y[0] > u_y[1] > u_y[2]
    # "more pronounced for displacements in the transverse direction"
    assert u_y[0] - 1.0 > u_x[0] - 1.0


def test_displacements_converge_with_the_cutoff_radius(plate):
    """Fig. B4: one cell thick, u_x falls with the cutoff and has "no significant difference" from r_c = 2.5 l on."""
    u_x = {cutoff: plate(1, cutoff=cutoff)[0] for cutoff in (1.0, 1.5, 2.5, 3.0)}
    assert u_x[3.0] == pytest.approx(u_x[2.5], rel=CUTOFF_CONVERGED)
    assert abs(u_x[1.0] / u_x[3.0] - 1.0) > 3.0 * CUTOFF_CONVERGED


def test_displacements_settle_from_an_internal_length_of_a_cell_on(plate):
    """Fig. B5, 10 cells thick in the paper, 4 here: short lengths are off, from l = Delta on little changes.

    The paper finds a loss of stiffness for short lengths; here it is a gain at .5 cells, see the next test.
    """
    u_x = {length: plate(4, internal_length=length)[0] for length in (0.5, 1.0, 1.25)}
    assert abs(u_x[1.25] / u_x[1.0] - 1.0) < 0.3 * abs(u_x[0.5] / u_x[1.0] - 1.0)


def test_short_internal_lengths_stiffen_the_gauss_lattice():
    """Fig. B5, "loss in stiffness" for short lengths: the Gauss rule gains down to .4 cells, and loses nu.

    The nearest points of the rule are .42 of an edge apart, so it samples the response where r^3 times it is large.
    """
    moduli, ratios = zip(*(lattice_of(length) for length in (0.3, 0.4, 0.5, 0.75, 1.0)), strict=True)
    assert moduli[1] > moduli[2] > moduli[3] > moduli[4] > 1.0
    assert moduli[0] < moduli[1]
    assert sorted(ratios) == list(ratios) and ratios[0] < 0.06
