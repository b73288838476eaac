"""The plate before and after in docs/fitted.md: its decks, its differences, its table."""

import numpy as np
import pytest

from tools.studies.fitted import plate


def make_line(factor_x=1.0, factor_y=1.0):
    x = np.linspace(-4.5, 4.5, 181)
    return {"x": x, "u_x": factor_x * 1e-3 * x, "u_y": factor_y * (4e-4 - 1e-5 * x**2)}


def test_runs_are_those_of_the_four_kinds_of_bonds_and_two_spacings_of_elements():
    scenes = [member.scene for item in plate.make_series(full=True) for member in item.members()]
    assert [scene.mesh.spacing for scene in scenes] == [0.05, 0.025, 0.05, 0.05, 0.05, 0.05]
    bonds = [scene for scene in scenes if scene.regions[0].model == "peridynamics" or len(scene.regions) > 1]
    kinds = [(s.coupling.kind if len(s.regions) > 1 else None, s.peridynamics.surface_correction) for s in bonds]
    assert kinds == [("paper", "appendix_a"), ("exact", "fitted"), (None, "appendix_a"), (None, "fitted")]
    # fitted bonds are pulled by tractions; where nothing is fitted, by what the paper prints
    assert [s.loads[0].kind for s in bonds] == ["traction", "traction", "body_force", "traction"]
    assert {s.loads[0].total for s in bonds} == {(6000.0, 0.0, 0.0)}
    coarse = [member.scene.mesh.spacing for item in plate.make_series(full=False) for member in item.members()]
    assert coarse == [0.1, 0.05, 0.1, 0.1, 0.1, 0.1]


def test_differences_are_percent_of_the_local_value_where_it_is_not_small():
    reference, line = make_line(), make_line(factor_x=1.01, factor_y=0.98)
    along_x, along_y = (plate.differences(line, reference, name) for name in ("u_x", "u_y"))
    told = np.abs(reference["x"]) > 4.5 * plate.LEAST - 1e-9
    assert np.isnan(along_x[~told]).all() and (~told).any()
    assert along_x[told] == pytest.approx(1.0)
    assert along_y == pytest.approx(-2.0)


def test_lines_of_other_places_are_refused():
    other = make_line()
    other["x"] = other["x"] + 0.01
    with pytest.raises(ValueError, match="other places"):
        plate.differences(other, make_line(), "u_x")


def test_table_has_a_row_for_each_station():
    """Elements off by 4 and 1 % extrapolate to 0; fitted bonds are off by 5 and, in a part, by 3 %."""
    off = dict(zip(plate.CURVES, (4.0, 1.0, 9.0, 7.0, 5.0, 3.0), strict=True))
    lines = {label: make_line(1.0 + 0.01 * percent, 1.0 - 0.01 * percent) for label, percent in off.items()}
    header, _, *rows = plate.station_table(lines).splitlines()
    assert len(rows) == sum(map(len, plate.STATIONS.values()))
    assert header.count("|") == rows[0].count("|") == 11
    number = [100.0 * ((1.0 + 0.01 * off[label]) / 1.04 - 1.0) for label in list(off)[1:]]
    number += [5.0, 3.0, 100.0 * (1.05 / 1.03 - 1.0)]
    assert rows[0] == "| u_x, x = 0.25 | 0.2600 | " + " | ".join(f"{value:+.2f} %" for value in number) + " |"
    assert rows[-3].startswith("| u_y, x = 3 | 0.2976 | +3.13 % | -5.21 %")
