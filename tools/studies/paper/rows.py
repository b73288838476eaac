"""The rows of docs/paper.md: what the paper claims, its value, and where it is done and tested here.

``{names}`` in the texts are numbers measured by paper_report.py. Files are relative to the repository, modules to
pdfem_mpi/, tests to tests/.
"""

from __future__ import annotations

from typing import NamedTuple


class FigureRow(NamedTuple):
    """A figure of the paper: claim, paper's value, ours, exact, remark, and the tests (``file::name``)."""

    figure: str
    claim: str
    paper: str
    ours: str
    exact: str
    remark: str
    tests: tuple[str, ...] = ()


class EquationRow(NamedTuple):
    """An equation of the paper: what it says, the code (``file:name``), the tests, and how it is read here."""

    equation: str
    says: str
    code: tuple[str, ...]
    tests: tuple[str, ...]
    remark: str = ""


BAR = "verification/test_section_4_1_bar.py"
PLATE = "verification/test_section_4_2_plate_elastic.py"
RESPONSE = "verification/test_section_2_response.py"
MATERIALS = "verification/test_section_2_1_materials.py"
COUPLING = "verification/test_section_3_2_coupling.py"
DENSITIES = "verification/test_section_3_densities.py"
APPENDIX_A = "verification/test_appendix_a.py"
APPENDIX_B = "verification/test_appendix_b.py"
BOND_KERNELS = "unit/kernels/test_peridynamics.py"
ELEMENT_KERNELS = "unit/kernels/test_finite_elements.py"
RELAXATION = "unit/kernels/test_relaxation.py"

FIGURES = (
    FigureRow(
        "1",
        "points interact in pairs within their range",
        "drawing",
        "{bar_bonds:,} bonds of the bar's {bar_points:,} points",
        "every pair within r_c",
        "a pair is found once, whatever the ranks",
        ("unit/kernels/test_families.py::test_rows_hold_each_pair_once",),
    ),
    FigureRow(
        "2",
        "interactions become more local as the internal length falls",
        "curves for several l",
        "stored bonds within {locality_error:.0e} of eq. 2 (figure below)",
        "c exp(-r^2/l^2), c = 9k/(pi l^4)",
        "bonds are stored in single precision",
        (f"{RESPONSE}::test_constant_of_the_response_gives_the_bulk_modulus",),
    ),
    FigureRow(
        "3",
        "xi, eta and the deformed bond",
        "eta = u - u'",
        "eta = u' - u",
        "-",
        "the printed sign pushes a stretched bond apart, with xi = x' - x",
        (f"{RESPONSE}::test_forces_of_a_small_body_are_those_printed",),
    ),
    FigureRow(
        "4",
        "a bond is linear in the stretch until s_0, then it is gone",
        "straight line, then 0",
        "one bond of the program, {bond_law_error:.0e} off the line (figure below)",
        "eqs 2, 4",
        "the drop is the rule of eq. 4; G_c = 27 sqrt(pi)/16 k l s_0^2 = {fracture_constant:.4f} k l s_0^2, with the "
        "cutoff {fracture_cutoff:.4f}; a cut through the inside of a body takes {release_one:.3f} of that with l = "
        "Delta, {release_more:.3f} with l = 1.5 Delta",
        (
            f"{RESPONSE}::test_fracture_energy_formula",
            f"{RESPONSE}::test_critical_stretch_of_a_fracture_energy",
            f"{RESPONSE}::test_release_rate_of_a_cut_plane_approaches_the_formula",
            f"{RESPONSE}::test_fracture_energy_of_a_plate_is_that_of_its_own_bonds",
            f"{BOND_KERNELS}::test_bonds_beyond_the_critical_stretch_break",
        ),
    ),
    FigureRow(
        "5",
        "under constant stretch the force falls with distance, where Silling and Askari's is constant",
        "two curves",
        "figure below",
        "18k/(pi r_c^4) for theirs",
        "both give the same bulk modulus; r_c = 2.5 l keeps .98600 of it",
        (f"{RESPONSE}::test_stiffness_that_the_cutoff_keeps",),
    ),
    FigureRow(
        "6",
        "bonds within two materials and across their interface",
        "drawing",
        "`[materials.NAME]`, `regions.N.material`, `[[interfaces]]`: `docs/materials.md`",
        "-",
        "the interface takes the side with the smaller bulk modulus, as in sec. 2.1, or values of its own",
        (f"{MATERIALS}::test_bar_of_two_materials_in_a_row", f"{MATERIALS}::test_ball_in_a_strained_body"),
    ),
    FigureRow(
        "7",
        "tractions have no place in peridynamics: the parts of a body act on each other through volumes",
        "drawing, eqs 6-8",
        "loads of bonds are body forces over layers of cells, supports hold layers",
        "-",
        "a traction on bonds is refused by name",
        ("unit/model/test_loads.py::test_traction_on_peridynamic_faces_is_refused",),
    ),
    FigureRow(
        "8",
        "hexahedra with eight integration points each",
        "drawing",
        "2x2x2 Gauss points of any hexahedron",
        "volumes add up exactly",
        "",
        ("unit/kernels/test_hex8.py::test_volumes_fill_a_distorted_cell",),
    ),
    FigureRow(
        "9",
        "points near surfaces have lost a part of their family",
        "drawing",
        "G/g_inf {g_face:.3f} at a face, {g_edge:.3f} at an edge, {g_corner:.3f} at a corner, {g_inside:.3f} inside",
        "1",
        "before the correction, outermost Gauss points of a block",
        (f"{APPENDIX_A}::test_response_before_the_correction",),
    ),
    FigureRow(
        "10",
        "elements and bonds share an overlap",
        "drawing; its size is not printed",
        "one layer of cells on the side of the elements, `coupling.overlap` for more",
        "-",
        "two readings, B and A, see eq. 26",
        (f"{COUPLING}::test_linear_operator_is_symmetric",),
    ),
    FigureRow(
        "11",
        "bar of 10 x 0.4 x 0.4 in, half elements, half bonds, cells of 0.05 in",
        "200 x 8 x 8 cells",
        "{bar_cells} cells (figure below)",
        "-",
        "`jobs/bar_tension.toml`, `bar_pd.toml`, `bar_fe.toml`",
        (f"{BAR}::test_full_size_coupled_bar",),
    ),
    FigureRow(
        "12",
        "peridynamics and elements differ by about 5 %",
        "about 5 %",
        "{bar_pd_gap:.2f} % of the end displacement",
        "0; finite elements {bar_fe_gap:.0e} %",
        "not the surfaces: appendix A multiplies every inner bond by {g_c_inside:.4f}, because the Gauss sum "
        "overestimates its first moment by 6.3 % while stiffness, a third moment, was 1.8 % low; E/E0 = {bar_pd_e:.4f}",
        (f"{BAR}::test_full_size_pd_bar", f"{BAR}::test_coarse_pd_bar_is_longer_by_the_printed_gap"),
    ),
    FigureRow(
        "12",
        "the coupled bar lies between, with a small jump",
        "small jump, from Poisson's ratio",
        "{bar_b_gap:+.2f} % (B), {bar_a_gap:+.2f} % (A); jump {bar_b_jump:+.3f} (B), {bar_a_jump:+.3f} (A) of strain "
        "times cell edge",
        "0, 0",
        "nu of the bonds is {bar_pd_nu:.4f}; the jump is in u_x too, because the overlap's bonds end there (B) or the "
        "overlap is counted twice (A); patch tests of six strains: worst {patch_b:.2f} (B), {patch_a:.2f} (A) of "
        "strain times edge",
        (
            f"{BAR}::test_coarse_coupled_bar_lies_between_with_a_small_jump",
            "verification/test_patch_tests.py::test_couplings_of_the_paper_miss_uniform_strains_at_the_interface",
        ),
    ),
    FigureRow(
        "13",
        "plate of 9 x 3 x 0.2 in with a hole of 0.4 in radius; l_f, l_b, l_p = 2.5, 0.5, 3 in",
        "printed",
        "the same (figure below)",
        "-",
        "`jobs/plate_coupled.toml`, `plate_pd.toml`, `plate_fe.toml`",
        (f"{PLATE}::test_plate_of_the_paper_is_what_the_decks_say",),
    ),
    FigureRow(
        "14",
        "hexahedra with edges of approximately 0.05 in",
        "0.05 in",
        "{plate_shortest:.3f} to {plate_longest:.3f} in, scaled Jacobian at least {plate_jacobian:.2f} (figure below)",
        "-",
        "graded cells around the hole, cubes elsewhere; l is 0.05 in as printed",
        (f"{PLATE}::test_finite_elements_agree_with_scikit_fem",),
    ),
    FigureRow(
        "15",
        "horizontal displacements agree closely",
        "close agreement",
        "largest difference from elements, in % of the end's: peridynamics {plate_pd_x:.1f}, coupled {plate_b_x:.1f} "
        "(B), {plate_a_x:.1f} (A)",
        "elements agree with scikit-fem on the same cells to 1e-8",
        "the bonds' softness of fig. 12, along 9 or 4 in of bonds",
        (f"{PLATE}::test_horizontal_displacements_are_in_close_agreement",),
    ),
    FigureRow(
        "15",
        "vertical displacements deviate more; coupled and peridynamics agree near the cutout",
        "more significant",
        "largest difference from elements, in % of the largest: peridynamics {plate_pd_y:.1f}, coupled "
        "{plate_b_y:.1f}; coupled against peridynamics at the top of the hole {plate_hole:.2f} %",
        "-",
        "a plate of four cells has nu above the lattice's .24 (fig. B2), and bonds are soft",
        (
            f"{PLATE}::test_vertical_displacements_deviate_more_than_horizontal_ones",
            f"{PLATE}::test_coupled_and_peridynamic_plates_agree_near_the_cutout",
        ),
    ),
    FigureRow(
        "16",
        "local damage of .38 is extensive damage, not necessarily separation; .5 indicates separation",
        ".38, .5",
        "beside a complete flat crack {damage_first:.4f} in the first layer of points, {damage_second:.4f} in the "
        "second, {damage_third:.4f} in the third",
        "{damage_first:.4f} by eq. 5",
        "so .38 is separation and .5 is never reached beside a plane crack between cells: take .35 as the threshold; "
        "`[output] damage = true` writes it",
        (f"{RESPONSE}::test_damage_beside_a_full_crack",),
    ),
    FigureRow(
        "16",
        "cracks start at the cutout and run to the edges",
        "damage patterns",
        "{failure}",
        "-",
        "",
    ),
    FigureRow(
        "A1",
        "a body under uniaxial tension has responses that depend on direction near surfaces",
        "drawing",
        "face: {g_face:.3f} across, {g_face_along:.3f} along, of g_inf",
        "1",
        "",
        (f"{APPENDIX_A}::test_response_before_the_correction",),
    ),
    FigureRow(
        "A2",
        "the infinite domain, in cubes of r_c/50",
        "sum (A5)",
        "closed form {g_infinite:.6f} k/l per unit gradient",
        "9 (1 - nu) sqrt(pi)/4 k/l",
        "no cutoff, so the correction restores the tail too",
        (f"{APPENDIX_A}::test_response_of_an_infinite_body",),
    ),
    FigureRow(
        "A3",
        "the factor of a bond is an ellipsoid",
        "drawing",
        "g_ij of every bond by (A8)",
        "-",
        "",
        (f"{APPENDIX_A}::test_factor_of_a_bond_is_the_ellipsoid_of_the_mean_vector",),
    ),
    FigureRow(
        "A, text",
        "after about twenty iterations the coefficients hardly change",
        "20",
        "largest difference left {left_0:.3f}, {left_5:.3f}, {left_10:.4f}, {left_20:.4f} after 0, 5, 10, 20 sweeps",
        "0",
        "each sweep leaves .85; factors after 20: {g_c_inside:.4f} inside, {g_c_face:.3f} and {g_c_along:.3f} at a "
        "face, {g_c_corner:.3f} at a corner (figure below)",
        (
            f"{APPENDIX_A}::test_vectors_after_twenty_sweeps",
            f"{APPENDIX_A}::test_what_remains_of_the_difference",
            f"{APPENDIX_A}::test_change_after_twenty_sweeps_is_insignificant",
        ),
    ),
    FigureRow(
        "B1",
        "plate of 10 x 4 in, cells of 0.08 in, tension by 234375 lb/in^3 over 0.08 in",
        "printed",
        "the same",
        "stress 18750 psi, strain 1.875e-3",
        "`jobs/appendix_b_pd.toml`, `appendix_b_fe.toml`",
        (f"{APPENDIX_B}::test_finite_elements_hold_the_closed_form",),
    ),
    FigureRow(
        "B2",
        "Poisson's ratio falls with thickness from near 1/3 toward 1/4",
        "1/3 to 1/4",
        "l = Delta: {nu_thin:.3f} (one cell) to {nu_thick:.3f} ({thick_cells} cells)",
        "1/4",
        "toward the lattice's .24, not 1/4; one cell of thickness comes nearer to 1/3 the longer l is",
        (f"{APPENDIX_B}::test_poissons_ratio_falls_with_thickness_from_a_third_toward_a_quarter",),
    ),
    FigureRow(
        "B2",
        "it rises with the internal length, most in thin plates",
        "rises",
        "one cell thick: {nu_thin:.3f}, {nu_thin_long:.3f} for l = 1, {long_ratio:g} Delta; {thick_cells} cells: "
        "{nu_thick:.3f}, {nu_thick_long:.3f}",
        "1/4",
        "found",
        (f"{APPENDIX_B}::test_poissons_ratio_rises_with_the_internal_length",),
    ),
    FigureRow(
        "B3",
        "displacements converge to those of finite elements with thickness",
        "converge",
        "u_x over elements' {ux_thin:.3f} (one cell), {ux_thick:.3f} ({thick_cells} cells); u_y {uy_thin:.3f}, "
        "{uy_thick:.3f}",
        "1",
        "not found: thick bodies tend to E/E0 = .955 to .96 (fig. 12), u_x to 1.04 to 1.05; u_y deviates more in thin "
        "plates, as printed",
        (f"{APPENDIX_B}::test_displacements_fall_with_thickness_but_not_to_those_of_elements",),
    ),
    FigureRow(
        "B4",
        "no significant difference for a cutoff above 2.5 l",
        "0.2 in = 2.5 l",
        "u_x at r_c = 2.5 l {cutoff_change:.2f} % above that at {cutoff_last:g} l; at l {cutoff_first:.0f} % above",
        "-",
        "found",
        (f"{APPENDIX_B}::test_displacements_converge_with_the_cutoff_radius",),
    ),
    FigureRow(
        "B5",
        "displacements settle for l above the cell edge; short l loses stiffness",
        "l = 0.08 in = Delta",
        "u_x over elements' {length_table}",
        "1",
        "settles as printed, but short l gains stiffness and loses Poisson's ratio: the Gauss lattice by itself has "
        "{lattice_short}, without correction; it loses stiffness only below .4 Delta",
        (
            f"{APPENDIX_B}::test_displacements_settle_from_an_internal_length_of_a_cell_on",
            f"{APPENDIX_B}::test_short_internal_lengths_stiffen_the_gauss_lattice",
        ),
    ),
)

EQUATIONS = (
    EquationRow(
        "1",
        "equation of motion",
        ("model/forces.py:Forces",),
        ("unit/model/test_forces.py::test_forces_are_those_of_the_equations",),
        "its equilibrium; inertia serves relaxation only",
    ),
    EquationRow(
        "2",
        "response function",
        ("kernels/families.py:fill_rows", "kernels/peridynamics.py:add_forces_linear"),
        (f"{RESPONSE}::test_forces_of_a_small_body_are_those_printed", f"{BOND_KERNELS}::test_forces"),
        "c is right for an infinite cutoff; r_c = 2.5 l keeps .98600 of the stiffness",
    ),
    EquationRow(
        "3",
        "stretch",
        ("kernels/peridynamics.py:_series",),
        (f"{RESPONSE}::test_forces_of_a_small_body_are_those_printed", f"{BOND_KERNELS}::test_series_at_its_limit"),
        'from differences of displacements, without cancellation; `kinematics = "linear"` is its derivative',
    ),
    EquationRow(
        "4",
        "failure",
        ("kernels/peridynamics.py:_finite_sweep", "peridynamics/failure.py:Failure"),
        (
            f"{BOND_KERNELS}::test_bonds_beyond_the_critical_stretch_break",
            f"{BOND_KERNELS}::test_bonds_at_the_critical_stretch_hold",
        ),
        "s_0 from the fracture energy of this kernel, not of the constant one",
    ),
    EquationRow(
        "5",
        "local damage",
        ("peridynamics/damage.py:local_damage", "kernels/local_damage.py:add_bond_weights"),
        (
            f"{RESPONSE}::test_damage_of_every_point_is_the_ratio_of_eq_5",
            "mpi/test_damage.py::test_damage_does_not_depend_on_the_number_of_ranks",
        ),
        "w_j of the other point in both sums, no self term, bonds within r_c",
    ),
    EquationRow(
        "6",
        "force across a section, classical",
        ("model/loads.py:make_load_case",),
        ("unit/model/test_loads.py::test_consistent_nodal_loads_of_a_square_grid",),
        "tractions on elements, consistent or equal",
    ),
    EquationRow(
        "7",
        "force density from the other part",
        ("model/forces.py:Forces",),
        (f"{COUPLING}::test_internal_forces_sum_to_exactly_zero",),
        "",
    ),
    EquationRow(
        "8",
        "force across a section, peridynamic",
        ("stepping/report.py:support_resultants",),
        (f"{COUPLING}::test_bar_clamped_at_its_elements_and_pulled_at_its_points",),
        "reactions are sums over held volumes",
    ),
    EquationRow(
        "9",
        "collocation",
        ("kernels/hex8.py:gauss_positions", "kernels/families.py:find_rows"),
        ("unit/kernels/test_families.py::test_rows_hold_each_pair_once",),
        "w_j is printed with the index of another sum",
    ),
    EquationRow(
        "10",
        "relaxation of points",
        ("solvers/adr.py:solve",),
        ("unit/solvers/test_adr.py::test_one_iteration_by_hand",),
        "time step 1",
    ),
    EquationRow(
        "11",
        "fictitious densities",
        ("peridynamics/bonds.py:fictitious_masses", "kernels/peridynamics.py:add_densities"),
        (
            f"{DENSITIES}::test_peridynamic_densities_with_the_bond_factors",
            f"{DENSITIES}::test_peridynamic_densities_as_printed_are_unstable",
        ),
        "with g_ij: largest eigenvalue {eigenvalue:.2f}, limit 4; as printed, without g_ij, {eigenvalue_printed:.1f}: "
        "diverges",
    ),
    EquationRow(
        "12",
        "vector of positions",
        ("model/model.py:cluster_layout",),
        ("unit/model/test_forces.py::test_point_displacements_include_the_overlap",),
        "clusters of four points",
    ),
    EquationRow(
        "13",
        "vector of displacements",
        ("model/state.py:State",),
        ("unit/model/test_forces.py::test_point_displacements_include_the_overlap",),
        "",
    ),
    EquationRow(
        "14",
        "force density",
        ("kernels/peridynamics.py:read_forces",),
        (f"{BOND_KERNELS}::test_forces", "mpi/test_ranks.py::test_iterations_do_not_depend_on_the_number_of_ranks"),
        "the same bits in any order",
    ),
    EquationRow(
        "15",
        "element forces",
        ("kernels/finite_elements.py:element_stiffness", "kernels/finite_elements.py:add_general_forces"),
        (
            "verification/test_section_3_1_elements.py::test_internal_forces_equal_those_of_scikit_fem",
            f"{ELEMENT_KERNELS}::test_stiffness_equals_scikit_fem",
        ),
        "trilinear, 2x2x2 Gauss points, without SOLID45's extra shapes",
    ),
    EquationRow(
        "16",
        "assembly",
        ("kernels/finite_elements.py:add_shared_forces",),
        (
            "verification/test_patch_tests.py::test_distorted_elements_hold_every_uniform_strain",
            f"{ELEMENT_KERNELS}::test_forces_are_minus_k_u",
        ),
        "patch test on distorted cells: forces {patch_fe:.0e} of the largest",
    ),
    EquationRow(
        "17",
        "relaxation of nodes",
        ("solvers/adr.py:solve",),
        ("unit/solvers/test_adr.py::test_relaxation_ends_in_equilibrium",),
        "",
    ),
    EquationRow(
        "18",
        "external less internal force",
        ("model/forces.py:Forces",),
        ("unit/model/test_forces.py::test_external_forces_are_added",),
        "reading A lets the overlap's elements keep theirs",
    ),
    EquationRow(
        "19",
        "bound of the masses",
        ("kernels/finite_elements.py:element_masses",),
        (f"{DENSITIES}::test_every_model_is_stable",),
        "its 1/4 is lost in (22)",
    ),
    EquationRow(
        "20",
        "diagonal mass matrix",
        ("model/model.py:_masses",),
        (f"{DENSITIES}::test_masses_have_the_units_of_a_stiffness",),
        "",
    ),
    EquationRow(
        "21",
        "assembly of masses",
        ("model/model.py:assemble",),
        (f"{DENSITIES}::test_every_model_is_stable",),
        "",
    ),
    EquationRow(
        "22",
        "element masses",
        ("kernels/finite_elements.py:element_masses",),
        (f"{ELEMENT_KERNELS}::test_masses_are_a_quarter_of_the_row_sums_and_stable",),
        "1/4 of the sum over all 24; printed: 8 terms, no 1/4, twice the iterations",
    ),
    EquationRow(
        "23",
        "points outside and inside of the overlap",
        ("peridynamics/bonds.py:Points",),
        ("unit/body/test_discretization.py::test_reading_b_gives_the_overlap_points_and_no_stiffness",),
        "",
    ),
    EquationRow(
        "24",
        "nodes outside and inside of the overlap",
        ("model/model.py:Nodes",),
        ("unit/body/test_discretization.py::test_reading_a_keeps_the_stiffness_of_the_overlap",),
        "",
    ),
    EquationRow(
        "25",
        "points of the overlap move with the elements",
        ("kernels/overlap.py:interpolate",),
        ("unit/kernels/test_overlap.py::test_interpolation_is_the_shape_functions",),
        "",
    ),
    EquationRow(
        "26",
        "their forces are lumped into the nodes",
        ("kernels/overlap.py:lump",),
        (
            "unit/kernels/test_overlap.py::test_lump_is_the_adjoint_of_interpolate",
            f"{COUPLING}::test_linear_operator_is_symmetric",
        ),
        "the force density for rho g: the adjoint of (25). Reading B: nodes of the overlap get nothing else; reading "
        "A: also (18)",
    ),
    EquationRow(
        "27",
        "coupled system",
        ("model/forces.py:Forces", "solvers/adr.py:solve"),
        (f"{COUPLING}::test_net_force_and_moment_vanish",),
        "",
    ),
    EquationRow(
        "28",
        "its unknowns",
        ("model/state.py:State",),
        (f"{COUPLING}::test_there_are_no_other_motions_without_force",),
        "free points, then nodes",
    ),
    EquationRow(
        "29",
        "its masses",
        ("model/model.py:_masses",),
        (f"{DENSITIES}::test_masses_of_the_overlap_are_not_wasteful",),
        "nodes of the overlap carry the lumped densities of their points",
    ),
    EquationRow(
        "30",
        "its forces",
        ("model/forces.py:Forces",),
        (f"{COUPLING}::test_elements_at_rest_do_not_silence_the_overlap",),
        "",
    ),
    EquationRow(
        "31",
        "damping",
        ("solvers/adr.py:damping_coefficient", "kernels/relaxation.py:add_damping_sums"),
        ("unit/solvers/test_adr.py::test_damping_coefficient", f"{RELAXATION}::test_sums"),
        "0 where numerator or denominator is not positive, 1.9 where c would reach 2",
    ),
    EquationRow(
        "32",
        "local stiffness",
        ("kernels/relaxation.py:add_damping_sums",),
        (f"{RELAXATION}::test_a_ratio_that_is_not_finite_counts_as_zero",),
        "0 where the velocity is 0",
    ),
    EquationRow("33", "velocity", ("kernels/relaxation.py:advance",), (f"{RELAXATION}::test_advance",), ""),
    EquationRow("34", "displacement", ("kernels/relaxation.py:advance",), (f"{RELAXATION}::test_advance",), ""),
    EquationRow(
        "35",
        "first step",
        ("kernels/relaxation.py:advance",),
        (f"{RELAXATION}::test_the_first_step",),
        "F^0 for F^(1/2); any U^0",
    ),
    EquationRow(
        "A1",
        "uniaxial tension",
        ("kernels/surface_correction.py:add_responses",),
        (f"{APPENDIX_A}::test_response_before_the_correction",),
        "nu = 1/4; linear in the gradient, so its size does not matter",
    ),
    EquationRow(
        "A2",
        "response in x",
        ("kernels/surface_correction.py:add_responses",),
        ("unit/kernels/test_surface_correction.py::test_responses",),
        '"will become 2" has no meaning; the sum over both half-spaces',
    ),
    EquationRow(
        "A3",
        "response in y",
        ("kernels/surface_correction.py:add_responses",),
        ("unit/kernels/test_surface_correction.py::test_responses",),
        "",
    ),
    EquationRow(
        "A4",
        "three responses",
        ("kernels/surface_correction.py:add_responses",),
        (f"{APPENDIX_A}::test_response_before_the_correction",),
        "",
    ),
    EquationRow(
        "A5",
        "infinite domain",
        ("kernels/surface_correction.py:update_factors",),
        (f"{APPENDIX_A}::test_response_of_an_infinite_body",),
        "prefactor 8 for 2 over one octant; closed form {g_infinite:.6f} k/l",
    ),
    EquationRow(
        "A6",
        "its points",
        ("kernels/surface_correction.py:update_factors",),
        (f"{APPENDIX_A}::test_response_of_an_infinite_body",),
        "not needed by the closed form",
    ),
    EquationRow(
        "A7",
        "its displacements",
        ("kernels/surface_correction.py:update_factors",),
        (f"{APPENDIX_A}::test_response_of_an_infinite_body",),
        "not needed by the closed form",
    ),
    EquationRow(
        "A8",
        "ellipsoid",
        ("kernels/families.py:fill_rows",),
        (f"{APPENDIX_A}::test_factor_of_a_bond_is_the_ellipsoid_of_the_mean_vector",),
        "",
    ),
    EquationRow(
        "A9",
        "direction of a bond",
        ("kernels/families.py:fill_rows",),
        (f"{APPENDIX_A}::test_factor_of_a_bond_is_the_ellipsoid_of_the_mean_vector",),
        "",
    ),
    EquationRow(
        "A10",
        "mean vector of a bond",
        ("kernels/families.py:fill_rows",),
        (f"{APPENDIX_A}::test_factor_of_a_bond_is_the_ellipsoid_of_the_mean_vector",),
        "",
    ),
    EquationRow(
        "A11",
        "correction vector",
        ("kernels/surface_correction.py:update_factors",),
        (f"{APPENDIX_A}::test_vectors_after_twenty_sweeps",),
        "the update is multiplicative: g_c is multiplied by g_inf/G of the corrected bonds",
    ),
    EquationRow(
        "A12",
        "corrected equation of motion",
        ("peridynamics/bonds.py:make_bonds",),
        (f"{APPENDIX_A}::test_factor_of_a_bond_is_the_ellipsoid_of_the_mean_vector",),
        "g_ij is stored in the bond; E/E0 of the inner lattice {lattice_none:.4f} without, {lattice_a:.4f} with, nu "
        "{lattice_nu:.4f}, unrelaxed",
    ),
    EquationRow(
        "B1",
        "place x0",
        ("measure/probes.py:displacement_at",),
        ("unit/measure/test_probes.py::test_displacement_of_a_trilinear_field_is_exact",),
        "`[[probes]]` x0 of the decks",
    ),
    EquationRow(
        "B2",
        "displacement there",
        ("measure/probes.py:displacement_at",),
        (f"{APPENDIX_B}::test_finite_elements_hold_the_closed_form",),
        "",
    ),
    EquationRow(
        "B3",
        "Poisson's ratio",
        (),
        (f"{APPENDIX_B}::test_poissons_ratio_falls_with_thickness_from_a_third_toward_a_quarter",),
        "from columns of `study.csv`",
    ),
    EquationRow(
        "B4",
        "number of interactions",
        ("kernels/families.py:find_rows",),
        ("unit/kernels/test_families.py::test_rows_of_a_larger_body",),
        "a volume; counted here: 527 neighbours inside a body",
    ),
    EquationRow(
        "B5",
        "the largest number",
        ("kernels/families.py:find_rows",),
        ("unit/kernels/test_families.py::test_rows_of_a_larger_body",),
        "4/3 pi 2.5^3 8 = 524 points of the Gauss lattice, itself included",
    ),
)
