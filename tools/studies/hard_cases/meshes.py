#!/usr/bin/env python3
"""Write the meshes of jobs/hard/meshes: distorted bars, and blocks that hang together by little.

Usage: tools/studies/hard_cases/meshes.py [FOLDER]

The files are part of the repository; this tells how they were made. Abaqus text with 17 digits; jitter is seeded.
"""

import sys
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).resolve().parents[3] / "jobs" / "hard" / "meshes"
CELLS = (10, 4, 4)
JITTER, GRADING, ASPECT, SEED = 0.15, 20.0, 10.0, 8


def grid(counts):
    """Nodes and hexahedra of a box of unit cubes."""
    nx, ny, nz = counts
    number = np.arange((nx + 1) * (ny + 1) * (nz + 1)).reshape(nx + 1, ny + 1, nz + 1)
    nodes = np.argwhere(number >= 0).astype(float)
    low = [number[:-1, :-1, :-1], number[1:, :-1, :-1], number[1:, 1:, :-1], number[:-1, 1:, :-1]]
    high = [number[:-1, :-1, 1:], number[1:, :-1, 1:], number[1:, 1:, 1:], number[:-1, 1:, 1:]]
    return nodes, np.stack([corner.reshape(-1) for corner in low + high], axis=1)


def jittered(counts, amount, seed):
    """Nodes moved by up to ``amount`` of an edge along each axis; on a face of the box only within it."""
    nodes, cells = grid(counts)
    moves = np.random.default_rng(seed).uniform(-amount, amount, nodes.shape)
    moves[(nodes == 0.0) | (nodes == np.array(counts))] = 0.0
    return nodes + moves, cells


def graded(counts, ratio):
    """Edges along x that grow by ``ratio`` from the first cell to the last, from 0.2 on."""
    nodes, cells = grid(counts)
    edges = 0.2 * ratio ** (np.arange(counts[0]) / (counts[0] - 1))
    nodes[:, 0] = np.concatenate([[0.0], np.cumsum(edges)])[nodes[:, 0].astype(int)]
    return nodes, cells


def sheared(counts):
    """Every layer shifted along y by its height: angles of 45 degrees."""
    nodes, cells = grid(counts)
    nodes[:, 1] += nodes[:, 2]
    return nodes, cells


def stretched(counts, ratio):
    """Cells ``ratio`` times longer than wide."""
    nodes, cells = grid(counts)
    nodes[:, 0] *= ratio
    return nodes, cells


def blocks(shift):
    """Two blocks of 3 x 3 x 3 cells that share an edge, and with ``shift`` = 1 one cell between them."""
    nodes, cells = grid((7, 7, 3))
    centre = nodes[cells].mean(axis=1)
    x, y, z = centre.T
    if shift:
        chosen = ((x < 3) & (y < 3)) | ((x > 4) & (y < 3)) | ((x > 3) & (x < 4) & (y > 1) & (y < 2) & (z > 1) & (z < 2))
    else:
        chosen = ((x < 3) & (y < 3)) | ((x > 3) & (x < 6) & (y > 3) & (y < 6))
    chosen &= (y < 3) if shift else (x < 6)
    used, inverse = np.unique(cells[chosen], return_inverse=True)
    return nodes[used], inverse.reshape(-1, 8)


def write(path, nodes, cells, corner=None):
    """Write Abaqus text; ``corner`` names a node as the set CORNER."""
    lines = ["*NODE"] + [f"{k}, " + ", ".join(repr(float(c)) for c in x) for k, x in enumerate(nodes, 1)]
    lines += ["*ELEMENT, TYPE=C3D8, ELSET=BODY"]
    lines += [f"{k}, " + ", ".join(str(n + 1) for n in row) for k, row in enumerate(cells.tolist(), 1)]
    if corner is not None:
        lines += ["*NSET, NSET=CORNER", str(corner + 1)]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def main():
    """Write all meshes."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    write(folder / "jittered.inp", *jittered(CELLS, JITTER, SEED))
    write(folder / "graded.inp", *graded(CELLS, GRADING))
    write(folder / "sheared.inp", *sheared(CELLS))
    write(folder / "aspect.inp", *stretched(CELLS, ASPECT))
    write(folder / "hinge.inp", *blocks(1))
    write(folder / "edge.inp", *blocks(0))
    write(folder / "one_node.inp", *grid((3, 3, 3)), corner=0)


if __name__ == "__main__":
    main()
