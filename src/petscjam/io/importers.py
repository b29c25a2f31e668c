"""Packings that other programs wrote. The format is found from the content; a new one is one entry below.

A reader takes a path and an index and gives a packing. It complains without naming the file: that is
done once, for all of them. Nothing is rescaled.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from petscjam.box import Array, Box
from petscjam.errors import InputError
from petscjam.packing import h5md
from petscjam.packing.packing import Packing
from petscjam.storage import HDF5_SIGNATURE, naming, open_h5


@dataclass(frozen=True)
class Format:
    """A file format: how to recognise it from the path and the first bytes, and how to read it."""

    name: str
    recognises: Callable[[Path, bytes], bool]
    read: Callable[[Path, int], Packing]


def import_packing(path: str | PathLike[str], index: int = 0) -> Packing:
    """Read a packing of any known format.

    Parameters
    ----------
    path : path
    index : int
        Which packing, counted from 0, where a file holds several.

    Returns
    -------
    Packing
        In the length unit of the file. Except for our own files, the provenance holds the name of the
        file, the format, and what its header says about its origin.

    Raises
    ------
    InputError
        If the file cannot be read or its format is unknown, or naming the line that makes no sense.
    """
    path = Path(path)
    with naming(path):
        with open(path, "rb") as file:
            head = file.read(4096)
        for kind in FORMATS:
            if kind.recognises(path, head):
                return kind.read(path, index)
        raise InputError(f"unknown format; known are {', '.join(kind.name for kind in FORMATS)}")


def read_h5md(path: Path, index: int) -> Packing:
    """Read our own H5MD."""
    _check_index(index, 1)
    return h5md.read(path)


def read_jaxmd(path: Path, index: int) -> Packing:
    """Read the netCDF (HDF5) files of jax-md's tests: ½(1 − r/σ)², positions as fractions of the box.

    A box of jax-md multiplies columns, so its lattice vectors are columns.
    """
    with open_h5(path) as file:
        _check_index(index, len(file["pos"]))
        cell = file["box"][index].reshape(2, 2).T
        positions = file["pos"][index].reshape(-1, 2) @ cell
        origin = {"source": path.name, "format": "jax-md netCDF-4", "index": index}
        return Packing(positions, file["rad"][index], Box(cell), "harmonic-relative", provenance=origin)


def read_jambashbulk(path: Path, index: int) -> Packing:
    """Read the text of jamBashBulk, k = 1: for each packing a header, then x, y, radius between braces."""
    lines = _lines(path)
    headers = [n for n, line in enumerate(lines) if line.startswith("N = ")]
    _check_index(index, len(headers))
    n = headers[index]
    header = re.match(r"N = (\d+) ,.*L1= { (\S+) , (\S+) }\s*,L2= { (\S+) , (\S+) }", lines[n])
    if not header:
        raise InputError(f"line {n + 1}: expected 'N = … ,L = … ,L1= {{ … }} ,L2= {{ … }}', not {lines[n]!r}")
    count, cell = int(header[1]), np.reshape(_numbers(header.groups()[1:], n), (2, 2))
    for at, brace in ((n + 1, "{"), (n + 2 + count, "}")):
        if at >= len(lines) or lines[at] != brace:
            at = min(at, len(lines))
            raise InputError(f"line {at + 1}: expected '{brace}': N = {count} rows in braces")
    x, y, radii = _table(lines[: n + 2 + count], n + 2, 3, [0, 1, 2]).T
    origin = {"source": path.name, "format": "jamBashBulk text", "index": index}
    said = "\n".join([*lines[: headers[0]], lines[n]])
    patterns = {"commit": r"commit (\w+)", "seed": r"srand\((\d+)\)", "P": r"P = (\S+)", "P0": r"P0= (\S+)"}
    for key, pattern in patterns.items():
        if found := re.search(pattern, said):
            origin[key] = found[1]
    return Packing(np.stack([x, y], axis=1), radii, Box(cell), "harmonic", provenance=origin)


def read_xyz(path: Path, index: int) -> Packing:
    """Read extended XYZ: one frame in the plane, with a column ``radius`` and ``potential=…``.

    What else the comment line says goes to the provenance.
    """
    _check_index(index, 1)
    lines = _lines(path)
    try:
        entries = dict(word.split("=", 1) for word in shlex.split(lines[1]) if "=" in word)
        columns, width = _columns(entries.pop("Properties", "species:S:1:pos:R:3"))
    except ValueError as error:
        raise InputError(f"line 2: {error}") from error
    for key, example in (("Lattice", '"ax ay 0 bx by 0 0 0 cz"'), ("potential", "harmonic")):
        if key not in entries:
            raise InputError(f"line 2: {key} is missing; write it as {key}={example}")
    for name, size in (("pos", 3), ("radius", 1)):
        if len(columns.get(name, ())) != size:
            raise InputError(f"line 2: Properties must have {name}:R:{size}")
    if len(lines) - 2 != int(lines[0]):
        raise InputError(f"line {len(lines)}: this is row {len(lines) - 2} and the last, not {lines[0]}")
    x, y, z, radii = _table(lines, 2, width, columns["pos"] + columns["radius"]).T
    lattice = _numbers(entries.pop("Lattice").split(), 1)
    if len(lattice) != 9 or any(lattice[k] != 0 for k in (2, 5, 6, 7)) or np.ptp(z) > 0:
        raise InputError('line 2: not in the plane: z must be constant, Lattice "ax ay 0 bx by 0 0 0 cz"')
    if not entries.pop("pbc", "T T F").startswith("T T"):
        raise InputError('line 2: a packing is periodic along both lattice vectors: pbc="T T F"')
    law = entries.pop("potential")
    origin = {**entries, "source": path.name, "format": "extended XYZ"}
    cell = np.array([lattice[:2], lattice[3:5]])
    return Packing(np.stack([x, y], axis=1), radii, Box(cell), law, provenance=origin)


def _check_index(index: int, count: int) -> None:
    if not 0 <= index < count:
        raise InputError(f"there is no packing {index}; the file holds {count}, counted from 0")


def _lines(path: Path) -> list[str]:
    """Return the lines, stripped, without empty ones at the end."""
    return [line.strip() for line in path.read_text(errors="replace").rstrip().split("\n")]


def _numbers(words: Sequence[str], n: int) -> list[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError as error:
        raise InputError(f"line {n + 1}: {error}") from error
    if not np.isfinite(numbers).all():
        raise InputError(f"line {n + 1}: a number is not finite: {' '.join(words)}")
    return numbers


def _columns(properties: str) -> tuple[dict[str, list[int]], int]:
    """Return the columns of each name:type:size of extended XYZ, and how many there are."""
    fields = properties.split(":")
    columns, width = {}, 0
    for name, _, size in zip(fields[::3], fields[1::3], fields[2::3], strict=True):
        columns[name] = list(range(width, width + int(size)))
        width += int(size)
    return columns, width


def _table(lines: list[str], first: int, width: int, columns: list[int]) -> Array:
    """Read ``columns`` of the lines from ``first`` on, which have ``width`` words each."""
    rows = []
    for n, line in enumerate(lines[first:], first):
        words = line.replace(",", " ").split()
        if len(words) != width:
            raise InputError(f"line {n + 1}: expected {width} columns, not {line!r}")
        rows.append(_numbers([words[k] for k in columns], n))
    return np.reshape(rows, (len(rows), len(columns)))


def _h5_with(*names: str) -> Callable[[Path, bytes], bool]:
    def recognises(path: Path, head: bytes) -> bool:
        if not head.startswith(HDF5_SIGNATURE):
            return False
        with open_h5(path) as file:
            return all(name in file for name in names)

    return recognises


def _text_with(pattern: bytes) -> Callable[[Path, bytes], bool]:
    return lambda path, head: re.search(pattern, head) is not None


FORMATS = (
    Format("H5MD of petscjam", _h5_with("h5md"), read_h5md),
    Format("jax-md netCDF-4", _h5_with("pos", "rad", "box"), read_jaxmd),
    Format("jamBashBulk text", _text_with(rb"(?m)^N = \d+ ,L = "), read_jambashbulk),
    Format("extended XYZ", _text_with(rb"^\d+\s*\n.*(Lattice|Properties)="), read_xyz),
)
