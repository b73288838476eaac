"""The figure of docs/speed_vs_error.md: errors against core-seconds, and what the solver leaves against sweeps."""

from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from tools.studies.speed_vs_error.cases import FLOOR, MODES, NAMES, PHYSICS, mode

# Colours of Okabe & Ito (2008), as in the program's own figures.
COLOURS = {"fe": "#0072B2", "pd": "#D55E00", "paper": "#009E73", "paper_a": "#CC79A7"}
WHERE = {
    "fe": "elements",
    "pd": "peridynamics",
    "paper": "coupled, reading B (fitted: exact)",
    "paper_a": "coupled, reading A",
}
BODIES = {"bar": "o", "plate": "s"}
SOLVERS = {"cg": "-", "adr": ":"}
DARK, GREY = "#333333", "#888888"
SVG_STYLE = {"svg.fonttype": "none", "svg.hashsalt": "pdfem", "font.size": 9, "axes.titlesize": 10}


def draw(path, bodies, fronts, with_found) -> None:
    """Draw error against core-seconds for both bodies beside solver error against sweeps, as an SVG."""
    with rc_context(SVG_STYLE):
        figure = Figure(figsize=(13.5, 5.8), layout="constrained")
        (*errors, right), keys = figure.subplots(2, 3, height_ratios=(1.0, 0.17))
        errors[1].sharey(errors[0])
        for axes, body in zip(errors, bodies, strict=True):
            _draw_error(axes, body, bodies[body], fronts[body], with_found[body])
        _draw_solver_error(right, bodies)
        for axes, handles, columns in zip(keys, _keys(), (2, 3, 2), strict=True):
            axes.set_axis_off()
            axes.legend(handles=handles, ncols=columns, loc="upper center", frameon=False, fontsize=8)
        for axes in (*errors, right):
            axes.set(xscale="log", yscale="log")
            if not axes.lines:  # nothing run yet
                axes.set_xlim(1.0, 10.0)
            axes.grid(color="#e4e4e4", linewidth=0.6)
            axes.set_axisbelow(True)
            axes.spines[["top", "right"]].set_visible(False)
            axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.xaxis.set_major_formatter(lambda value, _: f"{value:,g}")
            axes.xaxis.set_minor_formatter(NullFormatter())
        errors[0].set_ylim(FLOOR, None)
        errors[0].yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        figure.savefig(path, metadata={"Date": None})


def _draw_error(axes, body, rows, front, with_found):
    """Each case of a body, the front of those with bonds, and that front where fits are found."""
    for row in rows:
        if row.error is None:
            continue
        colour = COLOURS[row.case.model]
        marker = MODES[mode(row.case)][1]
        # a fit that counts is filled, one found is not; what has none is filled too
        face = "white" if row.case.fit == "found" else colour
        axes.plot(
            row.total,
            max(row.error, FLOOR),
            marker,
            color=colour,
            markerfacecolor=face,
            markersize=_size(row.case.spacing),
            alpha=0.8,
            clip_on=False,
        )
    for line, style, width in ((front, "-", 1.1), (with_found, ":", 1.0)):
        if not line:
            continue
        at = ([row.total for row in line], [max(row.error, FLOOR) for row in line])
        axes.step(*at, style, where="post", color=DARK, linewidth=width, clip_on=False, zorder=1)
    axes.set_title(f"{body.capitalize()}: error (on the lower edge {FLOOR:g} % or less)")
    axes.set(xlabel="core-seconds, fit, set-up and solve", ylabel="error in percent")


def _draw_solver_error(axes, bodies):
    """A line for each body, model, spacing and solver, over the tolerances."""
    lines = {}
    for row in (row for rows in bodies.values() for row in rows if row.solver_error):
        case = row.case
        if not any(case.differs(field) for field in PHYSICS):
            lines.setdefault((case.body, case.model, case.spacing, case.solver), []).append(row)
    for (body, model, spacing, solver), rows in lines.items():
        rows.sort(key=lambda row: row.sweeps)
        axes.plot(
            [row.sweeps for row in rows],
            [row.solver_error for row in rows],
            color=COLOURS[model],
            linestyle=SOLVERS[solver],
            linewidth=1.1,
            marker=BODIES[body],
            markerfacecolor=COLOURS[model] if body == "bar" else "white",
            markersize=_size(spacing),
        )
    axes.set_title("What the solver leaves of tolerances of 1e-2 to 1e-8")
    axes.set(xlabel="sweeps", ylabel="solver error in percent")


def _keys():
    """Legends: colours and fronts, markers and sizes, solvers and bodies."""

    def mark(marker, label, colour=GREY, face=None, size=6.0):
        options = {"color": colour, "markerfacecolor": face or colour, "markersize": size}
        return Line2D([], [], marker=marker, linestyle="", label=label, **options)

    def line(style, label):
        return Line2D([], [], color=DARK, linestyle=style, linewidth=1.1, label=label)

    return (
        [
            *(mark("o", WHERE[model], colour) for model, colour in COLOURS.items()),
            line("-", "front of cases with bonds"),
            line(":", "the same where fits are found"),
        ],
        [
            *(mark(marker, words or "appendix A") for words, marker in MODES.values()),
            mark("s", "fit found", face="white"),
            *(mark("o", f"spacing {h:g}", size=_size(h)) for h in (0.2, 0.1, 0.05)),
        ],
        [
            *(line(style, NAMES[solver]) for solver, style in SOLVERS.items()),
            *(mark(BODIES[body], body, face=face) for body, face in zip(BODIES, (GREY, "white"), strict=True)),
        ],
    )


def _size(spacing):
    """Diameter of a marker in points: the finer, the larger."""
    return 3.5 if spacing > 0.15 else 5.0 if spacing > 0.07 else 7.0
