"""The cases of the chart of speed against error: decks of jobs/ in many settings, and the series they stand in."""

from __future__ import annotations

from dataclasses import dataclass, replace

FINE = 0.05  # the paper's spacing
DECKS = {
    ("bar", "fe"): "bar_fe.toml",
    ("bar", "pd"): "bar_pd.toml",
    ("bar", "paper"): "bar_tension.toml",
    ("bar", "paper_a"): "bar_tension.toml",
    ("plate", "fe"): "plate_fe.toml",
    ("plate", "pd"): "plate_pd.toml",
    ("plate", "paper"): "plate_coupled.toml",
    ("plate", "paper_a"): "plate_coupled.toml",
}
FORCES = {"bar": 1600.0, "plate": 6000.0}  # pull on the ends
SIDES = {"bar": (5.0, 0.2, 0.2), "plate": (4.5, 1.5, 0.1)}  # half the box
COUPLED = ("paper", "paper_a")
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
CONVERGED = 1e-10  # of the case that a solver error is measured against
MODES = {  # of corrections: words in a row's name, marker
    "none": ("no correction", "x"),
    "appendix_a": ("", "o"),
    "virial": ("virial", "^"),
    "fitted": ("fitted", "s"),
    "fitted, positive": ("fitted, positive", "D"),
}
NAMES = {"cg": "conjugate gradients (cg)", "adr": "relaxation (adr)"}
PHYSICS = ("internal_length", "cutoff", "correction", "signs", "fit", "kinematics", "interface")
FLOOR = 1e-2  # percent; smaller errors stand on the lower edge of the figure, and fronts do not tell them apart


@dataclass(frozen=True)
class Case:
    """One run: a deck of jobs/ and what it overrides."""

    body: str
    model: str
    spacing: float
    tolerance: float = 1e-6
    solver: str = "cg"
    internal_length: float = 1.0  # over the spacing
    cutoff: float = 2.5  # over the internal length
    correction: str = "appendix_a"
    signs: str = "free"  # of fitted factors
    fit: str = "fresh"  # or "found": left by an earlier run
    kinematics: str = "linear"
    interface: float | None = None  # bar: place along x; plate: half the width of the peridynamic region

    @property
    def name(self) -> str:
        """File name: the main settings, then whatever differs from the defaults."""
        text = f"{self.body}-{self.model}-{self.spacing:g}-{self.solver}-{self.tolerance:.0e}"
        for field, label in (("internal_length", "l"), ("cutoff", "rc"), ("interface", "x")):
            if self.differs(field):
                text += f"-{label}{getattr(self, field):g}"
        return text + "".join(
            f"-{getattr(self, field)}" for field in ("correction", "signs", "fit", "kinematics") if self.differs(field)
        )

    def differs(self, field: str) -> bool:
        """Whether a setting is not the default."""
        return getattr(self, field) != getattr(Case, field)

    @property
    def converged(self) -> Case:
        """The same case without solver error."""
        return replace(self, solver="cg", tolerance=CONVERGED)

    @property
    def overrides(self) -> list[str]:
        """What ``--set`` gets."""
        pairs = {
            "mesh.spacing": self.spacing,
            "solver.kind": self.solver,
            "solver.tolerance": self.tolerance,
            "output.fields": "false",
            "output.figures": "false",
        }
        if self.model != "fe":
            pairs["peridynamics.internal_length"] = round(self.internal_length * self.spacing, 12)
            pairs["peridynamics.cutoff_radius"] = round(self.cutoff * self.internal_length * self.spacing, 12)
            pairs["peridynamics.surface_correction"] = self.correction
            pairs["peridynamics.kinematics"] = self.kinematics
        if self.correction == "fitted":
            pairs["peridynamics.signs"] = self.signs
            if (self.body, self.model) != ("plate", "paper"):  # whose ends are elements
                pairs["loads"] = _tractions(FORCES[self.body])
        if self.model in COUPLED:
            pairs["coupling.kind"] = "exact" if self.correction == "fitted" else self.model
            if self.interface is not None:
                pairs |= _corners(self.body, self.interface)
        return [f"{name}={value}" for name, value in pairs.items()]


def _tractions(force):
    """Loads of both ends in balance with a uniform stress, in place of body forces over a layer of cells."""
    pulls = (("x+", force), ("x-", -force))
    return "[" + ",".join(f'{{kind="traction",face="{face}",total=[{f},0.0,0.0]}}' for face, f in pulls) + "]"


def _corners(body, interface):
    """Corners of the regions that move with the interface."""
    _, y, z = SIDES[body]
    if body == "bar":
        return {"regions.elements.upper": [interface, y, z], "regions.bonds.lower": [interface, -y, -z]}
    band = interface - 0.6  # 3, 6 or 12 cells
    return {
        "regions.elements_left.upper": [-interface, y, z],
        "regions.elements_right.lower": [interface, -y, -z],
        "regions.band_left.lower": [-interface, -y, -z],
        "regions.band_left.upper": [-band, y, z],
        "regions.band_right.lower": [band, -y, -z],
        "regions.band_right.upper": [interface, y, z],
        "regions.hole.lower": [-band, -y, -z],
        "regions.hole.upper": [band, y, z],
    }


def make_series(quick):
    """Return the cases of each series, {title: cases}."""
    spacings = (0.2, 0.1) if quick else (0.2, 0.1, FINE)
    models = ("fe", "pd", "paper", "paper_a")

    def base(body, model, spacing):
        # the plate's interfaces at 2 do not lie between cells of 0.2
        shifted = body == "plate" and model in COUPLED and spacing == 0.2
        return Case(body, model, spacing, interface=2.1 if shifted else None)

    def vary(field, values, *where):
        return [replace(case, **{field: value}) for case in where for value in values]

    series = {}
    for body in ("bar", "plate"):
        coarse = [base(body, "pd", 0.1), base(body, "paper", 0.1)]
        fine = [] if quick else [base(body, "pd", FINE), base(body, "paper", FINE)]
        # of the fine plate, 67 million bonds all over or 30 million at the hole, only what a statement needs
        some, more = (fine, fine) if body == "bar" else ([], fine[1:])
        lengths, widths = (0.75, 1.0, 1.25, 1.5), (4.0, 2.5, None, -2.5) if body == "bar" else (1.0, 1.5, None, 3.0)
        exact = vary("tolerance", TOLERANCES, *coarse, *more)
        relaxed = [replace(case, solver="adr") for case in exact if case.spacing > FINE]
        if some:  # relaxation at full size takes minutes
            relaxed += [
                *vary("tolerance", (0.001, 1e-06), replace(some[0], solver="adr")),
                replace(some[1], solver="adr"),
            ]
        short = [replace(case, model="paper_a", internal_length=0.75) for case in (coarse[1], *more[-1:])]
        series |= {
            f"{body}: coupling and spacing": [base(body, model, spacing) for model in models for spacing in spacings],
            f"{body}: internal length": vary("internal_length", lengths, *coarse, *some),
            f"{body}: cutoff radius": vary("cutoff", (2.0, 2.5, 3.0), *coarse, *some),
            f"{body}: surface correction": _corrections(
                [base(body, model, spacing) for model in ("pd", "paper") for spacing in spacings]
            )
            + vary("internal_length", lengths, replace(coarse[0], correction="none")),
            f"{body}: size of the peridynamic region": vary("interface", widths, coarse[1], *more[-1:]),
            f"{body}: kinematics": vary("kinematics", ("linear", "finite"), *coarse, *some),
            f"{body}: short bonds, reading A, a small region": vary("interface", widths[:3], *short),
            f"{body}: solver and tolerance": exact + relaxed,
        }
    return series


def _corrections(cases):
    """Every correction of some cases; fitted factors with both signs, and each fit counted as well as found."""
    found = []
    for case in cases:
        found += [replace(case, correction=name) for name in ("appendix_a", "none", "virial")]
        if 2 * SIDES[case.body][2] > 1.5 * case.spacing:  # bodies one cell thick have no fit
            found += [
                replace(case, correction="fitted", signs=signs, fit=fit)
                for signs in ("free", "bounded")
                for fit in ("fresh", "found")
            ]
    return found


def reference_case(quick):
    """The finest answer for the plate, which has no closed form."""
    return Case("plate", "fe", 0.05 if quick else 0.025, tolerance=1e-8)


def mode(case) -> str:
    """Return the correction of a case, one of ``MODES``."""
    return "fitted, positive" if case.correction == "fitted" and case.signs == "bounded" else case.correction
