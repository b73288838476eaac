"""Steps of the preconditioner's cycle, against whole arrays of numpy with the same operations."""

import numpy as np

from pdfem_mpi.kernels import cycle_steps

QUANTUM = 2.0**-40
N, OMEGA, SCALE = 7, 0.7, 2.0**5


def numbers(*shape):
    return np.random.default_rng(3).standard_normal(shape)


def products(blocks, r):
    """``B r`` row by row, in the written order of operations."""
    x, y, z = r.T
    b = blocks.T
    return np.stack(
        [b[0] * x + b[3] * y + b[5] * z, b[3] * x + b[1] * y + b[4] * z, b[5] * x + b[4] * y + b[2] * z], axis=1
    )


def test_the_first_smoothing_starts_from_the_sums():
    sums = np.rint(numbers(N + 2, 3) / QUANTUM).astype(np.int64)
    fixed = np.arange(3 * N) % 5 == 0
    blocks, right, x = numbers(N, 6), np.empty(3 * N), np.empty(3 * N)
    cycle_steps.start_cycle(sums, QUANTUM, fixed, blocks, OMEGA, right, x)
    expected = (sums[:N] * QUANTUM).reshape(-1)
    expected[fixed] = 0.0
    assert (right == expected).all()
    assert (x.reshape(N, 3) == OMEGA * products(blocks, expected.reshape(N, 3))).all()


def test_the_last_smoothing_is_scaled():
    blocks, residual, x = numbers(N, 6), numbers(3 * N), 2.0 * numbers(3 * N)
    correction = np.full((N + 2, 3), 9.0)
    cycle_steps.finish_cycle(blocks, OMEGA, residual, x, SCALE, correction)
    expected = (x.reshape(N, 3) + OMEGA * products(blocks, residual.reshape(N, 3))) * SCALE
    assert (correction[:N] == expected).all()
    assert (correction[N:] == 9.0).all()


def test_nodes_of_the_scene_take_their_corrections_and_blocks():
    places, correction, blocks = np.array([5, 0, 3], np.int32), numbers(N, 3), numbers(3, 6)
    r, z = 3.0 * numbers(3, 3), np.empty((3, 3))
    cycle_steps.correct_nodes(places, correction, blocks, OMEGA, r, z)
    assert (z == correction[places] + OMEGA * products(blocks, r)).all()
