"""A ball and a cylinder of another material in a strained body: exact answers, and bodies to compare with them."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.stepping import make_solver
from support.bodies import YOUNGS_MODULUS, build, make_scene

FE, PD = "finite_elements", "peridynamics"
STRAIN = 1e-3 * np.array([[1.0, 0.2, 0.0], [0.2, -0.25, 0.3], [0.0, 0.3, -0.25]])  # far away


def eshelby(x, radius, contrast, nu=0.25):
    """Displacement around a ball in an infinite body strained by `STRAIN`, both of the same Poisson's ratio.

    The ball acts as one of the body's own material with the uniform strain e* that is free of stress; outside, with
    phi = 4 pi a^3 / (3 r) and psi = 4 pi a^3 / 3 (r + a^2 / (5 r))::

        8 pi (1 - nu) u_i = psi,ijk e*_jk - 2 nu phi,i e*_kk - 4 (1 - nu) phi,k e*_ik

    Returns
    -------
    u : float64, shape (n, 3)
    inside : float64, shape (3, 3)
        The ball's strain.

    References
    ----------
    Eshelby, The determination of the elastic field of an ellipsoidal inclusion, Proc. R. Soc. A 241, 1957; Mura,
    Micromechanics of Defects in Solids, 1987, sections 11 and 22.
    """
    mean = np.trace(STRAIN) / 3.0 * np.eye(3)
    of_mean, of_shear, excess = (1 + nu) / (3 * (1 - nu)), 2 * (4 - 5 * nu) / (15 * (1 - nu)), contrast - 1.0
    free_mean = -excess / (1 + of_mean * excess) * mean
    free_shear = -excess / (1 + of_shear * excess) * (STRAIN - mean)
    free = free_mean + free_shear
    inside = STRAIN + of_mean * free_mean + of_shear * free_shear
    r = np.maximum(np.sqrt((x**2).sum(axis=1)), 1e-9)[:, None]
    first, second, third = 1 - radius**2 / (5 * r**2), 2 * radius**2 / (5 * r**3), -6 * radius**2 / (5 * r**4)
    a, b = third / r**3 - 3 * second / r**4 + 3 * first / r**5, second / r**2 - first / r**3
    along, trace = x @ free, np.trace(free)
    psi = a * x * (along * x).sum(axis=1)[:, None] + b * (2 * along + trace * x)
    outside = psi + (2 * nu * trace * x + 4 * (1 - nu) * along) / r**3
    outside *= 4 * np.pi * radius**3 / 3 / (8 * np.pi * (1 - nu))
    return np.where(r <= radius, x @ inside, outside + x @ STRAIN), inside


def cylinder_strain(contrast, nu=0.25):
    """Strain of a circular inclusion along the tension over that far away; plane stress, infinite plate."""
    kappa, excess = (3.0 - nu) / (1.0 + nu), contrast - 1.0
    mean, shear = 0.5 * (1.0 - nu), 0.5 * (1.0 + nu)
    return mean / (1.0 + 2.0 / (kappa + 1.0) * excess) + shear / (1.0 + kappa / (kappa + 1.0) * excess)


def solve(body):
    """Take a body to equilibrium in one step; the number of evaluations."""
    notes = []
    solver = make_solver(body.scene, body.share, body.forces, body.case, notes.append)
    body.state.u[body.case.fixed] = body.case.prescribed[body.case.fixed]
    evaluations = solver(body.state, body.case.external).evaluations
    assert not notes
    return evaluations


def positions_and_displacements(body):
    """Free points and all nodes, float64, shapes (n, 3)."""
    found, fields = body.share, body.fields(body.state.u)
    x, u = [], []
    if fields.u_points is not None:
        free = np.repeat(~found.is_overlap[found.has_points], 8)
        x.append(body.geometry.point_positions[free])
        u.append(fields.u_points[free])
    if fields.u_nodes is not None:
        x.append(found.mesh.nodes[found.node_row >= 0])
        u.append(fields.u_nodes)
    return np.concatenate(x), np.concatenate(u)


def ball(cells, radius, contrast, model, tolerance=1e-6, nu=0.25, correction="appendix_a"):
    """A ball in a cube; exact displacements on the outside, for bonds in two layers of cells."""
    middle = 0.5 * cells
    inside = Region(name="ball", model=PD, material="ball", centre=(middle,) * 3, radius=radius)
    matrix = FE if model == FE else PD
    regions = [inside.model_copy(update={"model": matrix})]
    if model == "coupled":
        regions[0] = inside
        low, high, far = middle - radius - 2.0, middle + radius + 2.0, float(cells)
        boxes = [((0.0, 0.0, 0.0), (low, far, far)), ((high, 0.0, 0.0), (far, far, far))]
        boxes += [((low, 0.0, 0.0), (high, low, far)), ((low, high, 0.0), (high, far, far))]
        boxes += [((low, low, 0.0), (high, high, low)), ((low, low, high), (high, high, far))]
        regions += [Region(name=f"outside {k}", model=FE, lower=a, upper=b) for k, (a, b) in enumerate(boxes)]
        regions.append(Region(name="around", model=PD, lower=(low,) * 3, upper=(high,) * 3))
    else:
        regions.append(Region(name="around", model=matrix))
    layers = 2 if model == PD else 1
    scene = make_scene(
        (cells,) * 3,
        regions=tuple(regions),
        materials={"ball": Material(youngs_modulus=contrast * YOUNGS_MODULUS, poissons_ratio=nu)},
        loads=(),
        supports=tuple(Support(face=a + s, layers=layers, x=0.0, y=0.0, z=0.0) for a in "xyz" for s in "-+"),
        solver="cg",
        tolerance=tolerance,
        poissons_ratio=nu,
        correction=correction,
    )
    body = build(scene)
    length = body.share.units.length
    exact = body.of_positions(lambda x: eshelby(x * length, same_volume(body), contrast, nu)[0] / length)
    body.case.prescribed[:] = np.where(body.case.fixed, exact, 0.0)
    return body


def same_volume(body):
    """Radius of the ball with the volume of the cells that stand for it."""
    return (3.0 * np.count_nonzero(body.share.material) / (4.0 * np.pi)) ** (1.0 / 3.0)


def ball_errors(body, contrast):
    """Of the ball's mean and shear strain, relative to the exact ones; of all displacements, relative to their norm."""
    x, u = positions_and_displacements(body)
    x = x - 0.5 * body.share.mesh.upper
    radius = same_volume(body)
    exact, strain = eshelby(x, radius, contrast, body.scene.material.poissons_ratio)
    inner = np.sqrt((x**2).sum(axis=1)) < radius - 1.2
    gradient = np.linalg.lstsq(np.c_[x[inner], np.ones(np.count_nonzero(inner))], u[inner], rcond=None)[0][:3]
    found = 0.5 * (gradient + gradient.T)
    shear, exact_shear = (e - np.trace(e) / 3.0 * np.eye(3) for e in (found, strain))
    return (
        np.trace(found) / np.trace(strain) - 1.0,
        (shear * exact_shear).sum() / (exact_shear**2).sum() - 1.0,
        np.sqrt(((u - exact) ** 2).sum() / (exact**2).sum()),
    )
