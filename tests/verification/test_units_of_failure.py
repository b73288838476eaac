"""Bodies break alike in all units and everywhere: the same bonds in the same order, and fields of the same bits.

Batches of breaks multiply what two runs differ by, some five times each; so nothing may differ. Lengths times a power
of two change no bit of anything; other units and places are rounded away (`body.model_units`).
"""

import numpy as np
import pytest

from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.programs import Ramp
from support.failing import followed, numbers, strip
from support.transformed import Transform

TRANSFORMS = {
    "powers of two": Transform(length=2.0**-30, stress=2.0**20),
    "other units": Transform(length=3.7e-3, stress=6895.0),
    "elsewhere": Transform(length=1.0 / 3.0, shift=(1e6 / 3.0,) * 3),
}
COUPLED = {"elements": 2, "cells": (12, 6, 2)}
BODIES = {
    "bonds": {},
    "coupled": COUPLED,
    "finite": {"kinematics": "finite"},
    "energy control": {"control": "energy"},
    "coupled, finite": COUPLED | {"kinematics": "finite"},
    "ramp": {"solver": "adr", "stepping": Ramp(kind="ramp", increment=1e-3, end_reaction=0.3, report_every=20)},
}


def by_toughness(scene):
    """With a critical stretch that is worked out from a length and two moduli, and stiffer ends."""
    soft = Material(youngs_modulus=1000.0, fracture_energy=0.004)
    stiff = soft.model_copy(update={"youngs_modulus": 1300.0})
    regions = [r.model_copy(update={"material": "stiff"}) if r.name == "left" else r for r in scene.regions]
    return scene.model_copy(update={"material": soft, "materials": {"stiff": stiff}, "regions": tuple(regions)})


def same_bits(scene, transform, folder):
    """The rows' broken bonds, and all bits of broken bonds and displacements in model units."""
    here, there = followed(scene), followed(transform.scene(scene, folder))
    assert here.failure.count > 100
    told = [[{n: row[n] for n in row if n != "elements"} for row in map(numbers, run.rows)] for run in (here, there)]
    assert told[0] == told[1]
    np.testing.assert_array_equal(here.failure.broken_pairs(), there.failure.broken_pairs())
    np.testing.assert_array_equal(here.body.state.u, there.body.state.u)


@pytest.mark.parametrize("kind", TRANSFORMS)
def test_a_strip_breaks_alike_in_all_units_and_everywhere(kind, tmp_path):
    """Two materials, whose bonds break by their fracture energy, in load control."""
    same_bits(by_toughness(strip(cells=(7, 5, 1))), TRANSFORMS[kind], tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("kind", TRANSFORMS)
@pytest.mark.parametrize("body", BODIES)
def test_bodies_break_alike_in_all_units_and_everywhere(body, kind, tmp_path):
    same_bits(strip(**BODIES[body]), TRANSFORMS[kind], tmp_path)
