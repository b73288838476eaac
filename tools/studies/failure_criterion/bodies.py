"""Bodies of the criterion study, and rules by which their bonds may break: for this study alone.

Lengths are in cells of the coarse mesh, Young's modulus is 1, the critical stretch `STRETCH`; plates two units thick,
pulled along x. Rules other than the program's own live here, beside the library, because the study refuses them.
"""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np

from tools.studies.internals import (
    GAUSS_POINTS,
    UNBREAKABLE,
    Events,
    Failure,
    FileMesh,
    HexMesh,
    Material,
    Peridynamics,
    Region,
    Scene,
    Solver,
    Support,
    add_products,
    box,
    find_boundary,
    make_bonds,
    plate_with_hole,
    point_rows,
)
from tools.studies.internals import break_bonds as break_by_stretch
from tools.studies.internals import failure_kernels as kernels

STRETCH = 1e-3
THICKNESS = 2.0
HELD = 2.0  # cells at each end whose bonds do not break
#: Half the length, the width, the width of what has to tear, and the mirror planes of each body.
BODIES = {
    "hole": (12.0, 20.0, 12.0, ("x-", "y-", "z-")),
    "notch": (7.0, 12.0, 8.0, ("x-", "z-")),
    "two holes": (9.5, 24.0, 12.0, ("z-",)),
    "strip": (6.0, 10.0, 10.0, ("z-",)),
}


def make_mesh(body: str, h: float, mirrored: bool) -> HexMesh:
    """Hexahedra of edge ``h``: of the whole body, or of what its mirror planes leave."""
    half, width, _, planes = BODIES[body]
    planes = planes if mirrored else ()
    low = [0.0 if "x-" in planes else -half, 0.0 if "y-" in planes else -width / 2, 0.0 if "z-" in planes else -1.0]
    high = [half, width / 2, 1.0]
    if body == "hole":  # of radius 4, half-way across a plate of 20
        return plate_with_hole(low, high, 4.0, h, [face for face in planes if face != "z-"])
    if body == "two holes":  # of radius 3, not abreast: two plates side by side, each longer at another end
        plate = plate_with_hole([-7.0, -6.0, low[2]], [7.0, 6.0, 1.0], 3.0, h)
        rest = _grid([7.0, -6.0, low[2]], [12.0, 6.0, 1.0], h)
        return _joined((plate, (-2.5, -6.0)), (rest, (-2.5, -6.0)), (plate, (2.5, 6.0)), (rest, (-16.5, 6.0)))
    mesh = _grid(low, high, h)
    if body == "strip":
        return mesh
    x, y = mesh.nodes[mesh.cells].mean(axis=1)[:, :2].T  # a notch 4 wide and 4 deep, with square corners
    cells = mesh.cells[(np.abs(x) > 2.0) | (y > -2.0)]
    used, number = np.unique(cells, return_inverse=True)
    return HexMesh(mesh.nodes[used], number.reshape(cells.shape).astype(np.int32))


def _grid(low, high, h: float) -> HexMesh:
    return box(low, high, [round((b - a) / h) for a, b in zip(low, high, strict=True)])


def _joined(*parts) -> HexMesh:
    """Meshes moved in the plane, nodes at one place made one."""
    nodes, cells, count = [], [], 0
    for mesh, (x, y) in parts:
        nodes.append(mesh.nodes + np.array([x, y, 0.0]))
        cells.append(mesh.cells + count)
        count += len(mesh.nodes)
    every = np.concatenate(nodes)
    _, first, number = np.unique(np.round(1e6 * every), axis=0, return_index=True, return_inverse=True)
    return HexMesh(every[first], number.reshape(-1)[np.concatenate(cells)].astype(np.int32))


def make_scene(body: str, h: float, length: float, correction: str, mirrored: bool, folder: Path) -> Scene:
    """The body with cells of edge ``h`` and an internal length, pulled from break to break."""
    half, _, _, planes = BODIES[body]
    planes = planes if mirrored else ()
    path = folder / f"{body.replace(' ', '_')}-{h:g}{'-part' if mirrored else ''}.vtu"
    if not path.exists():
        mesh = make_mesh(body, h, mirrored)
        meshio.Mesh(mesh.nodes, [("hexahedron", mesh.cells)]).write(path)
    inner, far, layers = half - HELD, 99.0, round(1.0 / h)
    regions = [
        Region(name="middle", model="peridynamics", lower=(-inner, -far, -far), upper=(inner, far, far)),
        Region(name="right", model="peridynamics", lower=(inner, -far, -far), may_fail=False),
    ]
    supports = [Support(face="x+", layers=layers, x=0.1)]
    if "x-" not in planes:
        regions.append(Region(name="left", model="peridynamics", upper=(-inner, far, far), may_fail=False))
        supports.append(Support(face="x-", layers=layers, x=-0.1))
    return Scene(
        mesh=FileMesh(kind="file", path=str(path), symmetry=planes),
        material=Material(youngs_modulus=1.0, critical_stretch=STRETCH),
        regions=tuple(regions),
        peridynamics=Peridynamics(
            internal_length=length, surface_correction=correction, signs="bounded", kinematics="linear"
        ),
        supports=tuple(supports),
        solver=Solver(kind="cg", tolerance=1e-8),
        stepping=Events(kind="events", report_every=10**6, end_reaction=0.05 if h == 1.0 else 0.5),
    )


class BondList:
    """All bonds of a body on one rank, in the order of the rows' slots: two arrays of each, interior and boundary.

    Attributes
    ----------
    ends : list of int64, shape (n, 2)
        Local points.
    vector, square, factor : lists of float64
        From the first end to the second, its square, and the bond's factor over that of no correction.
    """

    def __init__(self, share, model):
        points = model.points
        plain, _ = make_bonds(model.comm, points, share.materials, share.cutoff, False, "none")
        x = point_rows(points.x)
        self.ends, self.vector, self.square, self.factor, self.stored = [], [], [], [], []
        for rows, base in zip(model.bonds.rows, plain.rows, strict=True):
            slot = np.flatnonzero(rows.data)
            row = slot // 4
            i = np.searchsorted(rows.start, row, side="right") - 1
            j = 4 * (rows.offset[row].astype(np.int64) // 36) + slot % 4
            self.ends.append(np.column_stack([i, j]))
            self.vector.append(x[j] - x[i])
            self.square.append((self.vector[-1] ** 2).sum(axis=1))
            self.factor.append(rows.data[slot].astype(float) / base.data[slot])
            self.stored.append(rows.data[slot].astype(float))

    def stretches(self, S: np.ndarray):
        """Of the bonds of both kinds of rows at the displacements of the table."""
        u = np.ascontiguousarray(S[:, 0:3].swapaxes(1, 2)).reshape(-1, 3)
        for ends, vector, square in zip(self.ends, self.vector, self.square, strict=True):
            yield ((u[ends[:, 1]] - u[ends[:, 0]]) * vector).sum(axis=1) / square


def weights(rule: str, bonds: BondList, edge: float, share, model):
    """What a rule multiplies stretches by before it compares: to set the load, and to break.

    Parameters
    ----------
    rule : text
        "all", "r>=A", "g>=A", "A<=g<=B" or "depth", several joined by " and " (bonds that do not set the load; they
        break with others), or "energy", "capped" (of all).
    edge : float
        Of the cells, model units.
    """
    outer = _outer_points(share, model) if "depth" in rule else None
    telling, breaking = [], []
    for ends, square, factor in zip(bonds.ends, bonds.square, bonds.factor, strict=True):
        tell = np.ones(len(factor))
        if rule in ("energy", "capped"):  # 1/2 K s^2 of the bond, over what it is without correction
            tell = np.sqrt(np.maximum(factor, 0.0))
            tell = np.minimum(tell, 1.0) if rule == "capped" else tell
            telling.append(tell)
            breaking.append(tell)
            continue
        for term in rule.split(" and "):
            if term.startswith("r>="):
                tell *= np.sqrt(square) >= float(term[3:]) * edge
            elif term.startswith("g>="):
                tell *= factor >= float(term[3:])
            elif "<=g<=" in term:
                low, high = map(float, term.split("<=g<="))
                tell *= (factor >= low) & (factor <= high)
            elif term == "depth":
                tell *= ~outer[ends].any(axis=1)
        telling.append(tell)
        breaking.append(np.ones(len(factor)))
    return telling, breaking


def _outer_points(share, model) -> np.ndarray:
    """Points in the outer layer of a cell at the surface: closer to it than half a cell; bool, shape (n_points,)."""
    boundary = find_boundary(share.mesh, share.nodes, share.body)
    outer = np.zeros((len(share.mesh.cells), 8), bool)
    axis, upper = np.divmod(boundary.side, 2)
    np.logical_or.at(outer, boundary.cell, (GAUSS_POINTS.T[axis] > 0.0) == (upper == 1)[:, None])
    return outer[model.subdomain.free].reshape(-1)


class Ruled(Failure):
    """Failure whose bonds break by a rule of `weights`; on one rank, in linear kinematics."""

    def follow(self, bonds: BondList, telling, breaking) -> Ruled:
        """Take a rule; returns itself."""
        self.bonds, self.telling, self.breaking = bonds, telling, breaking
        self.left = [np.ones(len(t), bool) for t in telling]
        inverse = np.where(self.stretch < UNBREAKABLE, 1.0 / self.stretch, 0.0)
        self.inverse = [inverse[self.class_of[e[:, 0] // 4], self.class_of[e[:, 1] // 4]] for e in bonds.ends]
        return self

    def _ratios(self, S, weights):
        parts = zip(self.bonds.stretches(S), self.inverse, weights, self.left, strict=True)
        return [s * inverse * weight * left for s, inverse, weight, left in parts]

    def largest_ratio(self, comm, bonds, S, most=np.inf):
        """By the rule."""
        return max(float(ratios[ratios <= most].max(initial=0.0)) for ratios in self._ratios(S, self.telling))

    def break_at(self, model, S, margin: float) -> None:
        """Break what the rule breaks at the table, if a bond that tells is critical."""
        if self.largest_ratio(model.comm, model.bonds, S) < 1.0 - margin:
            return
        for rows, ends, left, ratios in zip(
            model.bonds.rows, self.bonds.ends, self.left, self._ratios(S, self.breaking), strict=True
        ):
            gone = np.flatnonzero(ratios >= 1.0 - margin)
            if not len(gone):
                continue
            left[gone] = False
            wanted = np.ascontiguousarray(ends[gone])
            pairs, strengths = np.empty_like(wanted), np.empty(wanted.shape, np.float32)
            n = kernels.break_listed(wanted, *rows.arrays, False, pairs, strengths)
            pairs, strengths, energies = pairs[:n].copy(), strengths[:n].copy(), np.empty(n)
            kernels.broken_energies(pairs, strengths, n, S.reshape(-1), False, energies)
            add_products(energies, np.ones(n), self._digits)
            self._enter(model.points, pairs, strengths)


def break_by_rule(solve, failure, state, external, margin=0.0, residual=None) -> int:
    """In place of `stepping.steps.break_bonds`: by the rule of `Ruled` books."""
    if not isinstance(failure, Ruled):
        return break_by_stretch(solve, failure, state, external, margin, residual)
    forces = solve.forces
    forces.evaluate_surely(state.u, external, residual)
    failure.break_at(forces.model, forces.of_bonds.S, margin)
    count = failure.close(forces.model.comm)
    if count:
        solve.update_after_breaks(failure.take())
        forces.evaluate_surely(state.u, external, residual)
    return count
