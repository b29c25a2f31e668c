"""Files of LAMMPS: data files, and dumps in text.

No library gives radii in double precision without installing a whole program: lammpsio and ASE drop them,
MDAnalysis rounds positions to single precision.

Axes: l lattice vector, x Cartesian.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from petscjam.base.arguments import parsed_whole
from petscjam.base.errors import InputError
from petscjam.base.types import Array
from petscjam.geometry.box import Box
from petscjam.geometry.packing import Packing
from petscjam.io.reading import Text, Wanted, by_id, check_once, check_plane, numbers

STYLES = {  # of atoms in a data file; three image flags may follow
    "sphere": "id type diameter density x y z",
    "bpm/sphere": "id molecule type diameter density x y z",
    "atomic": "id type x y z",
}
BOUNDS = {"": 2, "xy xz yz": 3, "abc origin": 4}  # numbers in each line of the box in a dump
ITEM = re.compile("ITEM: (TIMESTEP|NUMBER OF ATOMS|BOX BOUNDS|ATOMS)(.*)")
HEADER = ("atoms", "xlo xhi", "ylo yhi", "zlo zhi", "xy xz yz", "avec", "bvec")


def read_lammps_data(path: Path, wanted: Wanted) -> Packing:
    """Read a data file; the disks are sorted by id.

    Parameters
    ----------
    path : Path
    wanted : Wanted
    """
    wanted.one_of(1)
    text = Text(path)
    lines = text.lines
    sections = [n for n, line in enumerate(lines) if n and line.partition("#")[0].rstrip() == "Atoms"]
    if len(sections) != 1:
        raise InputError(f"the section Atoms {'is there twice' if sections else 'is missing'}")
    n = sections[0]
    style = lines[n].partition("#")[2].strip()
    if style not in STYLES:
        known = "; ".join(f"'Atoms # {name}': {columns}" for name, columns in STYLES.items())
        raise InputError(f"line {n + 1}: {lines[n]!r} has no known style of atoms: {known}")
    header = _header(text, n)
    for name in ("atoms", *(("avec", "bvec") if "avec" in header else ("xlo xhi", "ylo yhi"))):
        if name not in header:
            raise InputError(f"the header lacks '{name}'")
    end = next((k for k in range(n + 1, len(lines)) if lines[k][:1].isalpha()), len(lines))
    rows = text.rows(n + 1, end)
    if len(rows) != header["atoms"][0]:
        raise InputError(
            f"line {n + 1}: {len(rows)} rows up to line {end}, but {header['atoms'][0]:g} atoms in the header"
        )
    names = STYLES[style].split()
    width = len(names) + 3 * any(len(text.words(row)) > len(names) for row in rows)
    sizes = [name for name in names if name == "diameter"]
    table = text.table(rows, width, [names.index(name) for name in ("id", "x", "y", "z", *sizes)])
    text.check_end(rows)
    order = by_id(table[:, 0])
    table = table[order]
    radii = _radii(wanted, text, np.array(rows)[order], names, dict(zip(sizes, table.T[4:], strict=True)))
    if "avec" in header:
        vectors = np.array([header["avec"], header["bvec"]])
        check_plane(np.append(0, vectors[:, 2]), radii)
        cell = vectors[:, :2]
    else:
        (width_x, width_y), _ = _widths([header["xlo xhi"], header["ylo yhi"]])
        cell = np.array([[width_x, 0], [header.get("xy xz yz", [0.0])[0], width_y]])
    check_plane(table[:, 3], radii)
    origin: dict[str, Any] = {"source": path.name, "format": "LAMMPS data", "header": {"title": lines[0]}}
    origin |= text.precision(rows, [names.index("x"), names.index("y")])
    return Packing(table[:, 1:3], radii, Box(cell), wanted.potential or "harmonic", provenance=origin)


def _header(text: Text, end: int) -> dict[str, list[float]]:
    """Return the numbers before each keyword of the header."""
    found: dict[str, list[float]] = {}
    for n in text.rows(1, end):
        words = text.words(n)
        for name in HEADER:
            size = len(words) - len(name.split())
            if size > 0 and words[size:] == name.split():
                check_once([*found, name], n, "keyword")
                found[name] = numbers(words[:size], n)
                if size != {"atoms": 1, "avec": 3, "bvec": 3, "xy xz yz": 3}.get(name, 2):
                    raise InputError(f"line {n + 1}: {size} numbers in front of {name!r}")
    return found


def read_lammps_dump(path: Path, wanted: Wanted) -> Packing:
    """Read a dump with id, x y (or xu, xs, xsu), and radius, diameter or type; the disks are sorted by id.

    Parameters
    ----------
    path : Path
    wanted : Wanted
    """
    text = Text(path)
    lines = text.lines
    starts = [n for n, line in enumerate(lines) if line == "ITEM: TIMESTEP"]
    index = wanted.one_of(len(starts))
    start, end = [*starts, len(lines)][index : index + 2]
    items = _items(lines, start, end)

    def rows(name: str, count: int) -> range:
        first, _ = items[name]
        last = first + count
        if last > end or (last < end and not lines[last].startswith("ITEM: ")):
            missing = f"{count} rows of {name} from line {first + 1} on"
            raise InputError(f"line {min(last, end) + 1}: expected {missing}")
        return range(first, last)

    n, words = items["BOX BOUNDS"]
    shape = " ".join(words[:-3])
    if shape not in BOUNDS or words[-3:-1] != ["pp", "pp"]:
        known = ", ".join(repr(f"{shape} pp pp …".strip()) for shape in BOUNDS)
        raise InputError(f"line {n}: expected ITEM: BOX BOUNDS with one of {known}, not {' '.join(words)!r}")
    box = rows("BOX BOUNDS", 3)
    cell, corner = _dump_cell(text.table(box, BOUNDS[shape], range(BOUNDS[shape])))

    n, names = items["ATOMS"]
    check_once(names, n - 1, "column")
    kind = next((kind for kind in ("", "u", "s", "su") if {f"x{kind}", f"y{kind}"} <= set(names)), None)
    sizes = [name for name in ("radius", "diameter") if name in names]
    if kind is None or "id" not in names or not (sizes or "type" in names):
        raise InputError(
            f"line {n}: needed are the columns id, x y (or xu yu, xs ys, xsu ysu), and radius, diameter or "
            f"type, not {' '.join(names)!r}"
        )
    (row,) = rows("NUMBER OF ATOMS", 1)
    try:
        atoms = rows("ATOMS", parsed_whole(lines[row]))
    except ValueError as error:
        raise InputError(f"line {row + 1}: {error}") from None
    places = [f"{x}{kind}" for x in "xyz" if f"{x}{kind}" in names]
    table = text.table(atoms, len(names), [names.index(name) for name in ["id", *places, *sizes]])
    text.check_end(atoms)
    order = by_id(table[:, 0])
    table = table[order]
    x, given = table[:, 1 : 1 + len(places)], dict(zip(sizes, table.T[1 + len(places) :], strict=True))
    radii = _radii(wanted, text, np.array(atoms)[order], names, given)
    check_plane(np.append(0, cell[:2, 2]), radii)
    check_plane(x[:, 2:] * (cell[2, 2] if kind in ("s", "su") else 1), radii)
    if kind in ("s", "su"):
        x = x[:, :2] @ cell[:2, :2] + corner[:2]
    origin: dict[str, Any] = {"source": path.name, "format": "LAMMPS dump", "index": index}
    origin["header"] = {"timestep": lines[start + 1]}
    origin |= text.precision(atoms, [names.index(name) for name in places[:2]])
    return Packing(x[:, :2], radii, Box(cell[:2, :2]), wanted.potential or "harmonic", provenance=origin)


def _items(lines: Sequence[str], start: int, end: int) -> dict[str, tuple[int, list[str]]]:
    """Return, for each item of a frame, the first line of its rows and the words behind its name."""
    items: dict[str, tuple[int, list[str]]] = {}
    for n in range(start, end):
        if found := ITEM.match(lines[n]):
            check_once([*items, found[1]], n, "item")
            items[found[1]] = n + 1, found[2].split()
    for name in ("NUMBER OF ATOMS", "BOX BOUNDS", "ATOMS"):
        if name not in items:
            raise InputError(f"line {start + 1}: this frame lacks 'ITEM: {name}'")
    return items


def _radii(wanted: Wanted, text: Text, rows: Iterable[int], names: list[str], sizes: dict[str, Array]) -> Array:
    return wanted.radii(sizes, [text.words(n)[names.index("type")] for n in rows] if "type" in names else [])


def _widths(bounds: Sequence[Sequence[float]]) -> tuple[list[float], list[float]]:
    """Return the width of a box along each axis, and its lower ends."""
    for (low, high), axis in zip(bounds, "xyz", strict=False):
        if high < low:
            raise InputError(f"{axis}lo = {low:g} lies above {axis}hi = {high:g}")
    return [high - low for low, high in bounds], [low for low, _ in bounds]


def _dump_cell(bounds: Array) -> tuple[Array, Array]:
    """Return the lattice vectors (l, x) and the origin (x) of the box of a dump."""
    if bounds.shape == (3, 4):
        return bounds[:, :3], bounds[:, 3]
    xy, xz, yz = bounds[:, 2].tolist() if bounds.shape == (3, 3) else (0.0, 0.0, 0.0)
    low, high = bounds[:, 0].copy(), bounds[:, 1].copy()
    tops = (0, xy, xz, xy + xz)  # the bounds are those of a rectangle around the tilted box
    low[:2] -= min(tops), min(0, yz)
    high[:2] -= max(tops), max(0, yz)
    (x, y, z), corner = _widths(np.stack([low, high], axis=1).tolist())
    return np.array([[x, 0, 0], [xy, y, 0], [xz, yz, z]]), np.array(corner)
