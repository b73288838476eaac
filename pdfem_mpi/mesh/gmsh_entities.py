"""The entities of a Gmsh file of version 4: which physical groups each point, curve, surface and volume is in."""

from __future__ import annotations

from dataclasses import dataclass, field

from pdfem_mpi.mesh.raw import Refusal


@dataclass
class Entities:
    """Groups and partitions of entities by dimension and tag.

    Attributes
    ----------
    groups, partitions : dict from (dimension, tag) to tuples of int
    n_partitions : int
        That the file declares; 0 where it is not partitioned.
    seen : set of int
        Partitions whose elements are there.
    """

    groups: dict[tuple[int, int], tuple[int, ...]] = field(default_factory=dict)
    partitions: dict[tuple[int, int], tuple[int, ...]] = field(default_factory=dict)
    n_partitions: int = 0
    seen: set[int] = field(default_factory=set)

    def met(self, dimension: int, tag: int) -> None:
        """Note that there are elements of an entity."""
        if dimension == 3:
            self.seen.update(self.partitions.get((dimension, tag), ()))

    def check_partitions(self) -> None:
        """Refuse one of several files that make up a mesh together."""
        if self.n_partitions and len(self.seen) < self.n_partitions:
            raise Refusal(
                f"the file has elements of {len(self.seen)} of the {self.n_partitions} partitions that it declares. "
                "Save all in one file (in Gmsh: Mesh.PartitionSplitMeshFiles = 0), or without partitions."
            )


def read_entities(numbers, version: int, entities: Entities, partitioned: bool) -> None:
    """Read the section $Entities or $PartitionedEntities.

    Parameters
    ----------
    numbers : TextNumbers or BinaryNumbers
    """
    if partitioned:
        entities.n_partitions = int(numbers.sizes(1)[0])
        numbers.rows(int(numbers.sizes(1)[0]), "ii")  # entities of ghost cells
    for dimension, count in enumerate(numbers.sizes(4).tolist()):
        for _ in range(count):
            tag = int(numbers.ints(1)[0])
            if partitioned:
                numbers.ints(2)  # dimension and tag of the entity it is a part of
                parts = numbers.ints(int(numbers.sizes(1)[0])).tolist()
                entities.partitions[dimension, tag] = tuple(parts)
            numbers.reals(3 if dimension == 0 and version == 41 else 6)
            groups = numbers.ints(int(numbers.sizes(1)[0])).tolist()
            entities.groups[dimension, tag] = tuple(dict.fromkeys(abs(group) for group in groups))
            if dimension:
                numbers.ints(int(numbers.sizes(1)[0]))  # what bounds it
