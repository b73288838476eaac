"""Which bonds break and when, the books of those that broke, and breaking them again on other ranks."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.peridynamics import Coupling, Peridynamics
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.table import DeckError
from pdfem_mpi.deck.toml import parse_deck
from pdfem_mpi.kernels.exact_sums import BITS
from pdfem_mpi.model import breaking
from pdfem_mpi.model.breaking import make_failure
from pdfem_mpi.peridynamics.critical_stretches import UNBREAKABLE, critical_stretches, point_classes
from pdfem_mpi.peridynamics.point_blocks import point_blocks
from pdfem_mpi.runs.failure_notes import describe_criterion
from pdfem_mpi.solvers.preconditioner.blocks import inverted
from support.bodies import build, local_share, make_scene
from support.failing import EDGE, STRETCH, failing, followed, of_bonds, strip

QUADRATURE = 1e-6  # relative: the cutoff's guard is 1e-9, the cone integral is exact to 1e-8


# --- critical stretches


@pytest.mark.parametrize("ratio", [1.0, 2.5, 4.0])
def test_fracture_energy_is_that_of_the_bonds_across_a_plane(ratio):
    """G_c = int over heights z below the plane and cones above it of c s_0^2 xi exp(-(xi/l)^2) / 2, per unit area."""
    modulus, length, energy = 7.0e3, 0.3, 11.0
    s0 = Material(youngs_modulus=modulus, fracture_energy=energy).stretch_at_failure(length, ratio)
    c = 9.0 * (modulus / 1.5) / (math.pi * length**4)  # k = E / (3 (1 - 2 nu)) = E / 1.5

    def cone(z):  # bonds from depth z that reach through the plane: polar angle up to acos(z / xi)
        return quad(lambda xi: xi**3 * math.exp(-((xi / length) ** 2)) * (1.0 - z / xi), z, ratio * length)[0]

    across = 2.0 * math.pi * 0.5 * c * s0**2 * quad(cone, 0.0, ratio * length)[0]
    assert across == pytest.approx(energy, rel=QUADRATURE)


def test_fracture_energy_of_a_deck_gives_the_same_bonds():
    """A scene with G_c breaks at the s_0 that it stands for, whatever the deck's units."""
    scene = strip()
    whole = 27.0 * math.sqrt(math.pi) / 16.0 * scene.material.bulk_modulus * STRETCH**2
    energy = 0.971457 * whole  # derived, r_c = 2.5 l
    by_energy = scene.model_copy(update={"material": Material(youngs_modulus=1000.0, fracture_energy=energy)})
    body = build(by_energy)
    assert critical_stretches(by_energy, body.share).min() == pytest.approx(STRETCH, rel=1e-6)


def test_regions_that_may_not_fail():
    """Bonds with an end in such a region do not break, nor those within the overlap; classes are those of the cells."""
    run = failing(strip(elements=2))
    expected = np.full((5, 5), UNBREAKABLE)
    limit = run.body.share.units.numbers(STRETCH)
    expected[1, [1, 3, 4]] = expected[[3, 4], 1] = limit  # the middle, and from there into the elements' overlap
    assert (run.failure.stretch == expected).all()
    model = run.body.model
    names = [run.body.scene.regions[k].name for k in run.failure.class_of[::2]]
    centres = model.points.x.reshape(-1, 2, 3, 4)[:, :, 0].mean(axis=(1, 2))
    length = run.body.share.units.length
    for name, x in zip(names, centres * length, strict=True):
        place = np.searchsorted([-2.0, -1.0, 1.0, 2.0], x)
        assert name == ("first", "left", "middle", "right", "last")[place]


def long_bonds(may_fail=None, coupling="paper"):
    """A strip between layers of elements, with bonds that reach five cells far from overlaps one cell deep.

    Bonds beside its elements may break; ``may_fail`` is that of the elements.
    """
    scene = strip(elements=3, cells=(14, 6, 1), crack=EDGE)
    regions = [
        region.model_copy(update={"may_fail": may_fail if region.model == "finite_elements" else None})
        for region in scene.regions
    ]
    lengths = scene.peridynamics.model_copy(update={"internal_length": 2.0})
    return scene.model_copy(
        update={"regions": tuple(regions), "peridynamics": lengths, "coupling": Coupling(kind=coupling)}
    )


@pytest.mark.parametrize("coupling", ["paper", "paper_a"])
def test_bonds_within_the_overlap_break_where_the_deck_says_so_alone(coupling):
    """Both of their ends follow element nodes: they neither set the first load nor break; the deck may let them."""
    first = {may: followed(long_bonds(may, coupling), 1).rows[0].load_factor for may in (None, False, True)}
    assert first[None] == pytest.approx(first[False], rel=1e-9)
    if coupling == "paper":  # whose overlap has bonds alone, and few: .71 of the load is found
        assert first[True] < 0.8 * first[None]
    run = followed(long_bonds(coupling=coupling), 4)
    assert run.failure.count >= 10
    cells = run.failure.broken_pairs() // 8
    follows = run.body.share.is_overlap[cells]
    assert not follows.all(axis=1).any()


def test_bonds_into_the_overlap_break():
    """One of their ends is free: a crack along the interface has nothing else to part."""
    run = failing(long_bonds())
    body = run.body
    body.state.u[:] = body.of_positions(lambda x: 0.01 * x)
    body.forces.evaluate_surely(body.state.u, np.zeros_like(body.state.u), np.empty_like(body.state.u), run.failure)
    assert run.failure.close(body.model.comm) > 1000
    cells = run.failure.broken_pairs() // 8
    follows = body.share.is_overlap[cells].sum(axis=1)
    assert (np.bincount(follows, minlength=3) > 0).tolist() == [True, True, False]


def test_bonds_within_joints_of_fitted_bodies_do_not_break():
    """Peridynamic cells that follow nodes, because elements beside them have another stiffness, are such cells too."""
    scene = make_scene((9, 3, 3), 3, correction="fitted", signs="bounded", coupling="exact", solver="cg")
    stiff = Material(youngs_modulus=3000.0, poissons_ratio=0.25)
    elements = scene.regions[0].model_copy(update={"material": "stiff"})
    scene = scene.model_copy(
        update={
            "material": Material(youngs_modulus=1000.0, critical_stretch=STRETCH),
            "materials": {"stiff": stiff},
            "regions": (elements, *scene.regions[1:]),
        }
    )
    share = local_share(scene)
    joint = share.is_peridynamic & share.is_overlap
    assert joint.any() and not joint[share.is_peridynamic].all()
    of_cell = point_classes(scene, share)
    stretch = critical_stretches(scene, share)
    one, free = (np.unique(of_cell[cells]) for cells in (joint, share.is_peridynamic & ~joint))
    assert (stretch[np.ix_(one, one)] == UNBREAKABLE).all()
    limit = share.units.numbers(STRETCH)
    assert (stretch[np.ix_(one, free)] == limit).all() and (stretch[np.ix_(free, free)] == limit).all()


@pytest.mark.slow
def test_breaks_keep_out_of_regions_that_may_not_fail():
    """Midpoints of broken bonds, and their ends: none in the ends of the strip, however far it is torn."""
    run = followed(strip(end_reaction=0.2))
    x = run.body.share.mesh.centroids - run.body.share.units.origin
    cells = run.failure.broken_pairs() // 8
    assert np.abs(x[cells][:, :, 0]).max() < 3.0


@pytest.mark.parametrize("finite", [True, False])
def test_limits_of_the_sweeps(finite):
    """(1 - margin) s_0, as stretch or as (1 + s)^2 - 1; the trigger is the lowest of a class."""
    run = failing(strip())
    trigger, critical = run.failure.limits(finite, 0.25)
    s = 0.75 * STRETCH
    assert critical[1, 1] == pytest.approx((1.0 + s) ** 2 - 1.0 if finite else s, rel=1e-12)
    assert critical[0, 1] == critical[1, 0] >= 0.5 * UNBREAKABLE
    assert (trigger == critical.min(axis=1)).all()


def test_nothing_is_kept_for_bodies_that_do_not_break():
    """No critical stretch, or no region that may fail: no failure, no checks in the sweeps."""
    scene = make_scene((3, 2, 2))
    body = build(scene)
    assert make_failure(scene, body.share, body.model) is None
    regions = (Region(name="bonds", model="peridynamics", may_fail=False),)
    held = scene.model_copy(update={"material": Material(youngs_modulus=1.0, critical_stretch=1.0), "regions": regions})
    assert make_failure(held, body.share, body.model) is None


# --- books


def test_books_of_broken_bonds():
    """Pairs once each, lower id first, as many as counted; the extent is that of their midpoints."""
    run = followed(strip(), 8)
    pairs = run.failure.broken_pairs()
    assert len(pairs) == run.failure.count == run.rows[-1].broken > 0
    assert (pairs[:, 0] < pairs[:, 1]).all()
    assert len(np.unique(pairs, axis=0)) == len(pairs)
    middles = run.middles()
    np.testing.assert_allclose(run.failure.extent, [middles.min(axis=0), middles.max(axis=0)], atol=1e-12)


def test_few_records_at_a_time_change_nothing(monkeypatch):
    """Sweeps that fill their records stop, are booked and go on: the same bonds and energies."""
    expected = followed(strip(), 12)
    monkeypatch.setattr(breaking, "RECORDS", 1)
    run = failing(strip())
    assert len(run.failure.pairs) < expected.failure.count
    list(run.follow(12))
    assert (run.failure.broken_pairs() == expected.failure.broken_pairs()).all()
    assert run.failure.dissipated == expected.failure.dissipated
    assert run.rows[-1].stored == expected.rows[-1].stored


def test_digits_of_the_dissipated_energy_stay_small():
    """However often bonds break: digits are carried, so that 64 bits suffice for ever."""
    run = followed(strip(), 12)
    digits = run.failure.dissipated_digits[:-2]
    assert ((digits >= 0) & (digits < 2**BITS)).all()
    assert (digits > 0).sum() >= 2


def test_long_elements_far_away_do_not_lengthen_what_is_near():
    """The mean edge is that of the cells with bonds."""
    share = local_share(make_scene((9, 3, 2), 4))
    nodes = share.mesh.nodes.copy()
    nodes[:, 0] = np.where(nodes[:, 0] < 2.0, 2.0 + 8.0 * (nodes[:, 0] - 2.0), nodes[:, 0])
    longer, all_cells = replace(share, mesh=replace(share.mesh, nodes=nodes)), np.ones_like(share.has_points)
    assert longer.average_edge(all_cells) > 1.2 * share.average_edge(all_cells)
    assert longer.average_edge(share.has_points) == share.average_edge(share.has_points)


# --- breaking again


@pytest.mark.parametrize(
    "options",
    [{}, {"kinematics": "finite"}, {"poissons_ratio": 0.4}],
    ids=["linear", "finite", "another ratio"],
)
def test_restored_bonds_give_the_same_state(options):
    """The same stored numbers, count, extent, energy, preconditioner and forces; nothing to break is a mistake."""
    run = followed(strip(**options), 8)
    again = failing(strip(**options))
    pairs = run.failure.broken_pairs()
    order = np.random.default_rng(1).permutation(len(pairs))
    again.failure.restore(*of_bonds(again.body.model), pairs[order], run.failure.dissipated_digits)
    again.solve.update_after_breaks(again.failure.take())
    for rows, expected in zip(again.body.model.bonds.rows, run.body.model.bonds.rows, strict=True):
        assert (rows.data == expected.data).all()
    assert (again.failure.count, again.failure.dissipated) == (run.failure.count, run.failure.dissipated)
    assert (again.failure.extent == run.failure.extent).all()
    assert (again.solve.preconditioner.blocks == run.solve.preconditioner.blocks).all()
    assert (np.sort(again.failure.broken_pairs(), axis=0) == np.sort(pairs, axis=0)).all()
    with pytest.raises(ValueError, match=r"only \d+ of \d+ broken bonds are bonds of this scene"):
        again.failure.restore(*of_bonds(again.body.model), pairs[:3], run.failure.dissipated_digits)


# --- the preconditioner


@pytest.mark.parametrize(
    "options", [{}, {"kinematics": "finite"}, {"elements": 2}], ids=["linear", "finite", "elements"]
)
def test_blocks_lose_what_broke(options):
    """After an avalanche the running sums are those of the surviving bonds, integer by integer."""
    run = followed(strip(**options), 14)
    assert run.failure.count > 50
    kept = run.solve.preconditioner.of_points
    anew = point_blocks(*of_bonds(run.body.model)[1:])
    assert kept.quantum == anew.quantum
    assert (kept.sums == anew.sums).all()


def test_preconditioner_follows_the_blocks():
    """Inverse blocks are those of the surviving bonds, also of points that lost most of them."""
    run = followed(strip(end_reaction=0.1))
    preconditioner = run.solve.preconditioner
    values = point_blocks(*of_bonds(run.body.model)[1:]).values()
    expected = inverted(values, preconditioner.fixed_points, preconditioner.softest)
    assert (preconditioner.blocks[: len(expected)] == expected).all()


def test_loose_points_are_held():
    """A point without bonds does not move: its inverse block is 0, and nothing becomes infinite."""
    blocks = np.array([[1.0, 1.0, 1.0, 0.0, 0.0, 0.0], [0.0] * 6, [1.0, 1e-9, 1.0, 0.0, 0.0, 0.0]])
    inverse = inverted(blocks, np.zeros((3, 3), bool), np.full(3, 1e-7))
    np.testing.assert_allclose(inverse, [[1, 1, 1, 0, 0, 0], [0] * 6, [1, 0, 1, 0, 0, 0]], atol=1e-12)


# --- decks


DECK = """
{cracks}
[mesh]
lower = [0, 0, 0]
upper = [4, 2, 2]
spacing = 1
[material]
youngs_modulus = 1
{material}
[[regions]]
name = "body"
model = "{model}"
{region}
{loads}
[solver]
kind = "{solver}"
[stepping]
{stepping}
"""
PULL = '[[supports]]\nface = "x+"\nx = 0.1'
GOOD = {
    "cracks": "", "material": "critical_stretch = 0.01", "model": "peridynamics", "region": "", "loads": PULL,
    "solver": "cg", "stepping": 'kind = "events"',
}  # fmt: skip
NEITHER = "nothing says when bonds break. Give material.critical_stretch or material.fracture_energy."
BAD = {
    "both": (
        {"material": "critical_stretch = 0.01\nfracture_energy = 2.0"},
        "material.critical_stretch and fracture_energy are both given, and each gives the other. Keep one.",
    ),
    "neither, events": ({"material": ""}, f'stepping.kind = "events" follows failure, and {NEITHER}'),
    "neither, ramp": (
        {"material": "", "solver": "adr", "stepping": 'kind = "ramp"\nincrement = 1e-3'},
        f'stepping.kind = "ramp" follows failure, and {NEITHER}',
    ),
    "elements": (
        {"model": "finite_elements", "material": ""},
        'stepping.kind = "events" follows failure, and finite elements do not break. Describe a region by '
        "peridynamics.",
    ),
    "strength of elements": (
        {"model": "finite_elements", "material": "fracture_energy = 2.0", "stepping": ""},
        "material.fracture_energy breaks bonds, and no region has any. Remove it, or describe a region by "
        "peridynamics.",
    ),
    "no region may fail": (
        {"region": "may_fail = false"},
        "regions with peridynamics all have may_fail = false: no bond can break. Let one of them fail.",
    ),
    "ramp with cg": (
        {"stepping": 'kind = "ramp"\nincrement = 1e-3'},
        'solver.kind = "cg" does not go with stepping.kind = "ramp", which is relaxation. Use "adr".',
    ),
    "events with adr": (
        {"solver": "adr"},
        'solver.kind = "adr" does not go with stepping.kind = "events", which needs a solver for equilibrium. '
        'Use "cg".',
    ),
    "a ramp that loads nothing": (
        {"loads": PULL.replace("0.1", "0"), "solver": "adr", "stepping": 'kind = "ramp"\nincrement = 1e-3'},
        'stepping.kind = "ramp" raises the load until bonds break, and nothing loads the body. Add a table [[loads]], '
        "or a support that moves.",
    ),
    "events that load nothing": (
        {"loads": '[[supports]]\nface = "x+"\nx = 0'},
        'stepping.kind = "events" raises the load until bonds break, and nothing loads the body. Add a table '
        "[[loads]], or a support that moves.",
    ),
    "a ramp of less than one iteration": (
        {"solver": "adr", "stepping": 'kind = "ramp"\nincrement = 0.2\nend_load_factor = 0.1'},
        "stepping.increment = 0.2 is above end_load_factor = 0.1: a ramp without an iteration. Use a smaller "
        "increment.",
    ),
    "cracks in elements": (
        {
            "model": "finite_elements", "material": "", "stepping": "",
            "cracks": "cracks = [{polygon = [[1, 0, 0], [1, 1, 0], [1, 0, 1]]}]",
        },
        "cracks cut bonds, and no region has any. Describe the region of the crack by peridynamics.",
    ),
}  # fmt: skip


def test_good_deck():
    """What the decks below change one thing of."""
    assert parse_deck(DECK.format(**GOOD), "deck.toml").stepping.kind == "events"


@pytest.mark.parametrize("name", BAD)
def test_decks_are_refused_in_plain_words(name):
    changes, sentence = BAD[name]
    with pytest.raises(DeckError) as caught:
        parse_deck(DECK.format(**GOOD | changes), "deck.toml")
    assert caught.value.messages == [f"deck.toml: {sentence}"]


@pytest.mark.parametrize(
    ("stepping", "key"),
    [
        ('kind = "events"\neta = 0', "stepping.eta"),
        ('kind = "events"\neta = 0.5', "stepping.eta"),
        ('kind = "events"\ninner_iterations = 0', "stepping.inner_iterations"),
        ('kind = "events"\narrest_tolerance = 1.0', "stepping.arrest_tolerance"),
        ('kind = "events"\nend_load_factor = 0.0', "stepping.end_load_factor"),
        ('kind = "events"\nend_reaction = 0.0', "stepping.end_reaction"),
        ('kind = "events"\ncontrol = "displacement"', "stepping.control"),
        ('kind = "events"\nreport_every = 0', "stepping.report_every"),
        ('kind = "ramp"', "stepping.increment"),
        ('kind = "ramp"\nincrement = -1e-6', "stepping.increment"),
        ('kind = "ramp"\nincrement = 1e-6\nend_reaction = 1.0', "stepping.end_reaction"),
    ],
)
def test_values_out_of_range_are_named(stepping, key):
    changes = {"stepping": stepping, "solver": "adr" if "ramp" in stepping else "cg"}
    with pytest.raises(DeckError) as caught:
        parse_deck(DECK.format(**GOOD | changes), "deck.toml")
    assert any(message.startswith(f"deck.toml: {key}") for message in caught.value.messages), caught.value.messages


# --- fitted bonds


def fitted_strip(correction="fitted", kinematics="linear"):
    """A strip two cells thick with positive factors, or others, and an edge crack: strains vary at its tip."""
    scene = strip(cells=(8, 6, 2), crack=EDGE, kinematics=kinematics)
    settings = {"surface_correction": correction, "signs": "bounded", "kinematics": kinematics}
    return scene.model_copy(update={"peridynamics": Peridynamics(**settings)})


def test_only_fitted_bonds_have_neighbours_too_near_to_tell():
    """Half of the cells' edge, in model units; nothing where factors are not fitted."""
    assert failing(fitted_strip("virial")).failure.nearest == 0.0
    run = failing(fitted_strip())
    assert run.body.model.body_fit.fit is not None
    assert run.failure.nearest == pytest.approx(0.5 / run.body.share.units.length)


@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_longer_bonds_set_the_load_of_the_next_break(kinematics):
    """At the first critical state the longest stretch of those is critical, a nearer one beyond; all beyond break."""
    run = failing(fitted_strip(kinematics=kinematics))
    run.failure.nearest = 0.9  # the strip's tip stretches bonds of this length most
    (row,) = run.follow(1)
    assert row.event == "critical"
    assert run.ratio() == pytest.approx(1.0, rel=2e-6)  # BRACKET of finite kinematics
    run.failure.nearest = 0.0
    beyond = run.ratio()
    assert beyond > 1.01
    next(run.follow(1))
    assert run.failure.count > 0 and run.ratio() < 1.0


def test_all_bonds_tell_where_no_longer_one_is_stretched():
    """A length above that of all bonds leaves them all."""
    run = failing(fitted_strip())
    run.body.state.u[:] = run.body.of_positions(lambda x: 0.001 * x)
    everything = run.ratio()
    run.failure.nearest = 100.0
    assert run.ratio() == everything > 0.0


def test_a_run_says_what_is_known_of_breaking_fitted_bonds():
    """One sentence with the remedy, for fitted bonds alone."""
    for correction, told in (("fitted", True), ("virial", False)):
        scene = fitted_strip(correction)
        scene = scene.model_copy(
            update={"peridynamics": scene.peridynamics.model_copy(update={"internal_length": 1.0})}
        )
        run = failing(scene)
        said = list(describe_criterion(scene, run.body.share, run.failure, {}))
        assert len(said) == told
        assert all('Use "virial"' in note and "docs/failure.md" in note for note in said)
    assert list(describe_criterion(scene, run.body.share, None, {})) == []
