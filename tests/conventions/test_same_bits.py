"""What has other last digits on other processors stays out of the modules on the path of results.

LAPACK and BLAS choose their loops by the processor, numpy those of its elementary functions. `kernels.dense`,
`kernels.banded` and the C library take their place. Sums, roots, quotients and what is done number by number have one
result by IEEE 754.
"""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "pdfem_mpi"
#: Libraries that call LAPACK.
LIBRARIES = ("numpy.linalg", "scipy.linalg", "scipy.sparse.linalg", "scipy.optimize", "scipy.interpolate")
#: Of numpy: what calls BLAS or LAPACK, and what has loops of its own for each kind of processor.
OF_NUMPY = {
    "linalg", "dot", "vdot", "matmul", "inner", "tensordot", "einsum", "convolve", "correlate", "polyfit", "polynomial",
    "geomspace", "logspace", "cov", "corrcoef", "roots",
    "sin", "cos", "tan", "arcsin", "arccos", "arctan", "arctan2", "sinh", "cosh", "tanh", "arcsinh", "arccosh",
    "arctanh", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "power", "float_power", "cbrt",
}  # fmt: skip
DRAWING = "draws; no number of a result passes through it"
OF_SPARSE = "products of sparse matrices: loops of scipy, compiled for one processor, in the order of the entries"
EXCEPTIONS = {
    ("body.softening", "scipy.optimize"): "halves an interval, number by number, and calls no LAPACK",
    ("body.traction_opening", "scipy.optimize"): "what it finds is rounded to three digits",
    ("mesh.generators", "@"): OF_SPARSE,
    ("model.forces", "dot"): "asks only whether all terms are finite",
    ("model.formula_values", "elementary"): "values that are not finite, where the C library refuses",
    ("results.camera", "@"): DRAWING,
    ("results.camera", "linalg"): DRAWING,
    ("results.pictures", "linalg"): DRAWING,
    ("results.sketch", "linalg"): DRAWING,
    ("results.whole_body", "einsum"): DRAWING,
    ("results.whole_body", "log10"): DRAWING,
}
ELEMENTARY = {
    "sin",
    "cos",
    "tan",
    "arcsin",
    "arccos",
    "arctan",
    "arctan2",
    "sinh",
    "cosh",
    "tanh",
    "exp",
    "log",
    "power",
}


def module_name(path):
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts)


def forbidden(tree):
    """What a module has of it, with lines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.MatMult):
            yield "@", node.lineno
        if isinstance(node, ast.Attribute) and node.attr in OF_NUMPY and ast.unparse(node.value) in ("np", "numpy"):
            yield node.attr, node.lineno
        if isinstance(node, ast.Attribute) and node.attr == "dot" and ast.unparse(node.value) != "np":
            yield "dot", node.lineno
        is_sort = isinstance(node, ast.Call) and ast.unparse(node.func).endswith("argsort")
        if is_sort and not any(word.arg == "kind" for word in node.keywords):
            yield "argsort", node.lineno  # the order of equal keys is chosen by the processor
        if isinstance(node, ast.Import | ast.ImportFrom):
            if "reverse_cuthill_mckee" in {alias.name for alias in node.names}:
                yield "reverse_cuthill_mckee", node.lineno
            names = [alias.name for alias in node.names]
            full = (
                names if isinstance(node, ast.Import) else [node.module, *(f"{node.module}.{name}" for name in names)]
            )
            for library in LIBRARIES:
                if any(name == library or name.startswith(library + ".") for name in full):
                    yield library, node.lineno


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=module_name)
def test_results_do_not_pass_through_loops_chosen_by_the_processor(path):
    module = module_name(path)
    allowed = {what for name, what in EXCEPTIONS if name == module}
    allowed |= ELEMENTARY if "elementary" in allowed else set()
    found = list(forbidden(ast.parse(path.read_text(encoding="utf-8"))))
    wrong = [f"line {line}: {what}" for what, line in found if what not in allowed]
    assert not wrong, wrong
    unused = allowed - ELEMENTARY - {"elementary"} - {what for what, _ in found}
    assert not unused, f"exceptions without use: {unused}"


@pytest.mark.parametrize(
    "source",
    ["import numpy.linalg", "from scipy import linalg", "from scipy.sparse.linalg import splu", "c = a @ b", "a @= b",
     "np.linalg.solve(a, b)", "np.exp(x)", "a.dot(b)", "np.argsort(x)",
     "from scipy.sparse.csgraph import reverse_cuthill_mckee"],
)  # fmt: skip
def test_the_test_sees_them(source):
    assert list(forbidden(ast.parse(source)))
