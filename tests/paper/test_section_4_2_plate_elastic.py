"""Section 4.2: the plate with a circular cutout without failure, by finite elements, peridynamics, and coupled."""

import csv

import numpy as np
import pytest
import skfem
from skfem.models.elasticity import lame_parameters

from pdfem_mpi import Simulation
from pdfem_mpi.deck.meshes import PlateWithHoleMesh
from pdfem_mpi.deck.toml import parse_deck
from pdfem_mpi.kernels.hex8 import GAUSS_POINTS
from pdfem_mpi.measure.fields import gather_fields
from pdfem_mpi.measure.tensors import matrices
from pdfem_mpi.stepping import follow_load_program, make_solver
from support.bodies import build, run_deck
from support.helpers import ROOT
from support.reporters import Silence
from support.scikit import trilinear_elements

STRAIN, HALF_LENGTH, HALF_WIDTH, RADIUS = 1.0e-3, 4.5, 1.5, 0.4  # far from the hole; in
POISSONS_RATIO = 0.25

STRESS_AGREEMENT = 1e-9  # of the largest stress: residuals of 1e-12 and of a direct solution
AGREEMENT = 1e-8  # relative to the largest displacement: two solvers, residuals of 1e-11 and of a direct solution

# Howland's strip under tension, gross stress: Heywood's 2 + (1 - d/W)^3 over 1 - d/W, within 1 % of it
WIDTH_LEFT = 1.0 - RADIUS / HALF_WIDTH
CONCENTRATION = (2.0 + WIDTH_LEFT**3) / WIDTH_LEFT
# Mean strain of the edges at the top of the rim, of a polygon of 16 and 32 sides, with one and two linear elements
# through the thickness: measured 8 % and 3 % below
CONCENTRATION_ERROR = {0.2: 0.10, 0.1: 0.04}

# Fig. 15: "close agreement" of u_x, "also good correlation" of u_y with larger deviations. In the end displacement
# (u_x) and in nu eps b / 2 (u_y). Surfaces are soft, and with cells of 0.1 in every point of this plate is near one:
# measured 4.1 % and 6.8 % in u_x, 12 % in u_y; with the cells of the paper the coupled plate has 2.9 % and 6.8 %.
COUPLED_GAP, PD_GAP, VERTICAL_GAP = 0.05, 0.08, 0.15
HOLE_AGREEMENT = 0.01  # "in agreement near the cutout since both methods use the peridynamic theory"; measured .3 %
SYMMETRY = 1e-6  # of the end displacement: the decks' tolerance; measured 1e-8


@pytest.fixture(scope="module")
def coarse(tmp_path_factory):
    """Summaries and bottom lines of the decks with cells of 0.1 in, each run once."""
    found = {}

    def run(model):
        if model not in found:
            out = tmp_path_factory.mktemp(model)
            summary = run_deck(f"plate_{model}.toml", out, "mesh.spacing=0.1")
            with open(out / "lines" / "bottom.csv", newline="", encoding="utf-8") as file:
                rows = list(csv.DictReader(file))
            line = {name: np.array([float(row[name]) for row in rows]) for name in ("x", "y", "z", "u_x", "u_y", "u_z")}
            found[model] = summary, line | {"model": np.array([row["model"] for row in rows])}
        return found[model]

    return run


def elements_scene(spacing, tolerance):
    """The finite-element deck."""
    text = (ROOT / "jobs" / "plate_fe.toml").read_text(encoding="utf-8")
    return parse_deck(text, "plate_fe.toml", (f"mesh.spacing={spacing}", f"solver.tolerance={tolerance}"))


def elements(spacing, tolerance):
    """Mesh and nodal displacements of the finite-element deck."""
    scene = elements_scene(spacing, tolerance)
    body = build(scene)
    solve = make_solver(scene, body.share, body.forces, body.case, Silence().line)
    steps = follow_load_program(scene, solve, None, body.state, body.case)
    assert len(list(steps)) == 1
    return scene, body.share.mesh, gather_fields(body.share, body.forces, body.state.u).u_nodes


def without_rigid_motion(x, u):
    """Displacements less the rigid motion that fits them best, by least squares over the nodes."""
    modes = np.zeros((6, len(x), 3))
    for d in range(3):
        modes[d, :, d] = 1.0
        modes[3 + d, :, (d + 1) % 3], modes[3 + d, :, (d + 2) % 3] = -x[:, (d + 2) % 3], x[:, (d + 1) % 3]
    modes = modes.reshape(6, -1).T
    return u - (modes @ np.linalg.lstsq(modes, u.reshape(-1), rcond=None)[0]).reshape(-1, 3)


def reference_solution(scene, mesh):
    """The same mesh, quadrature and loads by scikit-fem, held at three nodes."""
    material = scene.material
    body, element, stiffness, dofs = trilinear_elements(mesh, material.youngs_modulus, material.poissons_ratio)
    load = np.zeros(stiffness.shape[0])
    for sign in (-1.0, 1.0):
        facets = body.facets_satisfying(lambda x, end=sign * HALF_LENGTH: np.abs(x[0] - end) < 1e-9)
        area = 4.0 * HALF_WIDTH * 0.1
        traction = skfem.LinearForm(lambda v, w, pull=sign * 6000.0 / area: pull * v[0])
        load += skfem.asm(traction, skfem.FacetBasis(body, element, facets=facets, intorder=3))
    # node 0 in all directions, a node at the other end of its edge along x in y and z, one along y in z
    far_x = int(np.argmin(np.linalg.norm(mesh.nodes - [HALF_LENGTH, -HALF_WIDTH, -0.1], axis=1)))
    far_y = int(np.argmin(np.linalg.norm(mesh.nodes - [-HALF_LENGTH, HALF_WIDTH, -0.1], axis=1)))
    held = np.concatenate([dofs[:, 0], dofs[1:, far_x], dofs[2:, far_y]])
    u = skfem.solve(*skfem.condense(stiffness, load, D=held))
    return u[dofs].T


@pytest.mark.parametrize("spacing", [0.2, pytest.param(0.1, marks=pytest.mark.slow)])
def test_finite_elements_agree_with_scikit_fem(spacing):
    """The FE plate of Fig. 15 equals scikit-fem's on the same mesh of distorted hexahedra, consistent loads."""
    scene, mesh, u = elements(spacing, 1e-11)
    expected = without_rigid_motion(mesh.nodes, reference_solution(scene, mesh))
    error = np.abs(without_rigid_motion(mesh.nodes, u) - expected).max() / np.abs(expected).max()
    assert error <= AGREEMENT, f"largest difference {error:.2e} of the largest displacement"


def reference_stress(scene, mesh, u):
    """Stress at the Gauss points of every cell by scikit-fem's own gradients, shape (n_cells, 8, 3, 3)."""
    material = scene.material
    body, element, _, dofs = trilinear_elements(mesh, material.youngs_modulus, material.poissons_ratio)
    flat = np.zeros(dofs.size)
    flat[dofs.T] = u
    gauss = np.ascontiguousarray(0.5 * (GAUSS_POINTS.T + 1.0))
    basis = skfem.Basis(body, element, quadrature=(gauss, np.full(8, 1.0 / 8.0)))
    gradient = np.moveaxis(basis.interpolate(flat).grad, (2, 3), (0, 1))
    strain = 0.5 * (gradient + gradient.swapaxes(2, 3))
    lam, mu = lame_parameters(material.youngs_modulus, material.poissons_ratio)
    return 2.0 * mu * strain + lam * np.trace(strain, axis1=2, axis2=3)[..., None, None] * np.eye(3)


def test_stresses_agree_with_scikit_fem():
    """At every Gauss point of the FE plate of Fig. 15, two programs' own solutions, beside the hole as well."""
    scene = elements_scene(0.2, 1e-12)
    simulation = Simulation(scene)
    simulation.solve(1.0)
    fields, mesh = simulation.fields("stress_at_gauss_points"), simulation.share.mesh
    found = matrices(fields.of_cells["stress_at_gauss_points"].reshape(-1, 8, 6))
    expected = reference_stress(scene, mesh, reference_solution(scene, mesh))
    error = np.abs(found - expected).max() / np.abs(expected).max()
    assert error <= STRESS_AGREEMENT, f"largest difference {error:.2e} of the largest stress"


def hoop_strain_at_the_top(spacing):
    """Stretch of the two edges of the hole's rim at its top, mean over the thickness."""
    _, mesh, u = elements(spacing, 1e-8)
    x = mesh.nodes
    rim = np.flatnonzero((np.abs(np.hypot(x[:, 0], x[:, 1]) - RADIUS) < 1e-9) & (x[:, 1] > 0.0))
    rim = rim[np.lexsort((x[rim, 0], x[rim, 2]))].reshape(len(np.unique(x[:, 2])), -1)
    n = rim.shape[1]
    near = rim[:, n // 2 - 1 : n // 2 + 2] if n % 2 else rim[:, n // 2 - 1 : n // 2 + 1]
    chord, opening = np.diff(x[near], axis=1), np.diff(u[near], axis=1)
    return float(((chord * opening).sum(axis=2) / (chord**2).sum(axis=2)).mean())


def test_stress_concentration_approaches_that_of_a_strip():
    """Stress at the top of the hole over 1e4 psi: from below toward 3.26 for d/W = 0.8/3 (3 in an infinite plate)."""
    found = {spacing: hoop_strain_at_the_top(spacing) / STRAIN for spacing in CONCENTRATION_ERROR}
    assert found[0.2] < found[0.1] < CONCENTRATION, found
    for spacing, bound in CONCENTRATION_ERROR.items():
        assert found[spacing] == pytest.approx(CONCENTRATION, rel=bound), found


@pytest.mark.parametrize("model", ["fe", "pd", "coupled"])
def test_bottom_line_is_symmetric(coarse, model):
    """Fig. 15: u_x is antisymmetric and u_y symmetric about x = 0, and nothing leaves the middle plane."""
    summary, line = coarse(model)
    end = summary["probes"]["right_end"][0]
    np.testing.assert_allclose(line["u_x"], -line["u_x"][::-1], rtol=0, atol=SYMMETRY * end)
    np.testing.assert_allclose(line["u_y"], line["u_y"][::-1], rtol=0, atol=SYMMETRY * end)
    np.testing.assert_allclose(line["u_z"], 0.0, rtol=0, atol=SYMMETRY * end)
    assert (line["model"] == line["model"][::-1]).all()


def test_bottom_line_tells_the_models_apart(coarse):
    """Region 1 and the interface x = -2, 2 are finite elements, regions 2 and 3 peridynamics."""
    line = coarse("coupled")[1]
    peridynamic = np.abs(line["x"]) < 2.0 - 1e-9
    np.testing.assert_array_equal(line["model"] == "peridynamics", peridynamic)
    np.testing.assert_array_equal(line["model"] == "finite elements", ~peridynamic)
    assert set(coarse("fe")[1]["model"]) == {"finite elements"}
    assert set(coarse("pd")[1]["model"]) == {"peridynamics"}


def test_finite_elements_far_from_the_hole_are_a_bar(coarse):
    """At the ends the strain is 1e-3 and u_y of the bottom edge nu times it times b / 2, less the hole's far field."""
    line = coarse("fe")[1]
    end = line["x"] > 4.0
    slope = np.polyfit(line["x"][end], line["u_x"][end], 1)[0]
    # the hole's field in a strip falls as exp(-pi x / b): what it leaves at x > 4 is measured as .03 % and .3 %
    assert slope == pytest.approx(STRAIN, rel=0.001)
    assert line["u_y"][-1] == pytest.approx(POISSONS_RATIO * STRAIN * HALF_WIDTH, rel=0.01)


def gap(coarse, model, component):
    """Largest difference to finite elements along the bottom line."""
    return float(np.abs(coarse(model)[1][component] - coarse("fe")[1][component]).max())


def test_horizontal_displacements_are_in_close_agreement(coarse):
    """Fig. 15, left: coupled and PD plates follow the FE plate; the coupled one, stiffer, is the nearer."""
    end = coarse("fe")[1]["u_x"][-1]
    assert gap(coarse, "coupled", "u_x") <= COUPLED_GAP * end
    assert gap(coarse, "coupled", "u_x") < gap(coarse, "pd", "u_x") <= PD_GAP * end


def test_vertical_displacements_deviate_more_than_horizontal_ones(coarse):
    """Fig. 15, right: "the deviation is more significant for vertical displacements", relative to their size."""
    fe = coarse("fe")[1]
    for model in ("coupled", "pd"):
        of_u_x = gap(coarse, model, "u_x") / fe["u_x"].max()
        of_u_y = gap(coarse, model, "u_y") / fe["u_y"].max()
        assert of_u_x < of_u_y <= VERTICAL_GAP


def test_coupled_and_peridynamic_plates_agree_near_the_cutout(coarse):
    """Fig. 15, right: "in agreement near the cutout since both methods use the peridynamic theory in this region"."""
    tops = [coarse(model)[0]["probes"]["top_of_hole"][1] for model in ("coupled", "pd")]
    assert tops[0] == pytest.approx(tops[1], rel=HOLE_AGREEMENT)
    middle = np.abs(coarse("pd")[1]["x"]) <= 1.0
    coupled, pd = (coarse(model)[1]["u_y"][middle] for model in ("coupled", "pd"))
    np.testing.assert_allclose(coupled, pd, rtol=HOLE_AGREEMENT)


def test_plate_of_the_paper_is_what_the_decks_say(coarse):
    """9 x 3 x 0.2 in, r = 0.4 in; l_f, l_b, l_p = 2.5, 0.5, 3 in; the mesh's quality is in the summary."""
    text = (ROOT / "jobs" / "plate_coupled.toml").read_text(encoding="utf-8")
    scene = parse_deck(text, "plate_coupled.toml")
    assert isinstance(scene.mesh, PlateWithHoleMesh) and scene.mesh.hole_radius == RADIUS
    assert [region.model for region in scene.regions].count("peridynamics") == 3
    assert scene.peridynamics.lengths(scene.mesh.spacing) == (0.05, 0.125)
    summary = coarse("coupled")[0]
    assert summary["mesh"]["kind"] == "plate_with_hole"
    assert summary["mesh"]["smallest_scaled_jacobian"] >= 0.9
    # two layers of 40 x 30 cells, in each a ring of 32 instead of a square of 8 x 8
    assert summary["counts"]["points"] == 8 * (summary["counts"]["overlap_cells"] + 2 * (40 * 30 - 64 + 32))
    assert summary["counts"]["overlap_cells"] == 2 * 30 * 2
