"""Small bodies whose bonds soften."""

from __future__ import annotations

from pdfem_mpi.body.softening_law import Shape
from pdfem_mpi.body.traction_opening import dilatation_energy
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.scene import Scene
from support.bodies import YOUNGS_MODULUS
from support.failing import STRETCH, strip

RATIO = 6.0  # s_c / s_t


def softening_material(ratio=RATIO, stretch=STRETCH, length=1.0, poissons_ratio=0.25, **keys):
    """A material whose bonds drop at a stretch, and are gone at ``ratio`` times it; cutoff 2.5 l."""
    elastic = {"youngs_modulus": YOUNGS_MODULUS, "poissons_ratio": poissons_ratio}
    brittle = Material(critical_stretch=stretch, **elastic)
    whole = 1.0 + 0.5 * (ratio - 1.0)
    if brittle.lacking:
        whole += brittle.lacking * dilatation_energy(Shape(0.5), ratio, 2.5)
    energy = brittle.energy_of_bonds(length, 2.5) * stretch**2 * whole
    return Material(tensile_strength=YOUNGS_MODULUS * stretch, fracture_energy=energy, **elastic, **keys)


def soft_strip(ratio=RATIO, material=None, correction="virial", **options):
    """`support.failing.strip` of bonds that soften; its noise is that of the options, none by default."""
    options = (
        {"eta": 1e-2, "inner_iterations": 4, "report_every": 5} | options if "stepping" not in options else options
    )
    nu = options.get("poissons_ratio", 0.25)
    scene = strip(**options)
    peridynamics = scene.peridynamics.model_copy(update={"surface_correction": correction})
    material = material or softening_material(ratio, poissons_ratio=nu)
    return scene.model_copy(update={"material": material, "peridynamics": peridynamics})


def remade(scene: Scene, **tables) -> Scene:
    """A scene with other tables, checked as a whole."""
    return Scene.model_validate({**dict(scene), **tables})


def with_mirrors(scene: Scene, planes=("z-", "z+")) -> Scene:
    """The same between mirror planes: plane strain, if they are both normal to z."""
    return remade(scene, mesh=scene.mesh.model_copy(update={"symmetry": planes}))
