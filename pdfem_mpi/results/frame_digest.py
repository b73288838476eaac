"""A sha256 of what a file of frames holds: geometry, static fields, and each frame in its turn.

The bytes of the file itself say little: an append moves HDF5's own tables. So the numbers are hashed as readers see
them, with their names, types and shapes. A writer carries the digest along and adds each frame as it is written, which
costs no reading; who goes on from a checkpoint reads the file once, and compares.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import numpy as np


class FrameDigest:
    """The digest of a file with some frames.

    Parameters
    ----------
    frames : int
        How many are in it.
    """

    def __init__(self, frames: int = 0):
        self._hash = hashlib.sha256()
        self.frames = frames

    def add(self, name: str, values: object) -> None:
        """Add an array, or anything that becomes one, under a name."""
        array = np.ascontiguousarray(values)
        self._hash.update(f"{name} {array.dtype.str} {array.shape}\n".encode("utf-8", "surrogateescape"))
        self._hash.update(array.tobytes() if array.dtype.hasobject or not array.size else array.data.cast("B"))

    def add_frame(self, time: float, entries: Mapping[str, object], fields: Mapping[str, np.ndarray]) -> None:
        """Add the next frame.

        Parameters
        ----------
        time : float
        entries : mapping
            The frame's entry of each array of ``Steps``.
        fields : mapping of "PointData/NAME" or "CellData/NAME" to arrays
            As they are stored.
        """
        self.add("time", np.float64(time))
        for name in sorted(entries):
            self.add(name, np.asarray(entries[name], np.int64))
        for name in sorted(fields):
            self.add(name, fields[name])
        self.frames += 1

    def hexdigest(self) -> str:
        """The digest so far."""
        return self._hash.hexdigest()
