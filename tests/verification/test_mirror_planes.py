"""Plane symmetry: a half, a quarter or an eighth of a symmetric body moves as that part of the whole body does.

The paper's bodies all are symmetric (figs 11 and 13). Oracle: the whole body, solved by the same program without mirror
planes. Bonds across a plane are bonds to mirror images; nothing but round-off may differ.
"""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from pdfem_mpi.body.meshing import make_mesh
from pdfem_mpi.deck.loads import BodyForce, Support, Traction
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.meshes import BoxMesh, PlateWithHoleMesh
from pdfem_mpi.deck.outputs import BarProbe, LineProbe
from pdfem_mpi.deck.peridynamics import Coupling, Crack, Peridynamics
from pdfem_mpi.deck.programs import Solver
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.measure.bar import measure_bar
from pdfem_mpi.measure.displacement import displacement_at
from pdfem_mpi.measure.line import measure_line
from pdfem_mpi.peridynamics.bonds import total_bonds
from pdfem_mpi.solvers import adr
from pdfem_mpi.solvers.convergence import NotConverged
from pdfem_mpi.stepping import follow_load_program, make_solver
from support.bodies import build, geometry_of, run_deck

#: Of the largest displacement: two equilibria with residuals of TOLERANCE each; 3.5e-12 is found.
SOLVED = 1e-11
RELAXED = 1e-7  # residuals of 1e-8
ROUND_OFF = 1e-13  # of the largest value, for set-up and a few iterations
QUANTA = 2e-12  # of the largest force: quanta are 2^-50 of a bound that may be 2^9 above what is met
TOLERANCE = 5e-12  # near the round-off of residuals
UPPER = (6.0, 2.0, 2.0)
PULL = BodyForce(kind="body_force", face="x+", density=(5.0, 0.0, 0.0))
PUSH = BodyForce(kind="body_force", face="x-", density=(-5.0, 0.0, 0.0))
SPREAD = BodyForce(kind="body_force", face="y+", density=(0.0, 3.0, 0.0))
SPREAD_BACK = BodyForce(kind="body_force", face="y-", density=(0.0, -3.0, 0.0))


def regions(model):
    """Bonds, elements, or elements at both ends of bonds."""
    whole = {"peridynamics": "peridynamics", "elements": "finite_elements"}
    if model in whole:
        return (Region(name="all", model=whole[model]),)
    return (
        Region(name="left", model="finite_elements", upper=(-3.0, 9.0, 9.0)),
        Region(name="middle", model="peridynamics", lower=(-3.0, -9.0, -9.0), upper=(3.0, 9.0, 9.0)),
        Region(name="right", model="finite_elements", lower=(3.0, -9.0, -9.0)),
    )


def box(
    model, faces=(), loads=None, kinematics="linear", correction="appendix_a", coupling="paper", solver="cg", **more
):
    """A box about the origin of 12 x 4 x 4 cells, or the part of it that mirror planes at 0 leave."""
    lower = tuple(0.0 if f"{axis}-" in faces else -high for axis, high in zip("xyz", UPPER, strict=True))
    loads = (PULL, PUSH, SPREAD, SPREAD_BACK) if loads is None else loads
    return Scene(
        mesh=BoxMesh(lower=lower, upper=UPPER, spacing=1.0, symmetry=faces),
        material=Material(youngs_modulus=1000.0),
        regions=tuple(r for r in regions(model) if "x-" not in faces or r.upper is None or r.upper[0] > 0.0),
        peridynamics=Peridynamics(kinematics=kinematics, surface_correction=correction),
        coupling=Coupling(kind=coupling),
        loads=tuple(load for load in loads if getattr(load, "face", None) not in faces),
        solver=Solver(kind=solver, tolerance=TOLERANCE, max_evaluations=20_000),
        **more,
    )


def symmetric(x):
    """A smooth displacement that mirror planes through the origin leave as it is; deck units."""
    a, b, c = x.T / 3.0
    return 0.01 * np.stack(
        [
            np.sin(a) * np.cos(2 * b) * np.cos(c),
            np.sin(b) * (1.0 + np.cos(a)) * np.cos(2 * c),
            np.sin(2 * c) * np.cos(a) * np.cos(b),
        ],
        axis=1,
    )


def positions(body):
    """Free points, then owned nodes, in the deck's units, shape (n_unknowns / 3, 3)."""
    return body.of_positions(lambda x: x * body.model.units.length + body.model.units.origin)


def rows(body, flat):
    """A vector over the unknowns as one row a point or node."""
    n = 3 * body.model.unknowns.n_points
    points = flat[:n].reshape(-1, 3, 4).swapaxes(1, 2).reshape(-1, 3)
    return np.concatenate([points, flat[n:].reshape(-1, 3)])


def matched(whole, part):
    """The whole body's row at each point or node of the part."""
    distance, index = cKDTree(rows(whole, positions(whole))).query(rows(part, positions(part)))
    assert distance.max() < 1e-9
    return index


def solve(scene):
    """The equilibrium at load factor 1 and the body."""
    body = build(scene)
    solver = make_solver(scene, body.share, body.forces, body.case, pytest.fail)
    (found,) = follow_load_program(scene, solver, None, body.state, body.case)
    return body, found


def gap(whole, part, of=lambda body: body.state.u):
    """Largest difference of a vector over the unknowns, relative to its largest component."""
    u, v = rows(whole, of(whole)), rows(part, of(part))
    return np.abs(u[matched(whole, part)] - v).max() / np.abs(u).max()


def cases(models, default):
    """Each model with a half, a quarter and an eighth; all but the parts named in ``default`` are slow."""
    parts = [("x-",), ("x-", "z-"), ("x-", "y-", "z-")]
    return [
        pytest.param(*model, faces, marks=() if faces in default[model[0]] else pytest.mark.slow)
        for model in models
        for faces in parts
    ]


HALF, QUARTER, EIGHTH = ("x-",), ("x-", "z-"), ("x-", "y-", "z-")


@pytest.mark.parametrize(
    ("model", "kinematics", "correction", "faces"),
    cases(
        [
            ("peridynamics", "linear", "none"),
            ("peridynamics", "finite", "appendix_a"),
            ("coupled", "linear", "appendix_a"),
            ("coupled", "finite", "none"),
            ("elements", "linear", "none"),
        ],
        {"peridynamics": [QUARTER, EIGHTH], "coupled": [EIGHTH], "elements": [QUARTER]},
    ),
)
def test_forces_are_those_of_the_whole_body(model, kinematics, correction, faces):
    """At a given displacement, and masses: equal on points and nodes; on a plane the share of this side."""
    whole, part = (build(box(model, f, (), kinematics, correction), loaded=False) for f in ((), faces))
    force, mass = [], []
    for body in (whole, part):
        units = body.model.units
        u = body.of_positions(lambda x, units=units: symmetric(x * units.length + units.origin) / units.length)
        force.append(rows(body, body.internal(u)))
        mass.append(rows(body, body.model.mass))
    index, share = matched(whole, part), rows(part, part.model.own_part)
    assert np.abs(force[0][index] * share - force[1]).max() <= QUANTA * np.abs(force[0]).max()
    assert np.abs(mass[0][index] * share - mass[1]).max() <= ROUND_OFF * mass[0].max()
    assert part.model.correction_remaining == pytest.approx(whole.model.correction_remaining, rel=1e-9)


@pytest.mark.parametrize(
    ("model", "kinematics", "coupling", "faces"),
    cases(
        [
            ("peridynamics", "linear", "paper"),
            ("peridynamics", "finite", "paper"),
            ("coupled", "linear", "paper_a"),
            ("coupled", "finite", "paper"),
            ("elements", "linear", "paper"),
        ],
        {"peridynamics": [QUARTER], "coupled": [HALF, EIGHTH], "elements": [HALF]},
    ),
)
def test_a_part_moves_as_it_does_in_the_whole_body(model, kinematics, coupling, faces):
    """Equilibrium of half, quarter and eighth under body forces along x and y: displacements, and in as many sweeps."""
    whole, of_whole = SOLVED_BODIES[model, kinematics, coupling]
    part, of_part = solve(box(model, faces, kinematics=kinematics, coupling=coupling))
    assert gap(whole, part) <= SOLVED
    assert abs(of_part.convergence.evaluations - of_whole.convergence.evaluations) <= 2
    assert max(of_part.force_balance, of_part.moment_balance) < 1e-12


class _Solved(dict):
    """Whole bodies, each solved when it is first asked for."""

    def __missing__(self, key):
        model, kinematics, coupling = key
        self[key] = solve(box(model, kinematics=kinematics, coupling=coupling))
        return self[key]


SOLVED_BODIES = _Solved()


@pytest.mark.parametrize("model", ["peridynamics", "coupled", "elements"])
def test_relaxation_takes_the_same_steps(model):
    """Iterates of eqs (31)-(35): the damping is a quotient of sums over the whole body, planes shared by both sides.

    Later the quotients of eq. (32) have amplified round-off, in any two runs whose sums are rounded differently.
    """
    bodies = []
    for faces in ((), ("x-", "y-", "z-")):
        body = build(box(model, faces, solver="adr"))
        with pytest.raises(NotConverged, match="used up"):
            adr.solve(body.forces, body.state, body.case.external, body.case.fixed, 1e-12, 9)
        assert np.abs(body.state.u).max() > 0.0
        bodies.append(body)
    assert gap(*bodies) <= ROUND_OFF


def test_relaxation_ends_in_the_same_place():
    """Coupled and finite, relaxed to a residual of 1e-8."""
    scenes = (box("coupled", faces, solver="adr", kinematics="finite") for faces in ((), ("x-", "y-", "z-")))
    solver = Solver(kind="adr", tolerance=1e-8, max_evaluations=20_000)
    whole, part = (solve(scene.model_copy(update={"solver": solver}))[0] for scene in scenes)
    assert gap(whole, part) <= RELAXED


@pytest.mark.parametrize("model", ["peridynamics", "coupled"])
def test_a_slab_between_two_planes_is_repeated(model):
    """Plane strain: one cell between two mirrors, thinner than the cutoff radius, and three cells between them."""

    def slab(thickness):
        scene = box(model, loads=(PULL, PUSH))
        mesh = BoxMesh(lower=(-6.0, -2.0, 0.0), upper=(6.0, 2.0, thickness), spacing=1.0, symmetry=("z-", "z+"))
        return solve(scene.model_copy(update={"mesh": mesh}))[0]

    thick, thin = slab(3.0), slab(1.0)
    assert gap(thick, thin) <= SOLVED
    assert total_bonds(thin.model.comm, thin.model.bonds) > 0


def test_the_reaction_is_that_of_the_supports_of_the_part():
    """A bar drawn out by its end faces: an eighth feels a quarter of the force, and mirror planes do not count."""
    ends = Support(face="x+", x=0.05), Support(face="x-", x=-0.05)
    whole, _ = solve(box("coupled", loads=(), supports=ends))
    part, found = solve(box("coupled", ("x-", "y-", "z-"), loads=(), supports=ends[:1]))
    at_end = rows(whole, positions(whole))[:, 0] > UPPER[0] - 1e-6
    pull = -rows(whole, whole.internal(whole.state.u))[at_end, 0].sum()
    assert pull > 0.0
    assert found.resultant[0] == pytest.approx(pull / 4.0, rel=1e-10)
    assert np.abs(found.resultant[1:]).max() < 1e-12 * pull
    assert len(whole.case.free_motions) == 3 and not len(part.case.free_motions)


def test_a_support_and_a_plane_leave_the_motions_that_neither_holds():
    """A half held at x- moves freely only along the plane; rotations about x are held by the plane."""
    scene = box("elements", ("y-",), loads=(), supports=(Support(face="x-", x=0.0),))
    (motion,) = build(scene).case.free_motions
    assert np.abs(motion[[0, 1, 3, 4, 5]]).max() < 1e-12 * abs(motion[2])


def test_equal_nodal_forces_are_shared_with_the_other_side():
    """Traction with nodal = "equal" ("uniform point forces"): a node on a plane gets half of what the others get."""
    pull = [
        Traction(kind="traction", face=face, traction=(stress, 0.0, 0.0), nodal="equal")
        for face, stress in (("x+", 2.0), ("x-", -2.0))
    ]
    whole, part = (build(box("elements", faces, loads=pull)) for faces in ((), ("x-", "y-", "z-")))
    share = rows(part, part.model.own_part)
    expected = rows(whole, whole.case.external)[matched(whole, part)] * share
    assert np.abs(expected - rows(part, part.case.external)).max() <= ROUND_OFF * np.abs(expected).max()


CRACKED = 5e-11  # residual: cut bodies are less well conditioned
STRIPPED = 2e-9  # a crack and its image leave a strip one layer of points thick between them, whose round-off is 9e-10
CRACKS = {
    "beyond the plane": [(-9.0, 0.4, -9.0), (2.0, 0.4, -9.0), (2.0, 0.4, 9.0), (-9.0, 0.4, 9.0)],
    "on the plane": [(-3.5, 0.0, -9.0), (3.5, 0.0, -9.0), (3.5, 0.0, 9.0), (-3.5, 0.0, 9.0)],
    # its ends are no midpoints of bonds
    "inclined": [(0.1, -0.8, -9.0), (3.87, 1.46, -9.0), (3.87, 1.46, 9.0), (0.1, -0.8, 9.0)],
}


@pytest.mark.parametrize("name", ["on the plane", "inclined", pytest.param("beyond the plane", marks=pytest.mark.slow)])
def test_cracks_are_mirrored_too(name):
    """The whole body has the crack and its mirror images: the same bonds are cut, also across the plane."""
    corners = np.array(CRACKS[name])
    images = [corners * (1.0, sign, 1.0) for sign in (1.0, -1.0)]
    cracks = tuple(Crack(polygon=tuple(map(tuple, polygon.tolist()))) for polygon in images)
    scenes = box("peridynamics", cracks=cracks), box("peridynamics", ("y-",), cracks=cracks[:1])
    tolerance = STRIPPED if name == "beyond the plane" else CRACKED
    solver = Solver(kind="cg", tolerance=tolerance)
    whole, part = (solve(scene.model_copy(update={"solver": solver}))[0] for scene in scenes)
    assert min(whole.model.cut[0], part.model.cut[0]) > 0
    assert gap(whole, part) <= 10 * tolerance
    uncut = solve(box("peridynamics", ("y-",)))[0]
    assert gap(uncut, part) > 0.01


PLATE = ((-10.0, -7.0, -2.0), (10.0, 7.0, 2.0), 2.5)


def plate(faces=(), model="peridynamics", n=1):
    """A plate of 20 x 14 x 4 cells with a hole at 0, or the part of it that mirror planes leave."""
    lower = [0.0 if f"{axis}-" in faces else -high for axis, high in zip("xyz", PLATE[1], strict=True)]
    upper = [0.0 if f"{axis}+" in faces else high for axis, high in zip("xyz", PLATE[1], strict=True)]
    scene = box(model, loads=(PULL, PUSH))
    mesh = PlateWithHoleMesh(lower=tuple(lower), upper=tuple(upper), hole_radius=PLATE[2], spacing=1.0, symmetry=faces)
    sides = [region for region in scene.regions if region.name != "left" or "x-" not in faces]
    loads = tuple(load for load in scene.loads if load.face not in faces)
    return scene.model_copy(update={"mesh": mesh, "regions": tuple(sides), "loads": loads})


@pytest.mark.parametrize("faces", [("x-",), ("x+", "y-"), ("x-", "y+", "z-")], ids="".join)
def test_a_part_of_the_plate_has_the_nodes_of_the_whole_plate(faces):
    """Same cells, those on the modelled side, and nodes on the planes exactly."""
    whole, part = make_mesh(plate()), make_mesh(plate(faces))
    distance, index = cKDTree(whole.nodes).query(part.nodes)
    assert distance.max() < 1e-12
    assert len(part.cells) * 2 ** len(faces) == len(whole.cells)
    cells = {tuple(sorted(cell)) for cell in whole.cells.tolist()}
    assert all(tuple(sorted(cell)) in cells for cell in index[part.cells].tolist())
    assert set(range(len(part.nodes))) == set(part.cells.reshape(-1).tolist())
    for face in faces:
        on = part.nodes_on_face(face)
        assert on.any() and (part.nodes[on, "xyz".index(face[0])] == 0.0).all()


def test_a_quarter_of_the_plate_moves_as_the_whole_plate():
    """Fig. 13: graded cells of any shape, the hole on two planes, coupled; probes read the same."""
    line = LineProbe(kind="line", name="axis", start=(0.0, 0.0, 0.3), stop=(9.9, 0.0, 0.3), n=23)
    edge = line.model_copy(update={"start": (0.0, 7.0, 0.0), "stop": (10.0, 7.0, 0.0)})
    top = (0.0, PLATE[2], 0.0)
    bodies = [solve(plate(faces, "coupled"))[0] for faces in ((), ("x-", "y-"))]
    assert gap(*bodies) <= 10 * SOLVED
    fields = [body.fields(body.state.u) for body in bodies]
    size = np.abs(fields[0].u_points).max()
    for probe in (line, edge):
        whole, part = (measure_line(b.geometry, f, probe) for b, f in zip(bodies, fields, strict=True))
        assert (whole.kind == part.kind).all() and (part.kind != "").sum() > 15
        difference = np.nan_to_num(whole.displacement) - np.nan_to_num(part.displacement)
        assert np.abs(difference).max() <= 10 * SOLVED * size
    on_plane = [displacement_at(b.geometry, f, top) for b, f in zip(bodies, fields, strict=True)]
    assert on_plane[1][0] == 0.0 and np.abs(on_plane[0] - on_plane[1]).max() <= 10 * SOLVED * size


@pytest.mark.parametrize(
    ("model", "faces"),
    [("peridynamics", EIGHTH), *(pytest.param("elements", f, marks=pytest.mark.slow) for f in (HALF, ("y-", "z-")))],
)
def test_bar_probes_read_the_same_of_a_part(model, faces):
    """Displacements and strains of the layers of the modelled part."""
    probe = BarProbe(kind="bar", axis="x", stress=5.0)
    bars = []
    for f in ((), faces):
        scene = box(model, f, loads=(PULL, PUSH))
        body = solve(scene)[0]
        bars.append(measure_bar(scene, body.geometry, body.fields(body.state.u), probe, 1.0))
    whole, part = bars
    n = len(part.coordinate)
    size = np.abs(whole.displacement).max()
    assert part.coordinate == pytest.approx(whole.coordinate[-n:], abs=1e-12)
    assert part.exact == pytest.approx(whole.exact[-n:], abs=1e-12)
    assert np.abs(part.displacement - whole.displacement[-n:]).max() <= 10 * SOLVED * size
    assert part.lateral_strain == pytest.approx(whole.lateral_strain[-n:], rel=1e-9)


def test_bonds_of_the_parts_are_those_of_the_whole_body():
    """Every bond of the whole body is in one of its eight parts, those from a point to its image shared by two."""
    whole, part = (build(box("peridynamics", faces), loaded=False).model for faces in ((), ("x-", "y-", "z-")))
    x = geometry_of(box("peridynamics", ("x-", "y-", "z-"))).point_positions
    own = 0  # bonds between a point and its image, through one, two or three planes
    for sign in ((d, e, f) for d in (0, 2) for e in (0, 2) for f in (0, 2) if d or e or f):
        own += np.count_nonzero(np.linalg.norm(np.array(sign) * x, axis=1) <= 2.5)
    assert own > 0
    assert whole.bonds.count == 8 * part.bonds.count - 4 * own


@pytest.mark.slow
def test_the_quarter_deck_is_a_quarter_of_the_plate(tmp_path):
    """jobs/plate_quarter.toml, and an eighth by its own remark, against jobs/plate_coupled.toml on coarse cells."""
    coarse = ("mesh.spacing=0.1", "solver.tolerance=1e-11")
    top = "probes=[{kind='displacement', name='right_end', point=[4.5, 0.0, 0.0]}, {kind='displacement', " + (
        "name='bottom_of_hole', point=[0.0, -0.4, 0.0]}]"
    )
    whole = run_deck("plate_coupled.toml", tmp_path / "whole", *coarse, top)
    quarter = run_deck("plate_quarter.toml", tmp_path / "quarter", *coarse)
    eighth = ('mesh.symmetry=["x-", "y+", "z-"]', "mesh.lower=[0.0, -1.5, 0.0]")
    eighth = run_deck("plate_quarter.toml", tmp_path / "eighth", *coarse, *eighth)
    assert quarter["mesh"]["symmetry"] == ["x-", "y+"]
    for part, n in ((quarter, 4), (eighth, 8)):
        assert part["counts"]["points"] * n == whole["counts"]["points"]
        assert 1.0 <= part["counts"]["undirected_bonds"] * n / whole["counts"]["undirected_bonds"] < 1.01
        # 1e-11 is near the round-off of residuals, 3e-12, another one in the whole: it may take one step more
        assert abs(part["solve"]["evaluations"] - whole["solve"]["evaluations"]) <= 1
        for name in ("right_end", "bottom_of_hole"):
            expected = np.array(whole["probes"][name])
            assert np.abs(np.array(part["probes"][name]) - expected).max() <= 10 * SOLVED * np.abs(expected).max()


def test_two_materials_in_a_part():
    """Bonds to images have the modulus of the weaker of both cells' materials, surfaces the correction of their own."""
    sides = (
        Region(name="soft", model="peridynamics", upper=(0.0, 9.0, 9.0)),
        Region(name="stiff", model="peridynamics", lower=(0.0, -9.0, -9.0), material="steel"),
    )
    steel = {"steel": Material(youngs_modulus=5000.0)}
    scenes = (box("peridynamics", faces) for faces in ((), ("y-", "z-")))
    bodies = [solve(scene.model_copy(update={"regions": sides, "materials": steel}))[0] for scene in scenes]
    assert gap(*bodies) <= SOLVED
