"""The readers of mesh files, each loaded when a file of its format is read: a run reads one, or none."""

from __future__ import annotations

from pathlib import Path

from pdfem_mpi.mesh.raw import RawMesh


def read_format(path: Path, kind: str) -> RawMesh:
    """What the reader of a format makes of a file.

    Parameters
    ----------
    kind : str
        "gmsh", "abaqus", "vtu", "vtk" or "exodus".

    Raises
    ------
    Refusal, MemoryError, ImportError
    """
    if kind == "exodus":
        from pdfem_mpi.mesh.exodus import read_exodus

        return read_exodus(path)
    if kind == "gmsh":
        from pdfem_mpi.mesh.gmsh import read_gmsh as read
    elif kind == "abaqus":
        from pdfem_mpi.mesh.abaqus import read_abaqus as read
    elif kind == "vtu":
        from pdfem_mpi.mesh.vtk_xml import read_vtu as read
    else:
        from pdfem_mpi.mesh.vtk_legacy import read_vtk as read
    return read(path.read_bytes())
