"""Values of a deck's formulas at places and load factors."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from pdfem_mpi.deck.formulas import CONSTANTS, tree_of

#: What the names of `deck.formulas.FUNCTIONS` stand for.
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
    "atan2": np.arctan2, "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh, "sqrt": np.sqrt, "exp": np.exp,
    "log": np.log, "abs": np.abs, "min": np.minimum, "max": np.maximum,
}  # fmt: skip
BINARY = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: np.divide, ast.Pow: np.power,
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
