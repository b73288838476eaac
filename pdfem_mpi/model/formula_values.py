"""Values of a deck's formulas at places and load factors."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from pdfem_mpi.deck.formulas import CONSTANTS, tree_of


def _one_by_one(function: Callable[..., float], beside: np.ufunc) -> Callable[..., Any]:
    """A function of the C library, number by number: those of numpy have other last digits on other processors.

    Where the C library refuses, the value is not finite, and numpy's.
    """

    def of_numbers(*values: float) -> float:
        try:
            return function(*values)
        except (ValueError, OverflowError):
            return float(beside(*values))

    each = np.frompyfunc(of_numbers, beside.nin, 1)
    return lambda *values: np.asarray(each(*values), np.float64)[()]


#: What the names of `deck.formulas.FUNCTIONS` stand for.
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sin": _one_by_one(math.sin, np.sin), "cos": _one_by_one(math.cos, np.cos), "tan": _one_by_one(math.tan, np.tan),
    "asin": _one_by_one(math.asin, np.arcsin), "acos": _one_by_one(math.acos, np.arccos),
    "atan": _one_by_one(math.atan, np.arctan), "atan2": _one_by_one(math.atan2, np.arctan2),
    "sinh": _one_by_one(math.sinh, np.sinh), "cosh": _one_by_one(math.cosh, np.cosh),
    "tanh": _one_by_one(math.tanh, np.tanh), "exp": _one_by_one(math.exp, np.exp), "log": _one_by_one(math.log, np.log),
    "sqrt": np.sqrt, "abs": np.abs, "min": np.minimum, "max": np.maximum,
}  # fmt: skip
BINARY = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: np.divide,
    ast.Pow: _one_by_one(math.pow, np.power),
}  # fmt: skip
UNARY = {ast.UAdd: operator.pos, ast.USub: operator.neg}


def evaluate(text: str, values: Mapping[str, Any]) -> np.ndarray:
    """The value of a sound formula; what is not finite comes out as such, without a word.

    Parameters
    ----------
    values : dict of floats or float64 arrays of one shape
        Of all `deck.formulas.VARIABLES`.
    """
    with np.errstate(all="ignore"):
        return np.asarray(_value(tree_of(text), values), np.float64)


def _value(node: ast.expr, values: Mapping[str, Any]) -> Any:
    if isinstance(node, ast.Constant):
        return np.float64(node.value)
    if isinstance(node, ast.Name):
        return CONSTANTS.get(node.id, values.get(node.id))
    if isinstance(node, ast.BinOp):
        return BINARY[type(node.op)](_value(node.left, values), _value(node.right, values))
    if isinstance(node, ast.UnaryOp):
        return UNARY[type(node.op)](_value(node.operand, values))
    return FUNCTIONS[node.func.id](*(_value(argument, values) for argument in node.args))
