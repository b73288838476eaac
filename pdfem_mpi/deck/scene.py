"""What to simulate: the frozen models behind a deck, and every check that needs no mesh.

A ``Scene`` is complete (defaults included), immutable, and the same object on every rank. Keys of the deck
equal field names. Dimensions are written with force, length and 1; a deck may use any consistent unit system.
Checks within one table are its method ``problems``, checks between tables are listed in ``CHECKS``; both
state their findings as ``Problem``: the key, and the rest of the sentence. ``deck.py`` adds the file's name.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable
from typing import Any, Literal

from pydantic import Field, model_validator

from pdfem_mpi.deck.adaptive import (
    Adaptive,
    check_auto_materials,
    check_auto_references,
    check_auto_regions,
    check_auto_settings,
    with_auto,
)
from pdfem_mpi.deck.cracks import AnyCrack
from pdfem_mpi.deck.loads import (
    Load,
    Support,
    check_mirrored_loads,
    check_mirrored_supports,
    check_references,
    check_sets,
    check_support_references,
    unknown_regions,
)
from pdfem_mpi.deck.materials import (
    BOND_POISSONS_RATIO,
    Interface,
    Material,
    all_materials,
    check_contrast,
    check_material_names,
)
from pdfem_mpi.deck.mechanical_probes import check_energy_release, check_set_probes
from pdfem_mpi.deck.meshes import Mesh
from pdfem_mpi.deck.outputs import (
    Checkpoint,
    Output,
    Probe,
    check_column_names,
    check_damage,
    check_mirrored_bars,
    check_probe_names,
)
from pdfem_mpi.deck.peridynamics import (
    Coupling,
    Peridynamics,
    check_cracks,
    check_cutoff,
    check_fitted,
    check_volumetric,
)
from pdfem_mpi.deck.program_checks import (
    check_events_over_time,
    check_failure,
    check_formulas,
    check_opening,
    check_softening,
    check_something_loads,
    check_stepping_solver,
)
from pdfem_mpi.deck.programs import Events, Solver, Stepping, Steps, with_solver
from pdfem_mpi.deck.regions import (
    Region,
    check_interfaces,
    check_poissons_ratio,
    check_region_materials,
    check_region_names,
    has_model,
)
from pdfem_mpi.deck.restraints import Spring, Tie
from pdfem_mpi.deck.softening import with_defaults
from pdfem_mpi.deck.table import FieldMissing, Problem, Table, Units, key
from pdfem_mpi.deck.temperatures import Temperature, check_temperature


class Scene(Table):
    """What to simulate, complete and frozen; the whole deck.

    Attributes
    ----------
    title : str
        Above figures and tables.

    Raises
    ------
    pydantic.ValidationError
        Value out of range, wrong type, unknown key, or a check of ``CHECKS``. ``deck.parse_deck`` collects
        all of them as plain sentences.
    """

    title: str = key("")
    units: Units = Field(default_factory=Units)
    mesh: Mesh = key(remedy="Add a table [mesh] with lower, upper and spacing.")
    material: Material = key(remedy="Add a table [material] with youngs_modulus.")
    materials: dict[str, Material] = key({})
    interfaces: tuple[Interface, ...] = key(())
    regions: tuple[Region, ...] = key(min_length=1, remedy="Add at least one table [[regions]] with name and model.")
    peridynamics: Peridynamics = Field(default_factory=Peridynamics)
    cracks: tuple[AnyCrack, ...] = key(())
    adaptive: Adaptive | None = key(None)
    coupling: Coupling = Field(default_factory=Coupling)
    loads: tuple[Load, ...] = key(())
    supports: tuple[Support, ...] = key(())
    springs: tuple[Spring, ...] = key(())
    ties: tuple[Tie, ...] = key(())
    temperature: Temperature | None = key(None)
    solver: Solver = Field(default_factory=Solver)
    stepping: Stepping = Field(default_factory=Steps)
    probes: tuple[Probe, ...] = key(())
    output: Output = Field(default_factory=Output)
    checkpoint: Checkpoint = Field(default_factory=Checkpoint)

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, data: Any) -> Any:
        return with_defaults(with_solver(with_auto(data)))

    def problems(self) -> list[Problem]:
        """What ``CHECKS`` find between the tables."""
        return find_problems({name: getattr(self, name) for name in type(self).model_fields})

    @property
    def has_peridynamics(self) -> bool:
        """Whether some region is described by peridynamics."""
        return has_model(self.regions, "peridynamics")

    @property
    def is_adaptive(self) -> bool:
        """Whether the run finds by itself where bonds are needed."""
        return self.adaptive is not None

    @property
    def has_cycle(self) -> bool:
        """Whether equilibria are found by conjugate gradients, with a cycle over all cells as preconditioner."""
        return self.solver.kind == "cg" or isinstance(self.stepping, Events)

    @property
    def has_finite_elements(self) -> bool:
        """Whether some region is described by finite elements."""
        return has_model(self.regions, "finite_elements")

    @property
    def kinematics(self) -> Literal["linear", "finite"]:
        """Of bonds and elements; what ``peridynamics.kinematics`` stands for where it is not given."""
        return self.peridynamics.kinematics or ("finite" if self.has_peridynamics else "linear")

    @property
    def has_volumetric_part(self) -> bool:
        """Whether bonds may have one: a region of bonds, or beside them, of another Poisson's ratio than 1/4."""
        materials = {name: table for name, (_, table) in all_materials(self.material, self.materials).items()}
        ratios = {materials[region.material].poissons_ratio for region in self.regions}
        return self.has_peridynamics and ratios != {BOND_POISSONS_RATIO}

    @property
    def can_fail(self) -> bool:
        """Whether the deck has a limit for some bond."""
        return any(entry.can_fail for entry in (self.material, *self.materials.values(), *self.interfaces))

    @property
    def softens(self) -> bool:
        """Whether the deck has bonds that soften before they break."""
        return any(entry.softens for entry in (self.material, *self.materials.values(), *self.interfaces))

    @property
    def is_coupled(self) -> bool:
        """Whether the scene has both descriptions."""
        return self.has_peridynamics and self.has_finite_elements


CHECKS: tuple[tuple[tuple[str, ...], Callable[..., list[Problem]]], ...] = (
    (("material", "materials", "regions"), check_poissons_ratio),
    (("materials",), check_material_names),
    (("material", "materials", "regions"), check_region_materials),
    (("material", "materials", "interfaces"), check_contrast),
    (("material", "materials", "regions", "interfaces"), check_interfaces),
    (("mesh", "peridynamics", "regions"), check_cutoff),
    (("cracks", "regions"), check_cracks),
    (("material", "materials", "interfaces", "regions", "stepping"), check_failure),
    (("material", "materials", "interfaces", "stepping"), check_softening),
    (("stepping", "solver"), check_stepping_solver),
    (("stepping", "peridynamics", "loads"), check_events_over_time),
    (("stepping", "probes"), check_opening),
    (("stepping", "supports"), check_formulas),
    (("stepping", "loads", "supports"), check_something_loads),
    (("output", "regions"), check_damage),
    (("regions",), check_region_names),
    (("probes",), check_probe_names),
    (("probes", "supports", "loads", "springs", "ties"), check_column_names),
    (("regions", "loads"), check_references),
    (("regions", "supports"), check_support_references),
    (("regions", "ties"), functools.partial(unknown_regions, "ties")),
    (("mesh", "regions", "material", "materials", "interfaces", "peridynamics", "coupling"), check_fitted),
    (("regions", "material", "materials", "interfaces", "peridynamics"), check_volumetric),
    (("mesh", "regions"), functools.partial(check_sets, "regions")),
    (("mesh", "loads"), functools.partial(check_sets, "loads")),
    (("mesh", "supports"), functools.partial(check_sets, "supports")),
    (("mesh", "springs"), functools.partial(check_sets, "springs")),
    (("mesh", "ties"), functools.partial(check_sets, "ties")),
    (("mesh", "loads"), check_mirrored_loads),
    (("mesh", "supports"), check_mirrored_supports),
    (("mesh", "probes"), check_mirrored_bars),
    (("temperature", "material", "materials", "interfaces", "peridynamics", "regions"), check_temperature),
    (("mesh", "probes"), functools.partial(check_sets, "probes")),
    (("regions", "probes"), check_set_probes),
    (("cracks", "material", "materials", "interfaces", "temperature", "probes"), check_energy_release),
    (("regions", "adaptive"), check_auto_regions),
    (("regions", "peridynamics", "coupling", "mesh", "stepping", "solver", "temperature"), check_auto_settings),
    (("regions", "material", "materials"), check_auto_materials),
    (("regions", "loads", "supports", "ties"), check_auto_references),
)


def find_problems(tables: dict[str, Any]) -> list[Problem]:
    """Run every check of ``CHECKS`` whose tables are there, and return all findings.

    Tables may be partial (keys that are wrong by themselves left out, items `Absent`): a check that needs what is
    not there says nothing.
    """
    problems: list[Problem] = []
    for names, check in CHECKS:
        if all(name in tables for name in names):
            with contextlib.suppress(FieldMissing):
                problems += check(*(tables[name] for name in names))
    return problems
