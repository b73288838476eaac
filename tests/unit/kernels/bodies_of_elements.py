"""Boxes of elements, and rotations, for the kernels of finite elements."""

import math

import numpy as np

from pdfem_mpi.kernels import hex8


def box(nx=3, ny=2, nz=2, jitter=0.0):
    """Nodes and cells of a box of unit cubes; nodes moved by up to ``jitter``, multiples of 2^-20."""
    shape = (nz + 1, ny + 1, nx + 1)
    k, j, i = np.indices(shape)
    x = np.stack([i, j, k], axis=-1).reshape(-1, 3).astype(float)
    x += np.round(np.random.default_rng(3).uniform(-jitter, jitter, x.shape) * 2**20) / 2**20
    first = np.arange(x.shape[0]).reshape(shape)[:-1, :-1, :-1].ravel()
    r, s, t = ((hex8.REFERENCE_NODES + 1) // 2).astype(int).T
    return x, (first[:, None] + r + (nx + 1) * (s + (ny + 1) * t)).astype(np.int32)


def turn(degrees, axis=(2.0, -1.0, 2.0)):
    """Rotation matrix about an axis."""
    axis, angle = np.array(axis) / np.linalg.norm(axis), math.radians(degrees)
    cross = np.cross(np.eye(3), axis)
    return np.eye(3) - math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
