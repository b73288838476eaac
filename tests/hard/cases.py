"""The table of hard cases: one entry a run, by families. How they are judged is in `hard.judges`."""

from __future__ import annotations

from hard.judges import (
    adds_up,
    broken,
    counted_bonds,
    direct_solution,
    finite_equilibrium,
    follows_opening,
    modulus,
    nothing_moves,
    numbers,
    probe,
    refused,
    same_as_other,
    same_reactions,
    says,
    uniform_tension,
)
from hard.softening import CASES as SOFTENING
from hard.suite import BAD_DECK, NOT_CONVERGED, Case, moved, scaled

FITTED = "peridynamics.surface_correction=fitted"
BOUNDED = "peridynamics.signs=bounded"
FINITE = "peridynamics.kinematics=finite"
PULLED_APART = 'supports=[{face="x-",x=-0.1,y=0.0,z=0.0},{face="x+",x=0.1}]'
THIRD = 1.0 / 3.0
#: Fields are kept in single precision: errors below this cannot be told.
SINGLE = 1e-6
DIRECT = "a direct solution of the same equations, to 1e-6"
#: Bodies that can break are rounded to model units: other units, and places a whole number of cells away, change no
#: bit of these, and the last digit of what is told.
LAST = 1e-12
LAST_STATE = "as many rows and broken bonds, the last reaction to 1e-12 (places are rounded where bonds can break)"
PATCH = "u = 1e-3 x everywhere, to 1e-6 (exact patch tests, docs/fitted.md)"

#: The interface of the paper on fewer cells, pulled by supports, bonds without correction.
READING_B = (
    "peridynamics.surface_correction=none",
    "coupling.kind=paper",
    "mesh.upper=[6,4,4]",
    "regions.elements.upper=[3,2,2]",
    "regions.bonds.lower=[3,0,0]",
    "regions.bonds_beside.lower=[0,2,0]",
    "regions.bonds_beside.upper=[3,4,4]",
    "regions.bonds_above.lower=[0,0,2]",
    "regions.bonds_above.upper=[3,2,4]",
    "loads=[]",
    'supports=[{face="x-",x=-0.006},{face="x+",x=0.006},{face="y-",y=0.0},{face="z-",z=0.0}]',
    "probes=[]",
)


#: Loads of one state by two ways: each is read once a tenfold smaller residual moves it by at most 5e-4; 7e-5 is found.
SAME_STATE = 1e-4
#: Supports of the notched beam, and a program for it that does not follow the opening.
LEFT = '{name="left_roller",line=[[2,0,0],[2,0,1]],x=0.0,y=0.0}'
ROLLERS = f'{LEFT},{{line=[[22,0,0],[22,0,1]],y=0.0}},{{face="z-",z=0.0}}'
ENERGY = 'stepping={kind="events",control="energy",end_reaction=0.5,report_every=1}'


def only(model: str, *names: str) -> tuple[str, ...]:
    """Regions that get another model."""
    return tuple(f"regions.{name}.model={model}" for name in names)


CASES = (
    # 1
    Case(1, "interface, fitted", "interface_corner", PATCH, uniform_tension(1e-3, SINGLE), short=None),
    Case(1, "interface, positive factors", "interface_corner", PATCH, uniform_tension(1e-3, SINGLE), (BOUNDED,), None),
    Case(
        1,
        "interface, reading B",
        "interface_corner",
        DIRECT,
        direct_solution(SINGLE),
        READING_B,
    ),
    *(
        Case(
            1,
            f"interface, reading B, Poisson's ratio {nu}",
            "interface_corner",
            DIRECT,
            direct_solution(SINGLE),
            (*READING_B, f"material.poissons_ratio={nu}"),
        )
        for nu in (0.0, 0.1, 0.33, 0.45, 0.49)
    ),
    # 2
    Case(
        2,
        "crack to a band without damage",
        "crack_to_elements",
        "no broken bond beyond the band's edge x = 10, ledger to 1e-9",
        broken(crack_x_max=10.0, crack_x_min=4.0),
        short=("stepping.end_load_factor=0.6",),
    ),
    Case(
        2,
        "crack into the overlap",
        "crack_to_elements",
        "no broken bond beyond the overlap, x = 15, ledger to 1e-9",
        broken(crack_x_max=15.0, crack_x_min=4.0),
        ("regions.band.may_fail=true", "stepping.end_load_factor=1.2"),
        None,
    ),
    Case(
        2,
        "crack into the overlap, finite",
        "crack_to_elements",
        "no broken bond beyond the overlap, x = 15, ledger to 1.5e-3 (docs/failure.md)",
        broken(1.5e-3, crack_x_max=15.0, crack_x_min=4.0),
        ("regions.band.may_fail=true", "stepping.end_load_factor=0.9", FINITE),
        None,
    ),
    # 3
    Case(
        3,
        "twin cracks",
        "twin_cracks",
        "bounding box of broken bonds symmetric about x = 10 to 1e-9, even numbers, ledger to 1e-9",
        broken(mirror=10.0),
        (),
        ("stepping.end_load_factor=0.55",),
    ),
    Case(
        3,
        "twin cracks, energy control",
        "twin_cracks",
        "the same",
        broken(mirror=10.0),
        ("stepping.control=energy", "stepping.eta=0.03"),
        None,
    ),
    Case(
        3,
        "twin cracks, finite",
        "twin_cracks",
        "symmetric as before, ledger to 1e-4",
        broken(1e-4, mirror=10.0),
        (FINITE, "stepping.end_load_factor=0.6"),
        None,
    ),
    # 4
    Case(
        4,
        "fragments, dead loads",
        "fragments",
        "the loose block is told and held; ends by itself, ledger to 1e-9",
        says(broken(), "parts"),
    ),
    Case(
        4,
        "fragments, dead loads, finite",
        "fragments",
        "the same, ledger to 1.5e-3 (docs/failure.md)",
        says(broken(1.5e-3), "parts"),
        (FINITE,),
    ),
    Case(
        4,
        "fragments, ten times the load in one step",
        "fragments",
        "refused: what came apart, and how to follow it",
        refused(NOT_CONVERGED, "broken bonds", "came loose", "stepping.kind"),
        ('stepping={kind="steps", load_factors=[10.0]}',),
    ),
    Case(
        4,
        "fragments, pulled by supports in one step",
        "fragments",
        "refused: what came apart, and how to follow it",
        refused(NOT_CONVERGED, "broken bonds", "came loose", "stepping.kind"),
        ("loads=[]", PULLED_APART, 'stepping={kind="steps"}'),
        None,
    ),
    Case(
        4,
        "fragments, ramp of dead loads",
        "fragments",
        "the ramp ends where the body comes apart, below load factor 10",
        says(broken(None), "came apart"),
        ("solver.kind=adr", 'stepping={kind="ramp", increment=1e-2, end_load_factor=10.0, report_every=50}'),
        (),
    ),
    # 5
    Case(
        5,
        "thin plate, elements",
        "thin_plate",
        "u = 1e-3 x, exact",
        uniform_tension(1e-3, SINGLE),
        (*only("finite_elements", "plate"), "loads.0.kind=traction", "loads.1.kind=traction"),
    ),
    Case(
        5,
        "thin plate, bonds",
        "thin_plate",
        DIRECT,
        direct_solution(SINGLE),
        ("peridynamics.surface_correction=none",),
        ("mesh.upper=[12,5,1]",),
    ),
    Case(5, "thin plate, virial", "thin_plate", "E within 1.4 % (range for bars and plates)", modulus(0.014)),
    Case(
        5,
        "thin plate, fitted",
        "thin_plate",
        'says that "virial" takes its place; E within 1.4 %',
        says(modulus(0.014), 'Using "virial" instead', "needs two cells of thickness"),
        (FITTED,),
    ),
    # 6
    *(
        Case(
            6,
            f"bar, l = {length:g} Delta, r_c = {ratio:g} l",
            "internal_length",
            PATCH,
            uniform_tension(1e-3, SINGLE),
            (f"peridynamics.internal_length={length}", f"peridynamics.cutoff_radius={ratio * length}")
            + ((BOUNDED,) if length > 1.0 else ()),
            () if length < 1.0 else None,
        )
        for length, ratio in ((0.5, 2.5), (0.75, 2.5), (1.0, 1.5), (1.0, 2.5), (1.0, 3.5), (2.0, 2.5), (3.0, 2.5))
    ),
    Case(
        6,
        "bar, l = 2 Delta, factors of both signs",
        "internal_length",
        "refused: such bonds leave the body unstable; positive ones do not",
        refused(NOT_CONVERGED, "not positive definite", 'signs = "bounded"'),
        ("peridynamics.internal_length=2", "peridynamics.cutoff_radius=5"),
        None,
    ),
    Case(
        6,
        "bar, cutoff radius below the spacing",
        "internal_length",
        "refused with a radius that reaches the next cell",
        refused(BAD_DECK, "would not reach", "Use 2.5"),
        ("peridynamics.internal_length=0.5", "peridynamics.cutoff_radius=0.75"),
    ),
    # 7
    *(
        Case(
            7,
            f"{kind} ball, {what}",
            "contrast_ball",
            DIRECT + "; residual 1e-9",
            direct_solution(SINGLE),
            (
                *only("peridynamics", *bonded),
                f"materials.ball.youngs_modulus={modulus_of_ball:g}",
                *(("regions.ball.radius=2.7",) if bonded == ("cube",) else ()),
            ),
            None if bonded else (),
        )
        for kind, modulus_of_ball in (("hard", 1e10), ("soft", 1e4))
        for what, bonded in (
            ("elements", ()),
            ("bonds", ("cube", "ball")),
            ("elements in bonds", ("cube",)),
            ("bonds in elements", ("ball",)),
        )
    ),
    # 8
    *(
        Case(
            8,
            f"{word} elements",
            "distorted",
            "u = 1e-3 x, exact (patch test)",
            uniform_tension(1e-3, SINGLE),
            (f"mesh.path=meshes/{word}.inp",),
        )
        for word in ("jittered", "graded", "sheared", "aspect")
    ),
    *(
        Case(
            8,
            f"{word} bonds",
            "distorted",
            DIRECT,
            direct_solution(SINGLE),
            (
                f"mesh.path=meshes/{word}.inp",
                *only("peridynamics", "body"),
                *sets,
                'loads=[{kind="body_force",face="x+",total=[1.6e5,0,0]}]',
                'supports=[{face="x-",x=0.0,y=0.0,z=0.0}]',
                "probes=[]",
            ),
            None,
        )
        for word, *sets in (
            ("jittered",),
            ("graded", "peridynamics.internal_length=1.7"),
            ("sheared",),
            ("aspect", "peridynamics.internal_length=5"),
        )
    ),
    Case(
        8,
        "jittered bonds, fitted",
        "distorted",
        "u = 1e-3 x, to 6e-3: tractions on skewed faces miss the area vectors' last change (docs/fitted.md)",
        uniform_tension(1e-3, 6e-3),
        (*only("peridynamics", "body"), FITTED),
        None,
    ),
    Case(
        8,
        "sheared bonds, fitted",
        "distorted",
        "refused: factors of both signs leave the body unstable",
        refused(NOT_CONVERGED, "not positive definite", 'signs = "bounded"'),
        ("mesh.path=meshes/sheared.inp", *only("peridynamics", "body"), FITTED),
        None,
    ),
    # 9
    *(
        Case(
            9,
            f"rotation by {angle} degrees",
            "rotation",
            "no force (1e-12 of that of a strain of 1e-2), no broken bond",
            numbers(1e-12, "force", "broken"),
            program=f"rotation_{angle}",
        )
        for angle in (10, 90)
    ),
    Case(
        9,
        "rotation of elements and bonds by 90 degrees",
        "rotation",
        "no force (1e-12 of that of a strain of 1e-2), no broken bond",
        numbers(1e-12, "force", "broken"),
        (
            'regions=[{name="elements",model="finite_elements",upper=[5,3,3]},{name="bonds",model="peridynamics",lower=[5,0,0]}]',
            'loads=[{kind="traction",face="x-",total=[-1,0,0]},{kind="body_force",face="x+",total=[1,0,0]}]',
        ),
        program="rotation_90",
    ),
    # 10
    *(
        Case(
            10,
            f"{word} by 30 %, {solver}",
            "large_strain",
            "residual by square roots, bond by bond, below 1e-5 of the reaction (fields in single precision)",
            finite_equilibrium(1e-5),
            (f"supports.1.x={amount}", f"solver.kind={solver}"),
        )
        for word, amount in (("tension", 1.8), ("compression", -1.8))
        for solver in ("cg", "adr")
    ),
    # 11
    Case(11, "units as they are", "supports", DIRECT, direct_solution(SINGLE)),
    *(
        Case(
            11,
            f"lengths times {length:g}, forces times {force:g}",
            "supports",
            "the same, scaled, to 1e-12",
            same_as_other(1e-12, length, force),
            against="units as they are",
            change=scaled(length, force),
        )
        for length, force in ((1e-9, 1e-9), (1e9, 1e9), (1e-9, 1e9), (1e9, 1e-9), (1e-9, 1.0), (1e9, 1.0))
    ),
    Case(11, "failure, units as they are", "crack_to_elements", "ledger to 1e-9", broken(), short=None),
    *(
        Case(
            11,
            f"failure, lengths times {length:g}, forces times {force:g}",
            "crack_to_elements",
            LAST_STATE,
            same_as_other(LAST, length, force),
            against="failure, units as they are",
            change=scaled(length, force),
            short=None,
        )
        for length, force in ((1e-9, 1e-9), (1e9, 1e9))
    ),
    # 12
    Case(
        12,
        "far from the origin",
        "supports",
        "the same to 1e-7: places are rounded to 1e-9 of a cell; cells of a third, so that no place is a whole number",
        same_as_other(1e-7, THIRD),
        against="units as they are",
        change=lambda data: moved(8e6 * THIRD)(scaled(THIRD, 1.0)(data)),
    ),
    Case(
        12,
        "far from the origin, failure",
        "crack_to_elements",
        LAST_STATE,
        same_as_other(LAST, THIRD),
        against="failure, units as they are",
        change=lambda data: moved(1.8e7 * THIRD)(scaled(THIRD, 1.0)(data)),
        short=None,
    ),
    # 13
    Case(13, "hinge of one element", "hinge", DIRECT, direct_solution(SINGLE)),
    Case(13, "hinge of one cell of bonds", "hinge", DIRECT, direct_solution(SINGLE), only("peridynamics", "body")),
    Case(
        13,
        "blocks with a common edge",
        "hinge",
        "refused: the block, its rotation and the axis",
        refused(NOT_CONVERGED, "rotation about z", "mechanism"),
        ("mesh.path=meshes/edge.inp",),
    ),
    Case(
        13,
        "held at one node, loads that turn it",
        "hinge",
        "refused: the motion that nothing holds",
        refused(BAD_DECK, "not in balance", "no support holds"),
        ("mesh.path=meshes/one_node.inp", 'supports=[{set="CORNER",x=0.0,y=0.0,z=0.0}]'),
    ),
    Case(
        13,
        "held at one node, loads in balance",
        "hinge",
        "u = 1e-4 x, exact",
        uniform_tension(1e-4, SINGLE),
        (
            "mesh.path=meshes/one_node.inp",
            'supports=[{set="CORNER",x=0.0,y=0.0,z=0.0}]',
            'loads=[{kind="traction",face="x-",traction=[-1e3,0,0]},{kind="traction",face="x+",traction=[1e3,0,0]}]',
        ),
    ),
    # 14
    *(
        Case(
            14,
            f"{load} of {what}, {solver}",
            "slender",
            DIRECT if solver == "cg" else "a direct solution, to 1e-3",
            direct_solution(SINGLE if solver == "cg" else 1e-3),
            (
                f"regions.bar.model={model}",
                f"solver.kind={solver}",
                *(("loads.0.total=[0,0,1e3]", "loads.1.total=[0,0,-1e3]") if load == "torsion" else ()),
                *(("solver.tolerance=1e-6",) if solver == "adr" else ()),
            ),
            () if solver == "cg" else None,
        )
        for load in ("bending", "torsion")
        for what, model in (("bonds", "peridynamics"), ("elements", "finite_elements"))
        for solver in ("cg", "adr")
    ),
    # 15
    Case(
        15,
        "load step of 1e-12",
        "slender",
        DIRECT,
        direct_solution(SINGLE),
        ('stepping={kind="steps",load_factors=[1e-12]}',),
    ),
    Case(
        15,
        "load step of 1e-12, finite",
        "slender",
        "conjugate gradients find it; " + DIRECT,
        direct_solution(SINGLE),
        ('stepping={kind="steps",load_factors=[1e-12]}', FINITE, "solver.max_evaluations=200"),
    ),
    Case(
        15,
        "ten times the failure load in one step",
        "twin_cracks",
        "refused: how many bonds broke, what the solver met, and how to follow it",
        refused(NOT_CONVERGED, "broken bonds", "stagnate", "stepping.kind"),
        ('stepping={kind="steps",load_factors=[6.0]}',),
        None,
    ),
    # 16
    Case(
        16,
        "tolerance of 1e-15",
        "slender",
        "refused: round-off, with the residual that was reached",
        refused(NOT_CONVERGED, "round-off", "larger tolerance"),
        ("solver.tolerance=1e-15",),
    ),
    Case(
        16,
        "tolerance of 1e-15, relaxation",
        "slender",
        "refused: evaluations used up, with the residual that was reached",
        refused(NOT_CONVERGED, "max_evaluations", "larger tolerance"),
        ("solver.tolerance=1e-15", "solver.kind=adr", "solver.max_evaluations=20000"),
        ("solver.max_evaluations=500",),
    ),
    *(
        Case(
            16, f"no load, {solver}", "slender", "nothing moves", nothing_moves(), ("loads=[]", f"solver.kind={solver}")
        )
        for solver in ("cg", "adr")
    ),
    # 17
    Case(17, "bonds in one cell, enclosed by elements", "smallest", DIRECT, direct_solution(SINGLE)),
    Case(
        17,
        "elements enclosed by bonds",
        "smallest",
        DIRECT,
        direct_solution(SINGLE),
        (*only("peridynamics", "elements"), *only("finite_elements", "bonds"), "regions.bonds.radius=1.8"),
        ("mesh.upper=[5,5,3]", "regions.bonds.centre=[2.5,2.5,1.5]"),
    ),
    Case(
        17,
        "one element left beside the overlap",
        "smallest",
        DIRECT,
        direct_solution(SINGLE),
        (
            "mesh={lower=[0,0,0],upper=[7,1,1],spacing=1.0}",
            'regions=[{name="elements",model="finite_elements",upper=[2,1,1]},{name="bonds",model="peridynamics",lower=[2,0,0]}]',
        ),
    ),
    *(
        Case(
            17,
            f"overlap of {overlap}",
            "smallest",
            DIRECT,
            direct_solution(SINGLE),
            (
                "mesh={lower=[0,0,0],upper=[8,3,3],spacing=1.0}",
                'regions=[{name="elements",model="finite_elements",upper=[6,3,3]},{name="bonds",model="peridynamics",lower=[6,0,0]}]',
                f"coupling.overlap={overlap}",
            ),
        )
        for overlap in range(1, 6)
    ),
    Case(
        17,
        "overlap of 6",
        "smallest",
        "refused with the widest overlap",
        refused(BAD_DECK, "Use at most 5"),
        (
            "mesh={lower=[0,0,0],upper=[8,3,3],spacing=1.0}",
            'regions=[{name="elements",model="finite_elements",upper=[6,3,3]},{name="bonds",model="peridynamics",lower=[6,0,0]}]',
            "coupling.overlap=6",
        ),
    ),
    # 18
    *(
        Case(
            18,
            name,
            "eight_cells",
            "the same bits on one to eight ranks; a direct solution, to 1e-5",
            direct_solution(1e-5),
            sets,
            ranks=(1, 2, 3, 4, 5, 6, 7, 8),
        )
        for name, sets in (
            ("eight cells, coupled", ()),
            ("eight cells, relaxation", ("solver.kind=adr", "solver.tolerance=1e-7", "solver.max_evaluations=20000")),
            ("eight elements", ('regions=[{name="elements",model="finite_elements"}]',)),
            ("eight cells of bonds", ('regions=[{name="bonds",model="peridynamics"}]',)),
        )
    ),
    Case(
        18,
        "bar of 12 x 4 x 4 cells on many ranks",
        "supports",
        "the same bits on one to eight ranks; " + DIRECT,
        direct_solution(SINGLE),
        ("mesh.upper=[12,3,3]",),
        ranks=(1, 2, 3, 5, 8),
    ),
    Case(
        18,
        "bar of section 4.1, full size",
        "../bar_tension",
        "the same bits on 1, 2, 4 and 8 ranks; E of its bonds 0.9485 of the material's, to 5e-4 (sec. 4.1)",
        probe("modulus_ratio_peridynamics", 0.9485, 5e-4),
        ("solver.kind=cg",),
        None,
        ranks=(1, 2, 4, 8),
    ),
    # 19
    Case(
        19,
        "a million bonds in one event",
        "million",
        "as many bonds as cross the plane, counted one by one; their energy to 1e-6",
        counted_bonds(1e-6),
        short=("mesh.upper=[4,6,6]", "regions.left.upper=[2,6,6]"),
    ),
    # 20
    Case(20, "the same support twice", "supports", DIRECT, direct_solution(SINGLE)),
    Case(
        20,
        "two displacements at one place",
        "supports",
        "refused with both displacements",
        refused(BAD_DECK, "supports.1.x = 0.1 contradicts 0"),
        ("supports.1.x=0.1",),
    ),
    Case(
        20,
        "more supports than needed",
        "supports",
        DIRECT,
        direct_solution(SINGLE),
        ('supports=[{face="x-",x=0.0,y=0.0,z=0.0},{face="y-",y=0.0},{face="y+",y=0.0},{region="elements",z=0.0}]',),
    ),
    Case(
        20,
        "loads on held places",
        "supports",
        "nothing moves, and the force that is lost is told",
        says(nothing_moves(), "held"),
        ('supports=[{face="x-",x=0.0,y=0.0,z=0.0},{face="x+",x=0.0,y=0.0,z=0.0}]',),
    ),
    # 22
    Case(
        22,
        "snap-back under opening control",
        "notched_beam",
        "the opening never shrinks, the load falls below 95 % of the first break's, ledger to 1e-9",
        follows_opening("mouth", 0.95, 1e-9),
        short=("stepping.end_reaction=0.8",),
    ),
    Case(
        22,
        "rollers on bonds",
        "notched_beam",
        "both carry half of the load of 1, to a fifth of a cell; together it, to 1e-9",
        adds_up(1e-9, 0.03, "left_roller", "right_roller"),
        ('stepping={kind="steps"}', "material.critical_stretch=1.0"),
    ),
    Case(
        22,
        "a pin that a support drives",
        "notched_beam",
        "ledger to 1e-9",
        broken(1e-9),
        ("loads=[]", f"supports=[{ROLLERS},{{line=[[12,6,0],[12,6,1]],y=-0.01}}]", ENERGY),
        ("stepping.end_reaction=0.9",),
    ),
    Case(
        22,
        "a tied pin",
        "notched_beam",
        "reactions and broken bonds of every row are those of a pin that a support drives, to 1e-4",
        same_reactions(SAME_STATE),
        ('ties=[{name="pin",line=[[12,6,0],[12,6,1]],along=["y"]}]', ENERGY),
        ("stepping.end_reaction=0.9",),
        against="a pin that a support drives",
    ),
    Case(
        22,
        "a spring in place of a roller",
        "notched_beam",
        "both carry half of the load of 1, to a fifth of a cell; together it, to 1e-9",
        adds_up(1e-9, 0.03, "left_roller", "spring"),
        (
            f'supports=[{LEFT},{{face="z-",z=0.0}}]',
            'springs=[{name="spring",line=[[22,0,0],[22,0,1]],stiffness=[0,5000,0]}]',
            'stepping={kind="steps"}',
            "material.critical_stretch=1.0",
        ),
    ),
    Case(
        22,
        "a body cut in two",
        "notched_beam",
        "refused with the sizes and places of the parts",
        refused(BAD_DECK, "mesh.remove leaves 2 parts that share no face, of 72, 66 cells"),
        ("mesh.remove.0.upper=[13,6,1]",),
    ),
    Case(
        22,
        "an opening across nothing",
        "notched_beam",
        "refused with the probe",
        refused(BAD_DECK, "probes.0 measures an opening across nothing: both of its points lie in one cell"),
        ("probes.mouth.one=[13.2,0.0,0.5]", "probes.mouth.two=[13.8,0.0,0.5]"),
    ),
)

CASES += SOFTENING
NAMED = {case.name: case for case in CASES}
