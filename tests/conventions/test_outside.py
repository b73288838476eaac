"""Walls outside the package: what tools and tests may import, and how much stands directly in tools/."""

import ast
import sys
from pathlib import Path

import pytest

import pdfem_mpi

ROOT = Path(__file__).resolve().parents[2]
TOOLS, TESTS = ROOT / "tools", ROOT / "tests"
LINES_IN_TOOLS = 400
#: Studies may use these, the library of Python, and what stands in tools/studies.
LIBRARIES = {"numpy", "matplotlib", "meshio", "psutil"}
#: Tests on ranks are started as `tools/check` starts them.
STAGES = "tools.stages"
#: Tests of tools, and of the hard cases; no others import tools.
MAY_IMPORT_TOOLS = TESTS / "unit" / "tools"


def is_python(path):
    """Whether a file is a script or a module of Python."""
    if path.suffix == ".py":
        return True
    return path.is_file() and not path.suffix and path.read_text(encoding="utf-8").startswith("#!/usr/bin/env python3")


def python_files(folder):
    return [path for path in sorted(folder.rglob("*")) if "__pycache__" not in path.parts and is_python(path)]


def imports_of(path):
    """Full names of all modules that a file imports, inside functions too."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(node.module)
    return found


def name(path):
    return path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("path", python_files(TOOLS), ids=name)
def test_tools_import_no_tests(path):
    """What a study needs of tests it takes from their reports."""
    folders = {folder.name for folder in TESTS.iterdir() if folder.is_dir()} | {"tests", "conftest"}
    assert not {module for module in imports_of(path) if module.split(".")[0] in folders}


@pytest.mark.parametrize("path", python_files(TOOLS / "studies"), ids=name)
def test_studies_use_public_names(path):
    """Of the package those of ``__all__``, and else studies, Python's own library and a few others."""
    inside, allowed = [], LIBRARIES | set(sys.stdlib_module_names) | {"tools"}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import | ast.ImportFrom):
            modules = [a.name for a in node.names] if isinstance(node, ast.Import) else [node.module]
            assert all(module.split(".")[0] in allowed | {"pdfem_mpi"} for module in modules), modules
            tools = [module for module in modules if module.split(".")[0] == "tools" and module != STAGES]
            assert all(module.startswith("tools.studies") for module in tools), tools
            names = [alias.name for alias in node.names]
            if modules[0] != "pdfem_mpi" and modules[0].split(".")[0] == "pdfem_mpi":
                inside += names
            elif modules == ["pdfem_mpi"] and isinstance(node, ast.ImportFrom):
                inside += set(names) - set(pdfem_mpi.__all__)
    assert not inside


@pytest.mark.parametrize("path", python_files(TESTS), ids=name)
def test_tests_import_no_tools(path):
    """But for those whose subject they are."""
    if path.is_relative_to(MAY_IMPORT_TOOLS):
        return
    assert not {module for module in imports_of(path) if module.split(".")[0] == "tools"}


@pytest.mark.parametrize("path", python_files(TESTS), ids=name)
def test_tests_on_ranks_are_where_stages_look_for_them(path):
    """A mark elsewhere takes a test out of the serial stage, and no other stage collects it."""
    if not path.is_relative_to(TESTS / "mpi") and not path.is_relative_to(TESTS / "hard"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        attributes = {ast.unparse(node) for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
        assert "pytest.mark.mpi" not in attributes


def test_directly_in_tools_is_what_a_contributor_types():
    files = {path.name: path for path in TOOLS.iterdir() if path.is_file()}
    assert set(files) == {"run", "check", "environment", "stages.py"}
    assert sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files.values()) <= LINES_IN_TOOLS
