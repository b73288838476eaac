"""Energy release rate of a crack by the stiffness of the body at two lengths: what the potential loses per area.

``Pi = U - f . u`` of an elastic body in equilibrium; ``G = -(Pi(a + e) - Pi(a)) / (e b)`` is the rate at ``a + e / 2``,
``b`` the length of the front. Where supports move, ``Pi`` is the stored energy; under forces it is minus that.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from pdfem_mpi.deck.mechanical_probes import EnergyReleaseProbe, front_of
from pdfem_mpi.deck.peridynamics import Crack, polygon_normal
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.kernels.dense import lengths
from pdfem_mpi.model.not_finite import NotFinite
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.runs.crack_fronts import default_extension
from pdfem_mpi.runs.simulation import Simulation
from pdfem_mpi.solvers.convergence import NotConverged

#: A crack within this fraction of the body's size of a mirror plane lies on it.
ON_MIRROR = 1e-6


def energy_releases(simulation: Simulation, warn: Callable[[str], None]) -> dict[str, Any]:
    """Rates and stress intensity factors of the scene's probes at the state, by name, the deck's units. Collective.

    The simulation is left as it is; each probe solves a second body at the same load. ``warn`` is called where that has
    no equilibrium.
    """
    found: dict[str, Any] = {}
    for probe in simulation.scene.probes:
        if not isinstance(probe, EnergyReleaseProbe):
            continue
        longer = Simulation(longer_scene(simulation, probe), simulation.comm)
        try:
            longer.solve(simulation.state.load_factor)
        except (NotConverged, NotFinite) as error:
            warn(f"probe {probe.name}: with the longer crack no equilibrium was found: {error}")
            continue
        found[probe.name] = rate_between(simulation, longer, probe)
    return found


def longer_scene(simulation: Simulation, probe: EnergyReleaseProbe) -> Scene:
    """The scene with the crack longer by the probe's extension, and nothing to measure."""
    scene = simulation.scene
    crack = scene.cracks[probe.crack]
    step = np.array(probe.direction) / math.hypot(*probe.direction) * _extension(simulation, probe)
    front = front_of(crack.polygon, probe.direction)
    corners = [np.array(corner) + (step if k in front else 0.0) for k, corner in enumerate(crack.polygon)]
    longer = Crack(polygon=tuple(tuple(corner.tolist()) for corner in corners))
    cracks = (*scene.cracks[: probe.crack], longer, *scene.cracks[probe.crack + 1 :])
    return scene.model_copy(update={"cracks": cracks, "probes": (), "stepping": Steps()})


def rate_between(shorter: Simulation, longer: Simulation, probe: EnergyReleaseProbe) -> dict[str, float | None]:
    """What is lost per new area between two solved bodies, and K of it where there is one material. Collective."""
    scene, units = shorter.scene, shorter.share.units
    released = (potential(shorter) - potential(longer)) * units.force * units.length
    rate = _wholeness(shorter, probe) * released / (_extension(shorter, probe) * _width(shorter, probe))
    factor = None
    if not scene.materials:
        material = scene.material
        modulus = material.youngs_modulus
        if probe.state == "plane_strain":
            modulus /= 1.0 - material.poissons_ratio**2
        factor = math.sqrt(max(rate, 0.0) * modulus)
    return {"energy_release_rate": rate, "stress_intensity": factor}


def potential(simulation: Simulation) -> float:
    """Stored energy less the work of constant forces at the state, model units. Collective."""
    simulation.evaluate()
    u, forces = simulation.state.u, simulation.case.forces(simulation.state.load_factor)
    before = simulation.forces.evaluations
    stored = simulation.forces.stored_energy(u)
    simulation.forces.evaluations = before
    (work,) = exact_dots(simulation.comm, [(forces, u)])
    return stored - float(work)


def _extension(simulation: Simulation, probe: EnergyReleaseProbe) -> float:
    if probe.extension is not None:
        return probe.extension
    return default_extension(simulation.scene, simulation.share, probe)


def _width(simulation: Simulation, probe: EnergyReleaseProbe) -> float:
    """Length of the front within the body."""
    if probe.width is not None:
        return probe.width
    normal = np.array(polygon_normal(simulation.scene.cracks[probe.crack].polygon)[0])
    along = np.cross(normal, probe.direction)
    extent = simulation.share.mesh.upper - simulation.share.mesh.lower
    # of a front along an axis that is the body's edge, else the longest line within its box
    shares = np.abs(along) / lengths(along)
    return float(min(extent[d] / shares[d] for d in range(3) if shares[d] > ON_MIRROR))


def _wholeness(simulation: Simulation, probe: EnergyReleaseProbe) -> float:
    """2 where the crack lies on a mirror plane, whose other side releases as much; else 1."""
    share = simulation.share
    corners = (np.array(simulation.scene.cracks[probe.crack].polygon) - share.units.origin) / share.units.length
    size = float((share.upper - share.lower).max())
    planes = [(d, plane) for d, positions in enumerate(share.mirrors.planes) for plane in positions]
    on = any(np.abs(corners[:, d] - plane).max() <= ON_MIRROR * size for d, plane in planes)
    return 2.0 if on else 1.0
