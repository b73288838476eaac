"""Small bodies whose bonds soften."""

from __future__ import annotations

from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.scene import Scene
from support.bodies import YOUNGS_MODULUS
from support.failing import STRETCH, strip

RATIO = 6.0  # s_c / s_t


def softening_material(ratio=RATIO, stretch=STRETCH, length=1.0, **keys):
    """A material whose bonds drop at a stretch, and are gone at ``ratio`` times it; cutoff 2.5 l."""
    unit = Material(youngs_modulus=YOUNGS_MODULUS, critical_stretch=1.0).energy_at_failure(1.0, length, 2.5)
    energy = unit * stretch**2 * (1.0 + 0.5 * (ratio - 1.0))
    return Material(
        youngs_modulus=YOUNGS_MODULUS, tensile_strength=YOUNGS_MODULUS * stretch, fracture_energy=energy, **keys
    )


def soft_strip(ratio=RATIO, material=None, correction="virial", **options):
    """`support.failing.strip` of bonds that soften; its noise is that of the options, none by default."""
    options = (
        {"eta": 1e-2, "inner_iterations": 4, "report_every": 5} | options if "stepping" not in options else options
    )
    scene = strip(**options)
    peridynamics = scene.peridynamics.model_copy(update={"surface_correction": correction})
    return scene.model_copy(update={"material": material or softening_material(ratio), "peridynamics": peridynamics})


def remade(scene: Scene, **tables) -> Scene:
    """A scene with other tables, checked as a whole."""
    return Scene.model_validate({**dict(scene), **tables})


def with_mirrors(scene: Scene, planes=("z-", "z+")) -> Scene:
    """The same between mirror planes: plane strain, if they are both normal to z."""
    return remade(scene, mesh=scene.mesh.model_copy(update={"symmetry": planes}))
