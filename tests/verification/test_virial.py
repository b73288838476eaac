"""The surface correction by a virial stress: elastic constants of bars and thin plates, beside those of appendix A."""

import pytest

from support.bodies import run_deck

#: E/E0 of bars of 8 x 8 and plates of 1 to 4 cells lies within 1.009 to 1.0125, of a bar of 4 x 4 cells at 1.013.
MODULUS, TOLERANCE = 1.011, 0.0025
#: Point-wise factors do not cure Poisson's ratio: .24 in thick bodies, .205 in a plate one cell thick.
LEAST_RATIO, LARGEST_RATIO = 0.2, 0.245
#: Appendix A on the bar of 8 x 8 cells.
APPENDIX_A, APPENDIX_A_TOLERANCE = 0.9485, 0.002
#: Height and thickness in inches; cells of 0.05.
SECTIONS = {
    "bar of 4 x 4": (0.2, 0.2),
    "bar of 8 x 8": (0.4, 0.4),
    "plate of 1": (0.6, 0.05),
    "plate of 2": (0.6, 0.1),
    "plate of 4": (0.6, 0.2),
}
QUICK = ("bar of 4 x 4", "plate of 1")


def measured(out, section, correction, *overrides):
    """Results of the bar probe of 24 cells of 0.05 in with a cross section."""
    height, thickness = (0.5 * side for side in SECTIONS[section])
    force = 1.0e4 * SECTIONS[section][0] * SECTIONS[section][1]
    return run_deck(
        "bar_pd.toml",
        out,
        f"mesh.lower=[-0.6, {-height}, {-thickness}]",
        f"mesh.upper=[0.6, {height}, {thickness}]",
        f'peridynamics.surface_correction="{correction}"',
        f"loads.0.total=[{force}, 0.0, 0.0]",
        f"loads.1.total=[{-force}, 0.0, 0.0]",
        "probes.left_end.point=[-0.6, 0.0, 0.0]",
        "probes.right_end.point=[0.6, 0.0, 0.0]",
        'solver.kind="cg"',
        *overrides,
    )["probes"]


@pytest.mark.parametrize(
    "section", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in SECTIONS]
)
def test_bars_and_thin_plates_have_youngs_modulus(tmp_path, section):
    """E/E0 within 1.4 % where appendix A leaves .95 and less; Poisson's ratio stays below 1/4."""
    found = measured(tmp_path, section, "virial")
    assert found["modulus_ratio_peridynamics"] == pytest.approx(MODULUS, abs=TOLERANCE)
    assert LEAST_RATIO < found["poissons_ratio_peridynamics"] < LARGEST_RATIO


@pytest.mark.slow
def test_appendix_a_is_softer(tmp_path):
    """The bar of 8 x 8 cells with the paper's correction."""
    found = measured(tmp_path, "bar of 8 x 8", "appendix_a")["modulus_ratio_peridynamics"]
    assert found == pytest.approx(APPENDIX_A, abs=APPENDIX_A_TOLERANCE)


#: With a volumetric part: E/E0 lies within these, and Poisson's ratio of bars this near to the material's.
LEAST_MODULUS, LARGEST_MODULUS, RATIO = 1.0, 1.035, 0.03
SECTIONS_OF_RATIOS = {"bar of 4 x 4": (0.2, 0.2), "bar of 6 x 6": (0.3, 0.3), "plate of 2": (0.6, 0.1)}


@pytest.mark.parametrize(
    "nu", [pytest.param(0.1, marks=pytest.mark.slow), 0.33, pytest.param(0.45, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize(
    "section",
    ["bar of 4 x 4", *(pytest.param(name, marks=pytest.mark.slow) for name in ("bar of 6 x 6", "plate of 2"))],
)
def test_bars_and_plates_have_the_constants_of_any_material(tmp_path, monkeypatch, section, nu):
    """The lattice is not isotropic, which no factor of points cures: a ratio of 1/4 measures .22 to .24."""
    monkeypatch.setitem(SECTIONS, section, SECTIONS_OF_RATIOS[section])
    found = measured(tmp_path, section, "virial", f"material.poissons_ratio={nu}")
    assert LEAST_MODULUS <= found["modulus_ratio_peridynamics"] <= LARGEST_MODULUS
    assert found["poissons_ratio_peridynamics"] == pytest.approx(nu, abs=RATIO)
