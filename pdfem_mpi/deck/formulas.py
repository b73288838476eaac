"""Formulas of a deck, such as ``"1e-3 * y * f"``: trees of a few known operations, never executed as a program.

``x``, ``y`` and ``z`` are coordinates in the deck's units, ``f`` is the load factor.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator

from pdfem_mpi.deck.table import Problem, did_you_mean, show

LONGEST = 500  # letters of a formula, whose tree is walked by recursion
VARIABLES = ("x", "y", "z", "f")
CONSTANTS = {"pi": math.pi, "e": math.e}
FUNCTIONS = (
    "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "sqrt", "exp", "log", "abs", "min",
    "max",
)  # fmt: skip
OF_TWO = ("atan2", "min", "max")
BINARY, UNARY = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow), (ast.UAdd, ast.USub)


class NoFormula(ValueError):
    """Why a text is no formula: the rest of a sentence."""


def formula_problems(key: str, text: str) -> list[Problem]:
    """What is wrong with a formula."""
    try:
        tree_of(text)
    except NoFormula as error:
        return [Problem(key, f"= {show(text)} {error}")]
    return []


def names_in(text: str) -> set[str]:
    """Variables that a formula names; none of a text that is no formula."""
    try:
        tree = tree_of(text)
    except NoFormula:
        return set()
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)} & set(VARIABLES)


def tree_of(text: str) -> ast.expr:
    """The tree of a formula.

    Raises
    ------
    NoFormula
    """
    if len(text) > LONGEST:
        raise NoFormula(f"has {len(text)} letters, and at most {LONGEST} are read. Shorten it.")
    try:
        tree = ast.parse(text.strip().replace("^", "**"), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise NoFormula("is not a formula. Write one like 1e-3 * y * f, with + - * / ** and brackets.") from None
    for refusal in _refusals(tree):
        raise NoFormula(refusal)
    return tree


def _refusals(node: ast.expr) -> Iterator[str]:
    """Why a tree is no formula; the first reason counts."""
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        if abs(node.value) > 1e100:
            yield "has a number beyond 1e+100. Use a smaller one."
    elif isinstance(node, ast.Name):
        if node.id not in (*VARIABLES, *CONSTANTS):
            known = ", ".join((*VARIABLES, *CONSTANTS))
            hint = did_you_mean(node.id, FUNCTIONS) or f" It may name {known} (f is the load factor)."
            yield f"names {node.id}, which is unknown.{hint}"
    elif isinstance(node, ast.BinOp) and type(node.op) in BINARY:
        yield from _refusals(node.left)
        yield from _refusals(node.right)
    elif isinstance(node, ast.UnaryOp) and type(node.op) in UNARY:
        yield from _refusals(node.operand)
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        name, count = node.func.id, 2 if node.func.id in OF_TWO else 1
        if name not in FUNCTIONS:
            yield f"calls {name}, which is unknown.{did_you_mean(name, FUNCTIONS) or f' Known are {_known()}.'}"
        elif len(node.args) != count:
            yield f"gives {name} {len(node.args)} numbers, and it takes {count}."
        for argument in node.args:
            yield from _refusals(argument)
    else:
        yield f"has what no formula may have. Use numbers, x, y, z, f, pi, e, + - * / ** and {_known()}."


def _known() -> str:
    return ", ".join(FUNCTIONS)
