"""RunOptions to equilibrium; each is a function ``solve(forces, state, case, ...) -> Convergence``."""
