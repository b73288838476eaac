"""One rank's equations: constants, unknowns, forces, loads, parts of the body."""
