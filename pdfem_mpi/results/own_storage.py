"""Whether an HDF5 file holds all its data itself: links, virtual and external datasets lead to other files.

This program writes none of them. A part that is elsewhere reads silently as zeros when it is missing, and what is
appended to it changes a file that nobody named.
"""

from __future__ import annotations

import h5py

#: Groups within groups; no file of this program has more than three.
DEEPEST = 8


def elsewhere(file: h5py.File) -> str | None:
    """What of a file is not in it, as the rest of a sentence that begins with its name; None if all is."""
    return _search(file, "", DEEPEST)


def _search(group: h5py.Group, path: str, deeper: int) -> str | None:
    if not deeper:
        return f"has groups within {path}, deeper than any that this program writes"
    for name in group:
        where = f"{path}/{name}"
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            return f"has a link in place of {where}"
        item = group[name]
        if isinstance(item, h5py.Group):
            if found := _search(item, where, deeper - 1):
                return found
        elif not isinstance(item, h5py.Dataset):
            return f"has a type in place of the data of {where}"
        elif item.is_virtual:
            return f"has its {where} in other files (a virtual dataset)"
        elif item.external:
            return f"has its {where} in another file (external storage)"
    return None
