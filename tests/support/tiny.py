"""A deck of 16 cells, half of them peridynamic, as text: what tests of decks spoil."""

TINY = """
[mesh]
kind = "box"
lower = [0.0, 0.0, 0.0]
upper = [4.0, 2.0, 2.0]
spacing = 1.0
[material]
youngs_modulus = 1000.0
poissons_ratio = 0.25
[[regions]]
name = "fe"
model = "finite_elements"
upper = [2.0, 2.0, 2.0]
[[regions]]
name = "pd"
model = "peridynamics"
lower = [2.0, 0.0, 0.0]
[peridynamics]
kinematics = "linear"
[[supports]]
face = "x-"
x = 0.0
y = 0.0
z = 0.0
[[loads]]
kind = "body_force"
face = "x+"
total = [1.0, 0.0, 0.0]
[solver]
kind = "cg"
"""
