"""Formulas of a deck: values by hand, and everything that is no formula."""

import math

import numpy as np
import pytest

from pdfem_mpi.deck.formulas import FUNCTIONS, formula_problems, names_in
from pdfem_mpi.model import formula_values
from pdfem_mpi.model.formula_values import evaluate

AT = {"x": np.array([0.5, -2.0]), "y": np.array([3.0, 0.25]), "z": np.array([1.0, 7.0]), "f": 0.5}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1e-3 * y * f", lambda x, y, z, f: 1e-3 * y * f),
        ("-z", lambda x, y, z, f: -z),
        ("2*x^2 - y**2/4", lambda x, y, z, f: 2 * x * x - y * y / 4),
        ("(cos(f*pi)-1)*y - sin(f)*z", lambda x, y, z, f: (math.cos(f * math.pi) - 1) * y - math.sin(f) * z),
        ("max(x, 0) + atan2(y, z) + sqrt(abs(x))", lambda x, y, z, f: max(x, 0) + math.atan2(y, z) + math.sqrt(abs(x))),
        ("+1.5", lambda x, y, z, f: 1.5),
        ("e**log(2)", lambda x, y, z, f: 2.0),
    ],
)
def test_values(text, expected):
    assert not formula_problems("x", text)
    found = np.broadcast_to(evaluate(text, AT), (2,))
    by_hand = [expected(AT["x"][k], AT["y"][k], AT["z"][k], AT["f"]) for k in range(2)]
    np.testing.assert_allclose(found, by_hand, rtol=1e-15)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1e-3 * w", "names w, which is unknown. It may name x, y, z, f, pi, e"),
        ("sine(x)", "calls sine, which is unknown. Did you mean sin"),
        ("sin", "names sin, which is unknown"),
        ("sin(x, y)", "gives sin 2 numbers, and it takes 1"),
        ("x +", "is not a formula"),
        ("", "is not a formula"),
        ("x if y else z", "has what no formula may have"),
        ("__import__('os')", "calls __import__, which is unknown"),
        ("x.real", "has what no formula may have"),
        ("[x for x in y]", "has what no formula may have"),
        ("(lambda: 1)()", "has what no formula may have"),
        ("'a' * 9", "has what no formula may have"),
        ("True", "has what no formula may have"),
        ("1e200", "has a number beyond 1e+100"),
        ("9" * 600, "has 600 letters, and at most 500 are read"),
        ("(" * 300 + "x" + ")" * 300, "has 601 letters"),
    ],
)
def test_what_is_no_formula_is_named(text, says):
    (problem,) = formula_problems("x", text)
    assert says in problem.text


def test_a_deep_formula_has_its_value():
    """As deep as 500 letters allow: neither the reading nor the value runs out of stack."""
    text = "-" * 451 + "x"
    assert not formula_problems("x", text)
    np.testing.assert_array_equal(evaluate(text, AT), -AT["x"])


def test_what_is_not_finite_comes_out_as_such():
    """The place is known where the formula is used, which says it."""
    assert np.isinf(evaluate("1 / (x - 0.5)", AT)[0])
    assert np.isnan(evaluate("sqrt(x)", AT)[1])
    assert np.isinf(evaluate("1 / 0", AT))
    assert np.isinf(evaluate("9**9**9", AT))


def test_names():
    """Those of variables; every function has its meaning."""
    assert set(FUNCTIONS) == set(formula_values.FUNCTIONS)
    assert names_in("x * f + pi * sin(z)") == {"x", "f", "z"}
    assert names_in("x * w") == names_in("x *") == set()
