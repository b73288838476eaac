"""Quasi-static failure by peridynamics coupled to finite elements, on MPI ranks.

After Kilic and Madenci, "Coupling of peridynamic theory and the finite element method",
J. Mech. Mater. Struct. 5(5), 2010 ("the paper" in every docstring).
"""

__version__ = "0.1.0"
