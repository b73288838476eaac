"""The runs behind the figures of docs/paper.md: decks of jobs/ and keys that vary."""

from __future__ import annotations

from tools.studies.members import Series

# Appendix B: the paper's cells, thicknesses and lengths; the coarse set keeps the ratios to the cells
STRAIN, X0, Y0 = 1.875e-3, 2.5, 1.0
STRESS = 18750.0
COARSE_CORNERS = {
    "elements_left.upper": "[-2.1,1.5,0.1]",
    "elements_right.lower": "[2.1,-1.5,-0.1]",
    "band_left.lower": "[-2.1,-1.5,-0.1]",
    "band_right.upper": "[2.1,1.5,0.1]",
}


def make_series(full: bool) -> list[Series]:
    """All series, cheap ones first."""
    bar = () if full else ("mesh.spacing=0.2", "probes.axis.n=51")
    plate = () if full else ("mesh.spacing=0.2", "probes.bottom.n=91")
    # with cells of 0.2 in, interfaces at 2 would not lie between cells
    moved = () if full else tuple(f"regions.{name}={corner}" for name, corner in COARSE_CORNERS.items())
    quiet = ("output.fields=false", "output.figures=false")
    readings = "coupling.kind=paper,paper_a"
    cg = "solver.kind=cg"
    h = 0.08 if full else 0.5
    box = () if full else ("mesh.lower.0=-4.5", "mesh.upper.0=4.5", f"mesh.spacing={h}")
    density = STRESS / h
    loads = tuple(f"loads.{k}.density=[{sign * density},0.0,0.0]" for k, sign in ((0, 1.0), (1, -1.0)))

    def varied(key, ratios):
        return f"{key}=" + ",".join(f"{ratio * h:.12g}" for ratio in ratios)

    def lengths(*ratios):
        return varied("peridynamics.internal_length", ratios)

    def thicknesses(*cells):
        pairs = (f"{-0.5 * n * h:.12g}:{0.5 * n * h:.12g}" for n in cells)
        return "mesh.lower.2:mesh.upper.2=" + ",".join(pairs)

    one, ten = (1, 10 if full else 2)
    series = [
        Series("bar_fe", "bar_fe.toml", (cg,), (*bar, *quiet)),
        Series("bar_pd", "bar_pd.toml", (cg,), (*bar, *quiet)),
        Series("bar_coupled", "bar_tension.toml", (readings,), (cg, *bar, *quiet)),
        Series("plate_fe", "plate_fe.toml", (cg,), (*plate, *quiet)),
        Series("plate_pd", "plate_pd.toml", (cg,), (*plate, *quiet)),
        Series("plate_coupled", "plate_coupled.toml", (readings,), (*plate, *moved, *quiet)),
        Series("b_fe", "appendix_b_fe.toml", (thicknesses(one),), (*box, *quiet)),
        Series(
            "b4_cutoff",
            "appendix_b_pd.toml",
            (varied("peridynamics.cutoff_radius", (1, 1.5, 2, 2.25, 2.5, 3, 4) if full else (1, 2.5, 3)),),
            (*box, *loads, *one_thickness(one, h), lengths(1), *quiet),
        ),
        Series(
            "b2_thickness",
            "appendix_b_pd.toml",
            (lengths(1, 1.5) if full else lengths(1, 1.25), thicknesses(*((1, 2, 3, 5, 10) if full else (1, 2)))),
            (*box, *loads, *quiet),
        ),
        Series(
            "b5_internal_length",
            "appendix_b_pd.toml",
            (lengths(*((0.4, 0.5, 0.6, 0.8) if full else (0.5,))),),  # 1 and 1.5 are in b2_thickness
            (*box, *loads, *one_thickness(ten, h), *quiet),
        ),
    ]
    if full:
        series.append(Series("b2_long", "appendix_b_pd.toml", (lengths(2), thicknesses(1, 2, 3)), (*loads, *quiet)))
    return series


def one_thickness(cells: int, h: float) -> tuple[str, str]:
    """Overrides for one thickness."""
    return f"mesh.lower.2={-0.5 * cells * h:.12g}", f"mesh.upper.2={0.5 * cells * h:.12g}"
