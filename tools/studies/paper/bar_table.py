"""The paper's bar (section 4.1) at full size in all its models: the table of docs/paper_bar.md."""

from __future__ import annotations

import tempfile
from pathlib import Path

from tools.studies.series import run_deck, summary_of, table

CASES = (
    ("finite elements", "bar_fe.toml", []),
    ("peridynamics, appendix A", "bar_pd.toml", []),
    ("coupled, reading B", "bar_tension_relaxed.toml", []),
    ("coupled, reading A", "bar_tension_relaxed.toml", ["coupling.kind=paper_a"]),
)
COLUMNS = (
    ("u(4.975) / 1e-3 in", lambda s: f"{1e3 * s['probes']['end_displacement']:.4f}"),
    ("end error", lambda s: f"{s['probes']['end_error_percent']:+.2f} %"),
    ("jump / (eps Delta)", lambda s: _number(s, "interface_jump", "+.3f")),
    ("E/E0 (FE, PD)", lambda s: _pair(s, "modulus_ratio", ".4f")),
    ("nu (FE, PD)", lambda s: _pair(s, "poissons_ratio", ".4f")),
    ("evaluations", lambda s: f"{s['solve']['evaluations']:,}"),
    ("net force, moment", lambda s: f"{s['balance']['force']:.0e}, {s['balance']['moment']:.0e}"),
    ("seconds (solve)", lambda s: f"{s['seconds']['solve']:.1f}"),
)


def _number(summary, name, form):
    value = summary["probes"].get(name)
    return "-" if value is None else format(value, form)


def _pair(summary, name, form):
    return ", ".join(_number(summary, f"{name}_{model}", form) for model in ("finite_elements", "peridynamics"))


def bar_table(options: list[str]) -> list[str]:
    """Run all models on two ranks, about three minutes on two cores; lines of the table."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, deck, settings) in enumerate(CASES):
            out = Path(folder) / str(number)
            run_deck(deck, settings, out, "-n", "2", *options)
            rows.append([name, *(show(summary_of(out)) for _, show in COLUMNS)])
    return table(["model", *(name for name, _ in COLUMNS)], rows)
