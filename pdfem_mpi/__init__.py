"""Quasi-static failure by peridynamics coupled to finite elements, on MPI ranks.

After Kilic and Madenci, "Coupling of peridynamic theory and the finite element method",
J. Mech. Mater. Struct. 5(5), 2010 ("the paper" in every docstring).

The names in ``__all__`` are public; they are loaded when they are first asked for, so that importing the package starts
neither MPI nor a compiler. Everything else may change.
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "Scene": "deck.scene",
    "SceneError": "deck.table",
    "DeckError": "deck.table",
    "read_deck": "deck.toml",
    "write_deck": "deck.toml",
    "RunFolder": "results.run_folder",
    "Simulation": "runs.simulation",
    "run": "runs.interface",
    "resume": "runs.interface",
    "check": "runs.interface",
    "open_run": "runs.interface",
}
#: These load numpy and compiled kernels, which read their settings from the environment once.
_HEAVY = ("results", "runs")

__all__ = [
    "DeckError",
    "RunFolder",
    "Scene",
    "SceneError",
    "Simulation",
    "__version__",
    "check",
    "open_run",
    "read_deck",
    "resume",
    "run",
    "write_deck",
]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for."""
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if home.startswith(_HEAVY):
        import_module(f"{__name__}.system.launcher").prepare_environment()
    found = getattr(import_module(f"{__name__}.{home}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted(__all__)
