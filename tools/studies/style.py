"""How the figures of studies look: curves are told apart in grey too."""

STYLE = {"axes.grid": True, "grid.color": "#e4e4e4", "axes.axisbelow": True}
#: Colours of Okabe & Ito (2008), with a marker each.
CURVES = (
    ("#0072B2", "o"), ("#D55E00", "s"), ("#009E73", "^"), ("#CC79A7", "D"), ("#56B4E9", "v"), ("#E69F00", "P"),
    ("#000000", "x"), ("#999999", "*"),
)  # fmt: skip
