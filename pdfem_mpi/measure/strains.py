"""How far elements in finite kinematics are deformed: they turn freely, but not every strain can be trusted.

The law of St Venant and Kirchhoff is exact for small strains. Beyond them it parts from the bonds: pulled along one
axis without contraction its stress exceeds theirs by about 1.1 times the strain. Compressed below 1 / sqrt(3) of its
length it gives way, and an element that is turned inside out has no meaning at all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.finite_elements.element_forces import measured
from pdfem_mpi.finite_elements.elements import TurningElements
from pdfem_mpi.model.model import Model
from pdfem_mpi.parallel.comm import agree, largest

#: The run warns of larger strains: stresses of elements and of bonds then differ by a tenth.
WARNING_STRAIN = 0.1


@dataclass(frozen=True)
class Deformation:
    """Of the elements of the whole body; the same on all ranks.

    Attributes
    ----------
    volume_ratio : float
        Smallest ``det F``; not positive where an element is turned inside out.
    strain : float
        Largest ``|E|``, the root of the sum of the squares of Green's strains.
    place : str
        Middle at rest of the element that is turned inside out, or of the one strained most if that is beyond
        `WARNING_STRAIN`; in the deck's units.
    """

    volume_ratio: float
    strain: float
    place: str

    @property
    def warning(self) -> str:
        """A sentence about strains that cannot be trusted; empty where there are none."""
        if not self.strain > WARNING_STRAIN:
            return ""
        return (
            f"warning: finite elements are strained by up to {100.0 * self.strain:.3g} %, the one about {self.place} "
            "most. Their law is that of small strains (of any rotation), and bonds answer otherwise: describe what "
            "strains that much by peridynamics, or load less."
        )

    @property
    def refusal(self) -> str:
        """A sentence about elements turned inside out; empty where there are none."""
        if self.volume_ratio > 0.0:
            return ""
        return (
            f"the finite element about {self.place} is turned inside out (volume now over volume at rest: "
            f"{self.volume_ratio:.3g}): no equilibrium of this kind has a meaning. Load less, in smaller steps, or use "
            "smaller cells where it is crushed."
        )


def measure_elements(model: Model, u: np.ndarray) -> Deformation | None:
    """How far the elements are deformed; None for elements in linear kinematics, or none at all. Collective.

    Parameters
    ----------
    u : float64, shape (n_unknowns,), dimension length
    """
    if not (model.elements and model.elements.finite):
        return None
    u_nodes = np.zeros((len(model.nodes.number), 3))
    u_nodes[: model.nodes.n_owned] = model.unknowns.of_nodes(u)
    model.nodes.halo.scatter_forward(u_nodes)
    found = [(part, *measured(part, u_nodes)[1:]) for part in model.elements.turning]
    extremes = [[-ratio.min(initial=np.inf), strain.max(initial=0.0)] for _, ratio, strain in found]
    least, strain = largest(model.comm, np.array(extremes).max(axis=0)).tolist()
    place, inside_out = "", not least < 0.0
    if inside_out or strain > WARNING_STRAIN:
        chosen = [~(ratio > -least) if inside_out else strains == strain for _, ratio, strains in found]
        texts = [text for (part, _, _), rows in zip(found, chosen, strict=True) for text in _places(model, part, rows)]
        place = min(agree(model.comm, sorted(texts)[:1]))
    return Deformation(-least, strain, place)


def _places(model: Model, part: TurningElements, chosen: np.ndarray) -> list[str]:
    """Middles of the chosen elements at rest, in the deck's units."""
    units = model.units
    middles = model.nodes.x[part.connectivity[chosen]].mean(axis=1) * units.length + units.origin
    return [f"({', '.join(f'{c:.6g}' for c in middle)})" for middle in middles]
