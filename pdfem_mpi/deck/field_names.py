"""The fields that a deck may ask for by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pdfem_mpi.deck.table import Problem, did_you_mean, show

#: Strain and stress, and what follows from them: at peridynamic points, and as means of the cells of elements.
MECHANICAL_FIELDS = (
    "strain",
    "stress",
    "principal_strains",
    "principal_stresses",
    "principal_axes",
    "von_mises",
    "energy_density",
)
#: Of elements at their eight Gauss points.
GAUSS_FIELDS = ("strain_at_gauss_points", "stress_at_gauss_points")
#: All of them, in the order in which they are written.
FIELDS = ("displacement", "damage", *MECHANICAL_FIELDS, *GAUSS_FIELDS)


def is_list_of_names(value: Any) -> bool:
    """Whether a value of the deck is a list of texts."""
    return isinstance(value, tuple | list) and all(isinstance(name, str) for name in value)


def field_problems(key: str, names: Sequence[str], known: Sequence[str] = FIELDS) -> list[Problem]:
    """What is wrong with the fields that ``key`` names."""
    problems = []
    for name in dict.fromkeys(name for name in names if name not in known):
        hint = did_you_mean(name, known) or f" The fields are {', '.join(known)}."
        problems.append(Problem(key, f"has {show(name)}, which is not a field.{hint}"))
    return problems
