"""Bonds have one door: how they are stored is known to peridynamics/ and kernels/ alone."""

import ast
import re

import pytest
from conventions.test_layers import MODULES, TREES, begins

INSIDE = ("peridynamics", "kernels")
#: The kernels are compiled there, and by nobody called.
COMPILES = "runs.compilation"
OUTSIDE = [name for name in MODULES if not any(begins(name, folder) for folder in INSIDE)]
#: Reads of the rows of bonds, of how they are stored, and of their kinematics, which a model is asked for.
STORAGE = re.compile(
    r"\bbonds\.(rows|interior|boundary|finite|rows_of_point|rows_at_cluster|added|taken)$|\brows\.(arrays|data)$"
)
#: Where a model answers for them.
ANSWERS = ("model.model", "self.bonds.finite")


def sweeps(module):
    """Names of a module's kernels that take the three arrays of rows."""
    return {
        node.name
        for node in ast.walk(TREES[module])
        if isinstance(node, ast.FunctionDef)
        and {"row_start", "row_offset", "row_data"} <= {argument.arg for argument in node.args.args}
    }


SWEEPS = {f"pdfem_mpi.{name}": found for name in MODULES if begins(name, "kernels") and (found := sweeps(name))}


@pytest.mark.parametrize("module", OUTSIDE)
def test_nobody_else_unpacks_bonds(module):
    """A second law of bonds is one module in peridynamics/ with the methods that others call."""
    wrong = [
        f"line {node.lineno}: {text}"
        for node in ast.walk(TREES[module])
        if isinstance(node, ast.Attribute) and STORAGE.search(text := ast.unparse(node)) and (module, text) != ANSWERS
    ]
    assert not wrong, wrong


@pytest.mark.parametrize("module", [name for name in OUTSIDE if name != COMPILES])
def test_nobody_else_calls_sweeps_over_bonds(module):
    """Kernels that take rows are called by peridynamics/, and Rows are known there."""
    wrong = []
    for node in ast.walk(TREES[module]):
        if isinstance(node, ast.ImportFrom):
            for name in (alias.name for alias in node.names):
                whole = f"{node.module}.{name}" in SWEEPS
                if whole or name in SWEEPS.get(node.module, ()) or node.module == "pdfem_mpi.peridynamics.rows":
                    wrong.append(f"line {node.lineno}: {node.module}.{name}")
    assert not wrong, wrong


def test_the_sweeps_are_found():
    """The rule above would hold of nothing if no kernel took rows."""
    assert {"cut_rows", "fill_rows", "add_densities"} <= set().union(*SWEEPS.values())
    assert "pdfem_mpi.kernels.bond_sweeps" in SWEEPS
