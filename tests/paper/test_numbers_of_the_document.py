"""What docs/paper.md tells of small bodies is measured here and told in the report of the tests.

`tools/studies/study paper` takes it from there. That the numbers are right is tested section by section.
"""

import json
import math

import pytest

from support.paper_numbers import paper_numbers


def all_finite(value):
    """Whether all numbers of nested lists and tables are finite."""
    if isinstance(value, dict):
        return all(map(all_finite, value.values()))
    if isinstance(value, list | tuple):
        return all(map(all_finite, value))
    return not isinstance(value, float) or math.isfinite(value)


@pytest.mark.slow  # the coarse form is measured by the default test of the study
@pytest.mark.parametrize("size", ["coarse", "full"])
def test_numbers_of_small_bodies(size, record_property):
    """Stored bonds follow eq. 2 to single precision; the iteration of appendix A converges."""
    numbers = paper_numbers(size == "full")
    record_property(f"paper, {size}", json.dumps(numbers))
    assert all_finite(numbers)
    assert numbers["locality_error"] < 2e-7  # bonds are stored in single precision
    assert numbers["left_20"] < numbers["left_10"] < numbers["left_5"] < numbers["left_0"]
