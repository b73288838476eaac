"""Elements: nodes, stiffness, forces, the overlap."""
