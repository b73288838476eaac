"""The same scene in other units, elsewhere, or as its mirror image; and the way its displacements go with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.mesh.reader import read_mesh
from support.mesh_files import write_mesh

#: Corners of a hexahedron whose first axis is turned round.
REVERSED = [1, 0, 3, 2, 5, 4, 7, 6]


class Transform:
    """Positions ``length * sign * x + shift`` (sign along one axis only), stresses times ``stress``.

    Parameters
    ----------
    length, stress : float
    shift : three floats, dimension length
    mirror : int or None
        Axis whose direction is turned round.
    """

    def __init__(self, length=1.0, stress=1.0, shift=(0.0, 0.0, 0.0), mirror=None):
        self.length, self.stress, self.shift, self.mirror = length, stress, np.array(shift), mirror
        self.sign = np.where(np.arange(3) == mirror, -1.0, 1.0)

    def positions(self, x):
        """Of points in the transformed scene, from (n, 3)."""
        return self.length * self.sign * x + self.shift

    def displacements(self, u):
        """In the transformed scene, from (n, 3)."""
        return self.length * self.sign * u

    def scene(self, scene: Scene, folder: Path) -> Scene:
        """The transformed scene; a mesh file of it is written to the folder."""
        table = scene.model_dump()
        for entry in (table["mesh"], *table["regions"], *table["loads"], *table["supports"]):
            self._box(entry)
        for region in table["regions"]:
            if region["centre"] is not None:
                region["centre"] = self._place(region["centre"])
                region["radius"] *= self.length
        for crack in table["cracks"]:
            crack["polygon"] = tuple(self._place(corner) for corner in crack["polygon"])
        for name in ("internal_length", "cutoff_radius"):
            if table["peridynamics"][name] is not None:
                table["peridynamics"][name] *= self.length
        for material in (table["material"], *table["materials"].values(), *table["interfaces"]):
            if material["youngs_modulus"] is not None:
                material["youngs_modulus"] *= self.stress
            if material["fracture_energy"] is not None:
                material["fracture_energy"] *= self.stress * self.length
        for load in table["loads"]:
            for name, power in (("total", 2), ("density", -1), ("traction", 0)):
                if load.get(name) is not None:
                    size = self.stress * self.length**power
                    load[name] = tuple((size * self.sign * np.array(load[name])).tolist())
        for support in table["supports"]:
            for axis, name in enumerate("xyz"):
                if support[name] is not None:
                    support[name] = float(self.length * self.sign[axis] * support[name])
        self._mesh(scene, table["mesh"], folder)
        return Scene(**table)

    def _place(self, corner):
        return tuple(self.positions(np.array(corner)).tolist())

    def _box(self, entry):
        """Corners, which change places along the mirrored axis, and faces."""
        names = ("lower", "upper")
        corners = {name: None if entry.get(name) is None else list(self._place(entry[name])) for name in names}
        if self.mirror is not None and None not in corners.values():
            low, high = corners["lower"], corners["upper"]
            low[self.mirror], high[self.mirror] = high[self.mirror], low[self.mirror]
        for name, corner in corners.items():
            if corner is not None:
                entry[name] = tuple(corner)
        if entry.get("face") is not None:
            entry["face"] = self._face(entry["face"])
        if "symmetry" in entry:
            entry["symmetry"] = tuple(map(self._face, entry["symmetry"]))

    def _face(self, face):
        if self.mirror is None or face[0] != "xyz"[self.mirror]:
            return face
        return face[0] + {"-": "+", "+": "-"}[face[1]]

    def _mesh(self, scene: Scene, entry, folder: Path):
        for name in ("spacing", "hole_radius"):
            if entry.get(name) is not None:
                entry[name] *= self.length
        if isinstance(scene.mesh, FileMesh):
            mesh, _ = read_mesh(scene.mesh)
            cells = mesh.cells if self.mirror is None else mesh.cells[:, REVERSED]
            path = Path(folder) / f"{Path(scene.mesh.path).stem}_of_{id(self)}.inp"
            write_mesh(path, type(mesh)(self.positions(mesh.nodes), np.ascontiguousarray(cells)))
            entry["path"] = str(path)
