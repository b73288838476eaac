"""What a run says of a surface correction that did not converge: numbers of such a body are wrong where it did not."""

from __future__ import annotations

from collections.abc import Iterator

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.kernels.correction_sweeps import SWEEPS
from pdfem_mpi.model.model import Model


def describe_correction(scene: Scene, share: Share, model: Model) -> Iterator[str]:
    """One warning where the sweeps of a correction left more than `peridynamics.uneven.CONVERGED`."""
    if model.most_uneven is None:
        return
    appendix_a = scene.peridynamics.surface_correction == "appendix_a"
    name, measure, other = ("appendix_a", "G / g_inf", "none") if appendix_a else ("virial", "S / E", "appendix_a")
    place = model.most_uneven * share.units.length + share.units.origin
    yield (
        f'warning: the surface correction "{name}" did not converge in its {SWEEPS} sweeps: |{measure} - 1| is still '
        f"{model.correction_remaining:.2g} (0.2 and far less where it converges), most of it near "
        f"({', '.join(f'{x:.6g}' for x in place)}). Bonds there may be several times too stiff or too soft, and "
        f"displacements and loads of breaks are wrong. Use cells of more even shape, two or more across the body, or "
        f'peridynamics.surface_correction = "{other}".'
    )
