"""What meshio would misread in an Abaqus file without a word, found before it reads.

meshio 5.3 keeps the last of several node blocks and of several parts of one set, drops sets that list other sets, and
takes no notice of keywords that make or move nodes. Each of these gives a mesh with wrong sets or places, so they are
refused by name.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

#: Keywords that make or move nodes and elements, which meshio passes over.
GENERATORS = ("NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SYSTEM", "INCLUDE")


def find_traps(lines: Iterable[str]) -> list[str]:
    """Say what of a file meshio would misread.

    Parameters
    ----------
    lines : iterable of str

    Returns
    -------
    list of str
        Findings that follow the file's name: ``has 2 *NODE blocks ...``.
    """
    found: list[str] = []
    blocks = [block for block in _blocks(lines) if block[0]]
    words = [word for word, _, _ in blocks]
    if words.count("NODE") > 1:
        found.append(f"has {words.count('NODE')} *NODE blocks, of which only the last is read. Write all nodes in one.")
    for word in sorted(set(words) & set(GENERATORS)):
        found.append(f"has *{word}, which is not read. Write the nodes and elements themselves.")
    if any(word == "INSTANCE" and data for word, _, data in blocks) or words.count("INSTANCE") > 1:
        found.append("has instances that are moved or many, which are not read. Write one part in its place.")
    if any(word == "NODE" and options.get("SYSTEM", "R").upper() != "R" for word, options, _ in blocks):
        found.append("has nodes in cylindrical or spherical coordinates. Write Cartesian ones.")
    return found + _traps_of_sets(blocks)


def _traps_of_sets(blocks: list[tuple[str, dict[str, str], list[str]]]) -> list[str]:
    found, seen = [], set()
    elements = [options for word, options, _ in blocks if word == "ELEMENT"]
    last_element = max((k for k, block in enumerate(blocks) if block[0] == "ELEMENT"), default=-1)
    if len({"ELSET" in options for options in elements}) > 1:
        found.append("has *ELEMENT blocks with and without ELSET. Give all of them one, or none.")
    for k, (word, options, data) in enumerate(blocks):
        kind = "NSET" if word == "NSET" else "ELSET"
        name = options.get(kind)
        if name is None or word not in ("NSET", "ELSET", "ELEMENT"):
            continue
        if (kind, name) in seen:
            found.append(f"has several parts of the {kind} {name}, of which one is read. Write the set in one part.")
        seen.add((kind, name))
        if word == "ELSET" and k < last_element:
            found.append(f"has the ELSET {name} before its last *ELEMENT block. Write sets after all elements.")
        if word != "ELEMENT" and any(not _is_number(item) for line in data for item in line.split(",") if item.strip()):
            found.append(f"has other sets in the {kind} {name}, which are not read. Write the numbers of its members.")
        if word != "ELEMENT" and "GENERATE" in options and len(data) > 1:
            found.append(f"has {len(data)} ranges in the {kind} {name}. Write one range, or the numbers.")
    return list(dict.fromkeys(found))


def _is_number(text: str) -> bool:
    return text.strip().isdecimal()


def _blocks(lines: Iterable[str]) -> Iterator[tuple[str, dict[str, str], list[str]]]:
    """Yield keyword, options, and data lines where they matter: those of sets and instances."""
    word, options, data = "", {}, []
    for line in lines:
        if line.startswith("**"):
            continue
        if line.startswith("*"):
            yield word, options, data
            first, *rest = line[1:].split(",")
            word, data = first.strip().upper(), []
            pairs = (item.partition("=") for item in rest)
            options = {name.strip().upper(): value.strip() for name, _, value in pairs}
        elif word in ("NSET", "ELSET", "INSTANCE") and line.strip():
            data.append(line)
    yield word, options, data
