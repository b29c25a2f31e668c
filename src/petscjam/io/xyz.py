"""Extended XYZ, by its specification (github.com/libAtoms/extxyz) and as in OVITO and ASE, in two dimensions."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from petscjam.base.arguments import parsed_whole
from petscjam.base.errors import InputError
from petscjam.geometry.box import Box
from petscjam.geometry.packing import Packing
from petscjam.io.reading import Text, Wanted, check_once, check_plane, numbers

STRING = r'"(?:[^"\\]|\\.)*"'
ENTRY = re.compile(  # key = value; the value in quotes, in brackets or bare
    rf"""({STRING}|[^\s="'{{}}\[\]]+)\s*=\s*({STRING}|'[^']*'(?=\s|$)|{{[^}}]*}}|\[[^="]*\]|[^\s"]\S*)"""
)


def read_xyz(path: Path, wanted: Wanted) -> Packing:
    """Read extended XYZ with a column ``radius``, ``diameter``, ``species`` or ``type``, and ``potential=…``.

    The rest of the comment line is the ``header`` of the provenance.

    Parameters
    ----------
    path : Path
    wanted : Wanted
    """
    text = Text(path)
    starts = _frames(text)
    start = starts[wanted.one_of(len(starts))]
    n, count = start + 1, parsed_whole(text.lines[start])
    rows = range(start + 2, min(start + 2 + count, len(text.lines)))
    if len(rows) < count:
        raise InputError(f"line {len(text.lines)}: this is row {len(rows)} and the last, not {count}")
    entries = _entries(text.lines[n], n)
    columns, width = _columns(entries.pop("Properties", "species:S:1:pos:R:3"), n)
    own = "potential" in entries
    if wanted.potential:
        entries.setdefault("potential", wanted.potential)
    for key, example in (("Lattice", '"ax ay 0 bx by 0 0 0 cz"'), ("potential", "harmonic")):
        if key not in entries:
            raise InputError(f"line {n + 1}: {key} is missing; write it as {key}={example}")
    sizes = [name for name in ("radius", "diameter") if name in columns]
    for name in sizes:
        if len(columns[name]) != 1:
            raise InputError(f"line {n + 1}: Properties must have {name}:R:1")
    if len(columns.get("pos", ())) not in (2, 3):
        raise InputError(f"line {n + 1}: Properties must have pos:R:3 or pos:R:2")
    table = text.table(rows, width, columns["pos"])
    kind = next((name for name in ("species", "type") if name in columns), None)
    checksum = entries.get("source_checksum") if own else None
    if checksum is None:
        text.check_end(rows)
    types = [text.words(row)[columns[kind][0]] if kind else "1" for row in rows]
    radii = wanted.radii({name: text.table(rows, width, columns[name])[:, 0] for name in sizes}, types)
    lattice = numbers(re.sub(r"[\[\]{},]", " ", entries.pop("Lattice")).split(), n)
    if len(lattice) not in (4, 9):
        raise InputError(f'line {n + 1}: Lattice must be "ax ay 0 bx by 0 0 0 cz" or "ax ay bx by"')
    vectors = np.reshape(lattice, (int(len(lattice) ** 0.5), -1))[:2]
    check_plane(table[:, 2:], radii)
    check_plane(np.append(0, vectors[:, 2:]), radii)
    pbc = re.findall(r"\w+", entries.pop("pbc", "T T"))
    if len(pbc) < 2 or not {*pbc[:2]} <= {"T", "True", "true", "TRUE", "1"}:
        raise InputError(f'line {n + 1}: a packing is periodic along both lattice vectors: pbc="T T F"')
    law = entries.pop("potential")
    origin: dict[str, Any] = {"source": path.name, "format": "extended XYZ", "header": entries}
    origin |= {"index": wanted.index} if len(starts) > 1 else {}
    origin |= text.precision(rows, columns["pos"])
    packing = Packing(table[:, :2], radii, Box(vectors[:, :2]), law, provenance=origin)
    if checksum not in (None, packing.checksum):
        raise InputError(
            f"the checksum is {packing.checksum}, but {checksum} on line {n + 1}: the file was cut or "
            "changed; if on purpose, remove source_checksum from that line"
        )
    return packing


def _frames(text: Text) -> list[int]:
    """Return the line of each frame with the number of its disks."""
    starts, n = [], 0
    while n < len(text.lines):
        if text.lines[n]:
            try:
                count = parsed_whole(text.lines[n])
            except ValueError:
                count = 0
            if count < 1:
                raise InputError(f"line {n + 1}: expected a number of disks, not {text.lines[n]!r}")
            starts.append(n)
            n += 1 + count
        n += 1
    return starts


def _entries(line: str, n: int) -> dict[str, str]:
    """Return the values of the comment line by key; one key with two values is refused."""
    entries: dict[str, str] = {}
    for key, value in ENTRY.findall(line):
        key, value = (_bare(word) for word in (key, value))
        if entries.setdefault(key, value) != value:
            raise InputError(f"line {n + 1}: {key} is there twice, with two values")
    return entries


def _bare(word: str) -> str:
    if word[0] == '"':
        return re.sub(r"\\(.)", r"\1", word[1:-1])
    return word[1:-1] if word[0] == "'" == word[-1] and len(word) > 1 else word


def _columns(properties: str, n: int) -> tuple[dict[str, list[int]], int]:
    """Return the columns of each name:type:size, and the number of columns."""
    fields = properties.split(":")
    if len(fields) % 3:
        raise InputError(f"line {n + 1}: Properties must be name:type:size:…, not {properties!r}")
    check_once(fields[::3], n, "column")
    columns, width = {}, 0
    for name, size in zip(fields[::3], fields[2::3], strict=True):
        try:
            columns[name] = list(range(width, width + parsed_whole(size)))
        except ValueError as error:
            raise InputError(f"line {n + 1}: Properties: {error}") from None
        width += len(columns[name])
    return columns, width
