"""The bar's figure: what is drawn where, and in a size that can be read."""

import matplotlib.image
import numpy as np
import pytest
from matplotlib.figure import Figure

from pdfem_mpi.results.plots import (
    PARTS,
    BarStations,
    LineSamples,
    axial_displacement,
    displacement_along_line,
)

STRAIN = 1.0e-3
EXCESS = 0.05  # of the peridynamic half, as the paper prints


def coupled_bar(**changes):
    """Stations of a bar from -1 to 1: finite elements on the left, a softer peridynamic part on the right."""
    x = np.linspace(-1.0, 1.0, 21)
    peridynamic = x > 0.05
    stations = {
        "coordinate": x,
        "displacement": STRAIN * x * np.where(peridynamic, 1.0 + EXCESS, 1.0),
        "exact": STRAIN * x,
        "kind": np.where(peridynamic, "peridynamics", "finite elements"),
        "interface": 0.05,
        "overlap": (-0.05, 0.05),
    }
    return BarStations(**stations | changes)


@pytest.fixture
def drawn(monkeypatch):
    """Collect the figures that are saved."""
    figures = []
    savefig = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda self, *a, **k: (figures.append(self), savefig(self, *a, **k))[1])
    return figures


def lines(panel):
    return {line.get_label(): line for line in panel.get_lines()}


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_error_is_in_percent_of_the_end_displacement():
    error = coupled_bar().error_percent
    assert error[-1] == pytest.approx(100 * EXCESS, rel=1e-12)  # round-off
    assert error[15] == pytest.approx(100 * EXCESS / 2, rel=1e-12)
    assert not error[:11].any()


def test_a_bar_without_displacement_is_refused_and_nothing_is_written(tmp_path):
    with pytest.raises(ValueError, match="zero at every station"):
        axial_displacement(tmp_path / "bar.png", coupled_bar(exact=np.zeros(21)))
    assert list(tmp_path.iterdir()) == []


def test_picture_is_complete_and_of_the_promised_size(tmp_path):
    axial_displacement(tmp_path / "bar.png", coupled_bar(), "Bar", "in")
    picture = matplotlib.image.imread(tmp_path / "bar.png")
    assert picture.shape[:2] == (900, 1200)
    for part, style in PARTS.items():
        colour = np.array(matplotlib.colors.to_rgb(style["color"]))
        assert (np.abs(picture[..., :3] - colour).max(axis=-1) < 0.01).sum() > 100, part
    assert list(tmp_path.iterdir()) == [tmp_path / "bar.png"]


@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1)], ids=["sorted", "reversed"])
def test_panels_show_displacement_and_error_of_each_part(tmp_path, drawn, order):
    bar = coupled_bar()
    shuffled = {name: getattr(bar, name)[order] for name in ("coordinate", "displacement", "exact", "kind")}
    axial_displacement(tmp_path / "bar.png", coupled_bar(**shuffled))
    upper, lower = drawn[0].axes
    for part, of_part in (
        ("finite elements", bar.kind == "finite elements"),
        ("peridynamics", bar.coordinate > 0.05),
    ):
        for panel, values in ((upper, bar.displacement), (lower, bar.error_percent)):
            shown = lines(panel)[part].get_xydata()
            shown = shown[np.argsort(shown[:, 0])]
            np.testing.assert_array_equal(shown, np.stack([bar.coordinate, values], axis=1)[of_part])
        assert lines(upper)[part].get_color() == PARTS[part]["color"]
    np.testing.assert_array_equal(lines(upper)["exact solution"].get_xydata(), np.stack([bar.coordinate, bar.exact], 1))


def test_interface_overlap_labels_and_legend(tmp_path, drawn):
    axial_displacement(tmp_path / "bar.png", coupled_bar(axis="y"), "Bar under tension", "in")
    figure = drawn[0]
    upper, lower = figure.axes
    for panel in (upper, lower):
        assert list(lines(panel)["interface"].get_xdata()) == [0.05, 0.05]
        (band,) = panel.patches
        assert (band.get_x(), band.get_x() + band.get_width()) == (-0.05, 0.05)
    assert upper.get_ylabel() == "displacement $u_y$ (in)"
    assert lower.get_ylabel() == "error\n(% of end displacement)"
    assert lower.get_xlabel() == "position along the bar, $y$ (in)"
    assert figure.get_suptitle() == "Bar under tension"
    assert legend(figure) == [
        "exact solution",
        "finite elements",
        "peridynamics",
        "interface",
        "overlap (both models)",
    ]


@pytest.mark.parametrize("part", PARTS)
def test_a_bar_of_one_part_has_no_interface(tmp_path, drawn, part):
    axial_displacement(tmp_path / "bar.png", coupled_bar(kind=np.full(21, part), interface=None, overlap=None))
    assert legend(drawn[0]) == ["exact solution", part]
    assert drawn[0].axes[1].get_xlabel() == "position along the bar, $x$ (length units)"


def test_all_text_stays_inside_the_picture(tmp_path, drawn):
    """The widest legend, and a title as long as a deck's may well be."""
    axial_displacement(tmp_path / "bar.png", coupled_bar(), "Bar under tension, coupled: 200 x 8 x 8 cells", "in")
    (figure,) = drawn
    box = figure.get_tightbbox()
    width, height = figure.get_size_inches()
    assert 0.0 <= box.x0 < box.x1 <= width
    assert 0.0 <= box.y0 < box.y1 <= height


def test_drawing_leaves_the_callers_matplotlib_alone(tmp_path):
    with matplotlib.rc_context({"font.size": 7.0, "axes.grid": False}):
        before = dict(matplotlib.rcParams)
        axial_displacement(tmp_path / "bar.png", coupled_bar())
        assert dict(matplotlib.rcParams) == before


# --- lines ------------------------------------------------------------------------------------------------


def bottom_line(**changes):
    """Samples from -2 to 2: peridynamics in the middle, finite elements at the ends, a gap at 0."""
    x = np.linspace(-2.0, 2.0, 41)
    displacement = np.stack([STRAIN * x, STRAIN * np.cos(x)], axis=1)
    kind = np.where(np.abs(x) < 1.0, "peridynamics", "finite elements")
    displacement[20], kind[20] = np.nan, ""
    samples = {"coordinate": x, "displacement": displacement, "kind": kind, "along": "x", "where": "line bottom"}
    return LineSamples(**samples | changes)


def test_line_has_a_panel_for_each_component_with_both_models(tmp_path, drawn):
    samples = bottom_line()
    displacement_along_line(tmp_path / "line.png", samples, "Plate", "in")
    (figure,) = drawn
    for component, panel in enumerate(figure.axes):
        assert panel.get_ylabel() == f"displacement $u_{'xy'[component]}$ (in)"
        for part in PARTS:
            drawn_part = lines(panel)[part]
            of_part = samples.kind == part
            np.testing.assert_array_equal(drawn_part.get_xdata(), samples.coordinate[of_part])
            np.testing.assert_array_equal(drawn_part.get_ydata(), samples.displacement[of_part, component])
    assert figure.axes[1].get_xlabel() == "position on the line, $x$ (in)"
    assert legend(figure) == ["finite elements", "peridynamics"]
    assert figure.get_suptitle() == "Plate\nline bottom"
    assert matplotlib.image.imread(tmp_path / "line.png").shape[:2] == (900, 1200)


def test_oblique_line_of_one_model_without_units(tmp_path, drawn):
    kind = np.full(41, "peridynamics")
    displacement_along_line(tmp_path / "line.png", bottom_line(kind=kind, along="distance from its start"))
    assert legend(drawn[0]) == ["peridynamics"]
    assert drawn[0].axes[1].get_xlabel() == "position on the line, distance from its start (length units)"
