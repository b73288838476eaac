"""How far finite elements turned."""

import math

import numpy as np
import pytest

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.measure.rotations import describe_rotation, largest_rotation
from support.bodies import make_scene


@pytest.mark.parametrize("degrees", [0.0, 1.0, 10.0, 90.0, 170.0])
def test_a_rigid_rotation_is_found_exactly(degrees):
    """About any axis; a uniform strain is none."""
    discretization = discretize(make_scene((3, 2, 2), 2))
    x = discretization.mesh.nodes[discretization.node_number >= 0]
    axis, angle = np.array([2.0, -1.0, 2.0]) / 3.0, math.radians(degrees)
    cross = np.cross(np.eye(3), axis)
    turn = np.eye(3) - math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
    assert math.degrees(largest_rotation(discretization, x @ turn.T - x)) == pytest.approx(degrees, abs=1e-9)
    assert largest_rotation(discretization, 1e-3 * x) == 0.0


def test_the_warning_names_angle_and_strain():
    """1 - cos of 10 degrees is 1.5 %."""
    text = describe_rotation(math.radians(10.0))
    assert "10 degrees" in text
    assert "1.5 %" in text
