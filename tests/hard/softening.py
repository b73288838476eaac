"""Hard cases of bonds that soften: family 21."""

from __future__ import annotations

from hard.judges import broken, refused, says, snaps_back, softened
from hard.suite import BAD_DECK, Case

#: s_t = 0.0025 as the decks' critical stretch: G_c = 121.07 (1 + (R - 1) / 2) with R = 2 and 6, l = 1; R = 1.02 with
#: what planes of this lattice take, 0.956 of it.
SHORT, SOFT, BARE = (
    f"material={{youngs_modulus=1.0e7,tensile_strength=2.5e4,fracture_energy={energy}}}"
    for energy in (181.6, 423.7, 116.9)
)
EVENTS = 'stepping={kind="events",report_every=10,end_reaction=0.3}'
ENERGY = 'stepping={kind="events",control="energy",report_every=10,end_reaction=0.3}'
NOISELESS = "peridynamics.stiffness_noise=0.0"
APART = "loads=[]", 'supports=[{face="x-",x=-0.1,y=0.0,z=0.0},{face="x+",x=0.1}]'
ENDS = (
    'regions=[{name="left",model="peridynamics",upper=[4,8,1],may_fail=false},'
    '{name="middle",model="peridynamics",lower=[4,0,0],upper=[WIDE,8,1]},'
    '{name="right",model="peridynamics",lower=[WIDE,0,0],may_fail=false}]'
)
EDGE = "cracks=[{polygon=[[HALF,-1,-1],[HALF,2.5,-1],[HALF,2.5,2],[HALF,-1,2]]}]"


def strip(length: int) -> tuple[str, ...]:
    """The thin plate as a strip with an edge crack, pulled at ends that may not fail."""
    places = {"WIDE": str(length - 4), "HALF": str(length / 2)}
    found = []
    for text in (*APART, ENDS, EDGE):
        for word, value in places.items():
            text = text.replace(word, value)
        found.append(text)
    return (f"mesh.upper=[{length},8,1]", *found, "probes=[]")


CASES = (
    Case(
        21,
        "snap-back with teeth",
        "thin_plate",
        "load and displacement fall together, ledger to 1e-9",
        snaps_back(),
        (*strip(24), SHORT, ENERGY, "cracks=[]"),
        None,
    ),
    Case(
        21,
        "two soft cracks that compete",
        "twin_cracks",
        "with the noise of the default: ledger to 1e-9",
        softened(),
        (SOFT,),
        ("stepping.end_load_factor=0.65",),
    ),
    Case(
        21,
        "two soft cracks, exactly symmetric",
        "twin_cracks",
        "without noise: the box of gone bonds symmetric about x = 10 to 1e-9, ledger to 1e-9",
        softened(mirror=10.0),
        (SOFT, NOISELESS),
        ("stepping.end_load_factor=0.85",),
    ),
    Case(
        21,
        "a loose piece with soft bonds, dead loads",
        "fragments",
        "the loose block is told and held; ends by itself, ledger to 1e-9",
        says(broken(), "parts"),
        (SOFT,),
        None,
    ),
    Case(
        21,
        "R just above 1",
        "thin_plate",
        "two teeth, ledger to 1e-9",
        says(softened(), "in 2 teeth"),
        (*strip(16), BARE, EVENTS),
        ("mesh.upper=[16,4,1]", "regions.0.upper=[4,4,1]", "regions.1.upper=[12,4,1]"),
    ),
    Case(
        21,
        "R below 1",
        "thin_plate",
        "refused with the longest internal length",
        refused(BAD_DECK, "is too long for a strength of 25000", "l <= 0.95"),
        (*strip(16), "material={youngs_modulus=1.0e7,tensile_strength=2.5e4,fracture_energy=110.0}", EVENTS),
    ),
    Case(
        21,
        "a thin plate that softens",
        "thin_plate",
        "one cell thick: ledger to 1e-9, and the energy of its own bonds is told",
        says(softened(), "planes across x, y, z cut"),
        (*strip(16), SOFT, EVENTS),
        None,
    ),
    Case(
        21,
        "a thin plate that softens, finite",
        "thin_plate",
        "the same, ledger to 1e-4",
        softened(1e-4),
        (*strip(16), SOFT, EVENTS, "peridynamics.kinematics=finite"),
        None,
    ),
)
