"""Gauss's quadrature and steps of one ratio, with the same digits on every processor."""

import functools
import math

import numpy as np

#: Newton's steps from a guess that is right to two digits or more.
STEPS = 8


@functools.cache
def gauss_legendre(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes in rising order and weights of the rule of n points on (-1, 1), float64, shape (n,)."""
    nodes, weights = np.zeros(n), np.zeros(n)
    for k in range((n + 1) // 2):
        x = math.cos(math.pi * (k + 0.75) / (n + 0.5))
        for _ in range(STEPS):
            value, slope = _legendre(n, x)
            x -= value / slope
        if 2 * k + 1 == n:
            x = 0.0
        slope = _legendre(n, x)[1]
        nodes[n - 1 - k], nodes[k] = x, -x
        weights[n - 1 - k] = weights[k] = 2.0 / ((1.0 - x * x) * slope * slope)
    nodes.flags.writeable = weights.flags.writeable = False
    return nodes, weights


def in_steps(first: float, last: float, n: int) -> list[float]:
    """Numbers from the first to the last, n >= 2, each the one before times a ratio."""
    ratio = last / first
    return [first * ratio ** (k / (n - 1)) for k in range(n)]


def _legendre(n: int, x: float) -> tuple[float, float]:
    """Legendre's polynomial of degree n >= 1 and its slope, at a place within (-1, 1)."""
    before, value = 1.0, x
    for degree in range(2, n + 1):
        before, value = value, ((2 * degree - 1) * x * value - (degree - 1) * before) / degree
    return value, n * (x * value - before) / (x * x - 1.0)
