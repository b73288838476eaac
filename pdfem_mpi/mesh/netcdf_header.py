"""A look at the header of a classic netCDF file: a count that the file cannot hold keeps the library busy for long."""

from __future__ import annotations

from pdfem_mpi.mesh.raw import Refusal

#: Bytes of the values of each type.
SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 8, 7: 1, 8: 2, 9: 4, 10: 8, 11: 8}
#: Bytes of a count and of an offset by the fourth letter of the file.
WIDTHS = {1: (4, 4), 2: (4, 8), 5: (8, 8)}


class _Walk:
    """Reads counts one after the other, none of them beyond the file's end."""

    def __init__(self, content: bytes) -> None:
        self.content, self.place = content, 4
        self.width, self.offset = WIDTHS[content[3]]

    def number(self, width: int) -> int:
        """The next number of so many bytes."""
        self.skip(width)
        return int.from_bytes(self.content[self.place - width : self.place], "big")

    def count(self) -> int:
        """The next count of things that the rest of the file must hold."""
        value = self.number(self.width)
        if value > len(self.content) - self.place:
            raise Refusal(
                f"byte {self.place - self.width}: the header declares {value} things, more than the file can hold. It "
                "was "
                "cut off or changed: write the mesh again."
            )
        return value

    def skip(self, size: int) -> None:
        """Pass over some bytes."""
        self.place += size
        if self.place > len(self.content):
            raise Refusal("the file ends within its header. It was cut off: write the mesh again.")

    def padded(self, size: int) -> None:
        """Pass over some bytes that are filled up to four."""
        self.skip(-(-size // 4) * 4)

    def attributes(self) -> None:
        """Pass over a list of attributes."""
        self.skip(4)
        for _ in range(self.count()):
            self.padded(self.count())
            size = SIZES.get(self.number(4), 0)
            if not size:
                raise Refusal(f"byte {self.place - 4}: no type of values. The file was changed: write the mesh again.")
            self.padded(size * self.count())


def check_header(content: bytes) -> None:
    """Refuse a classic file whose header does not hold what it declares.

    Parameters
    ----------
    content : bytes
        The whole file, or all of its header.
    """
    walk = _Walk(content)
    walk.skip(walk.width + 4)  # number of records, mark of dimensions
    for _ in range(walk.count()):
        walk.padded(walk.count())
        walk.skip(walk.width)
    walk.attributes()
    walk.skip(4)
    for _ in range(walk.count()):
        walk.padded(walk.count())
        walk.skip(walk.width * walk.count())
        walk.attributes()
        walk.skip(4 + walk.width + walk.offset)
