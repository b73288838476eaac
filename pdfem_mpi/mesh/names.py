"""Names of sets that differ by upper and lower case only, where a format takes them for one."""

from __future__ import annotations

from typing import Any


class FoldedNames(dict):
    """Sets by name as in Abaqus: found in any case, listed as they were first written."""

    def _key(self, name: Any) -> Any:
        if dict.__contains__(self, name):
            return name
        return next((key for key in self if key.upper() == str(name).upper()), name)

    def __contains__(self, name: Any) -> bool:
        return dict.__contains__(self, self._key(name))

    def __getitem__(self, name: Any) -> Any:
        return dict.__getitem__(self, self._key(name))
