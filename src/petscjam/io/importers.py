"""Packings that other programs wrote. The format is found from the content; a new one is one entry below.

A reader takes a path, an index and the potential that the caller chose, if any; it gives a packing, with
the potential of the file if that says one. It complains without naming the file: that is done once, for
all of them. Nothing is rescaled.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from petscjam.box import Array, Box
from petscjam.errors import InputError
from petscjam.packing import h5md
from petscjam.packing.packing import Packing
from petscjam.storage import HDF5_SIGNATURE, naming, open_h5

GSD_SIGNATURE = b"\xdf\x65" * 4


@dataclass(frozen=True)
class Format:
    """A file format: how to recognise it from the path and the first bytes, and how to read it."""

    name: str
    recognises: Callable[[Path, bytes], bool]
    read: Callable[[Path, int, str | None], Packing]


def import_packing(path: str | PathLike[str], index: int = 0, potential_name: str | None = None) -> Packing:
    """Read a packing of any known format.

    Parameters
    ----------
    path : path
    index : int
        Which packing, counted from 0, where a file holds several.
    potential_name : str, optional
        The contact potential of a file that does not say it: GSD and LAMMPS (left out: ``harmonic``), and
        extended XYZ without ``potential=``.

    Returns
    -------
    Packing
        In the length unit of the file. Except for our own files, the provenance holds the name of the
        file, the format and, as ``header``, what its header says about its origin.

    Raises
    ------
    InputError
        If the file cannot be read, its format is unknown or its potential another one than
        ``potential_name``, or naming the line that makes no sense.
    """
    path = Path(path)
    with naming(path):
        with open(path, "rb") as file:
            head = file.read(4096)
        for kind in FORMATS:
            if kind.recognises(path, head):
                packing = kind.read(path, index, potential_name)
                if potential_name not in (None, packing.potential_name):
                    known = packing.potential_name
                    raise InputError(f"the potential of this file is {known!r}, not {potential_name!r}")
                return packing
        raise InputError(f"unknown format; known are {', '.join(kind.name for kind in FORMATS)}")


def read_h5md(path: Path, index: int, chosen: str | None) -> Packing:
    """Read our own H5MD."""
    _check_index(index, 1)
    return h5md.read(path)


def read_sheared(path: Path, index: int, chosen: str | None) -> Packing:
    """Read the last state of a sheared run as it is: not minimised."""
    from petscjam.md.quench import snapshot
    from petscjam.md.result import read_run

    _check_index(index, 1)
    with open_h5(path) as file:
        packing = snapshot(read_run(file))
    return replace(packing, provenance={**packing.provenance, "source": path.name, "format": "petscjam run"})


def read_jaxmd(path: Path, index: int, chosen: str | None) -> Packing:
    """Read the netCDF (HDF5) files of jax-md's tests: ½(1 − r/σ)², positions as fractions of the box.

    A box of jax-md multiplies columns, so its lattice vectors are columns.
    """
    with open_h5(path) as file:
        _check_index(index, len(file["pos"]))
        cell = file["box"][index].reshape(2, 2).T
        positions = file["pos"][index].reshape(-1, 2) @ cell
        origin = {"source": path.name, "format": "jax-md netCDF-4", "index": index}
        return Packing(positions, file["rad"][index], Box(cell), "harmonic-relative", provenance=origin)


def read_jambashbulk(path: Path, index: int, chosen: str | None) -> Packing:
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
    origin: dict[str, Any] = {"source": path.name, "format": "jamBashBulk text", "index": index, "header": {}}
    said = "\n".join([*lines[: headers[0]], lines[n]])
    patterns = {"commit": r"commit (\w+)", "seed": r"srand\((\d+)\)", "P": r"P = (\S+)", "P0": r"P0= (\S+)"}
    for key, pattern in patterns.items():
        if found := re.search(pattern, said):
            origin["header"][key] = found[1]
    return Packing(np.stack([x, y], axis=1), radii, Box(cell), "harmonic", provenance=origin)


def read_xyz(path: Path, index: int, chosen: str | None) -> Packing:
    """Read extended XYZ: one frame in the plane, with a column ``radius`` and ``potential=…``.

    What else the comment line says is the ``header`` of the provenance.
    """
    _check_index(index, 1)
    lines = _lines(path)
    try:
        entries = dict(word.split("=", 1) for word in shlex.split(lines[1]) if "=" in word)
        columns, width = _columns(entries.pop("Properties", "species:S:1:pos:R:3"))
    except ValueError as error:
        raise InputError(f"line 2: {error}") from error
    if chosen:
        entries.setdefault("potential", chosen)
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
    origin = {"source": path.name, "format": "extended XYZ", "header": entries}
    cell = np.array([lattice[:2], lattice[3:5]])
    return Packing(np.stack([x, y], axis=1), radii, Box(cell), law, provenance=origin)


def read_gsd(path: Path, index: int, chosen: str | None) -> Packing:
    """Read GSD, as HOOMD-blue writes it; lengths there are in single precision as a rule."""
    try:
        with gsd_library().hoomd.open(path) as trajectory:
            _check_index(index, len(trajectory))
            frame = trajectory[index]
    except InputError:
        raise
    except (RuntimeError, LookupError, TypeError, ValueError, MemoryError) as error:
        reason = re.sub(rf"[: ]*{re.escape(str(path))}", "", str(error))
        raise InputError(f"damaged GSD file, or not of HOOMD's schema ({reason})") from error
    disks = frame.particles
    x, y, z = disks.position.T
    _check_plane(z)
    if (disks.diameter == 1).all() and len(np.unique(disks.typeid)) > 1:
        raise InputError(
            f"particles/diameter is 1, the default, for every disk, though there are types {disks.types}; "
            "write the diameters to the file"
        )
    width, height, _, tilt, _, _ = np.asarray(frame.configuration.box, dtype=float)
    origin = {"source": path.name, "format": "GSD", "index": index, "precision": str(x.dtype)}
    origin["header"] = {"step": int(frame.configuration.step)}
    radii = disks.diameter.astype(float) / 2
    cell = np.array([[width, 0], [tilt * height, height]])
    return Packing(np.stack([x, y], axis=1), radii, Box(cell), chosen or "harmonic", provenance=origin)


# No library that reads LAMMPS gives radii in double precision without bringing a whole program along:
# lammpsio and ASE drop them, MDAnalysis rounds positions to single precision.


def read_lammps_data(path: Path, index: int, chosen: str | None) -> Packing:
    """Read a data file of LAMMPS of ``atom_style sphere``; the disks are sorted by id."""
    _check_index(index, 1)
    said = _lines(path)
    lines = [line.partition("#")[0].rstrip() for line in said]
    if "Atoms" not in lines:
        raise InputError("the section Atoms is missing")
    n = lines.index("Atoms")
    if said[n].partition("#")[2].strip() != "sphere":
        raise InputError(
            f"line {n + 1}: {said[n]!r} has no radii; needed is 'Atoms # sphere', with the columns "
            "id type diameter density x y z"
        )

    def header(name: str, size: int, default: list[float] | None = None) -> list[float]:
        for k, line in enumerate(lines[1:n], 1):
            words = line.split()
            if words[size:] == name.split():
                return _numbers(words[:size], k)
        if default is None:
            raise InputError(f"the header lacks '{name}'")
        return default

    first = n + 2  # below an empty line
    end = next((k for k in range(first, len(lines)) if not lines[k]), len(lines))
    (count,) = header("atoms", 1)
    if end - first != count:
        rows = max(end - first, 0)
        raise InputError(
            f"line {n + 1}: {rows} rows below an empty line, but {count:.0f} atoms in the header"
        )
    images = any(len(line.split()) > 7 for line in lines[first:end])
    table = _table(lines[:end], first, 10 if images else 7, [0, 2, 4, 5, 6])
    _, diameter, x, y, z = table[np.argsort(table[:, 0])].T
    _check_plane(z)
    if header("avec", 3, []):
        vectors = np.array([header("avec", 3), header("bvec", 3)])
        _check_plane(np.append(0, vectors[:, 2]))
        cell = vectors[:, :2]
    else:
        (xlo, xhi), (ylo, yhi) = header("xlo xhi", 2), header("ylo yhi", 2)
        xy, _, _ = header("xy xz yz", 3, [0, 0, 0])
        cell = np.array([[xhi - xlo, 0], [xy, yhi - ylo]])
    origin = {"source": path.name, "format": "LAMMPS data", "header": {"title": said[0]}}
    return Packing(np.stack([x, y], axis=1), diameter / 2, Box(cell), chosen or "harmonic", provenance=origin)


def read_lammps_dump(path: Path, index: int, chosen: str | None) -> Packing:
    """Read a text dump of LAMMPS with id, x y (or xu, xs, xsu) and radius or diameter; sorted by id."""
    lines = _lines(path)
    starts = [n for n, line in enumerate(lines) if line == "ITEM: TIMESTEP"]
    _check_index(index, len(starts))
    start, end = [*starts, len(lines)][index : index + 2]
    items = {}
    for n in range(start, end):
        if found := re.match("ITEM: (TIMESTEP|NUMBER OF ATOMS|BOX BOUNDS|ATOMS)(.*)", lines[n]):
            items[found[1]] = n + 1, found[2].split()
    for name in ("NUMBER OF ATOMS", "BOX BOUNDS", "ATOMS"):
        if name not in items:
            raise InputError(f"line {start + 1}: this frame lacks 'ITEM: {name}'")

    def rows(name: str, count: int, width: int, columns: list[int]) -> Array:
        first, _ = items[name]
        last = first + count
        if last > end or (last < end and not lines[last].startswith("ITEM: ")):
            missing = f"{count} rows of {name} from line {first + 1} on"
            raise InputError(f"line {min(last, end) + 1}: expected {missing}")
        return _table(lines[:last], first, width, columns)

    n, words = items["BOX BOUNDS"]
    shape = " ".join(words[:-3])
    if shape not in BOUNDS or words[-3:-1] != ["pp", "pp"]:
        known = ", ".join(repr(f"{shape} pp pp …".strip()) for shape in BOUNDS)
        raise InputError(f"line {n}: expected ITEM: BOX BOUNDS with one of {known}, not {' '.join(words)!r}")
    cell, corner = _dump_cell(rows("BOX BOUNDS", 3, BOUNDS[shape], list(range(BOUNDS[shape]))))

    n, names = items["ATOMS"]
    kind = next((kind for kind in ("", "u", "s", "su") if {f"x{kind}", f"y{kind}"} <= set(names)), None)
    size = next((size for size in ("radius", "diameter") if size in names), None)
    if kind is None or size is None or "id" not in names:
        raise InputError(
            f"line {n}: needed are the columns id, x y (or xu yu, xs ys, xsu ysu) and radius or diameter, "
            f"not {' '.join(names)!r}"
        )
    wanted = ["id", f"x{kind}", f"y{kind}", size, f"z{kind}"][: 5 if f"z{kind}" in names else 4]
    count = int(rows("NUMBER OF ATOMS", 1, 1, [0])[0, 0])
    table = rows("ATOMS", count, len(names), [names.index(name) for name in wanted])
    table = table[np.argsort(table[:, 0])]
    positions, radii = table[:, 1:3], table[:, 3] / (2 if size == "diameter" else 1)
    _check_plane(table[:, 4:])
    if kind in ("s", "su"):
        positions = positions @ cell + corner
    origin = {"source": path.name, "format": "LAMMPS dump", "index": index}
    origin["header"] = {"timestep": lines[start + 1]}
    return Packing(positions, radii, Box(cell), chosen or "harmonic", provenance=origin)


BOUNDS = {"": 2, "xy xz yz": 3, "abc origin": 4}  # ways of a dump to write the box: numbers in each line


def _dump_cell(bounds: Array) -> tuple[Array, Array]:
    """Return the lattice vectors and the origin of a box of a LAMMPS dump."""
    if bounds.shape == (3, 4):
        _check_plane(np.append(0, bounds[:2, 2]))
        return bounds[:2, :2], bounds[:2, 3]
    tilt = bounds[:, 2] if bounds.shape == (3, 3) else np.zeros(3)
    xy, xz, yz = tilt.tolist()
    (xlo, xhi), (ylo, yhi), _ = bounds[:, :2].tolist()
    tops = (0, xy, xz, xy + xz)  # the bounds are those of a rectangle around the tilted box
    xlo, xhi, ylo, yhi = xlo - min(tops), xhi - max(tops), ylo - min(0, yz), yhi - max(0, yz)
    return np.array([[xhi - xlo, 0], [xy, yhi - ylo]]), np.array([xlo, ylo])


def gsd_library() -> Any:
    """Return the package gsd.

    Raises
    ------
    InputError
        If it is not installed.
    """
    try:
        import gsd.fl
        import gsd.hoomd
    except ImportError as error:
        raise InputError("GSD needs the package gsd: pip install gsd") from error
    return gsd


def _check_plane(z: Array) -> None:
    if (z != z[:1]).any():
        raise InputError(f"not in the plane: z runs from {z.min()} to {z.max()}")


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
    Format("run of petscjam", _h5_with("settings", "rows", "state"), read_sheared),
    Format("jax-md netCDF-4", _h5_with("pos", "rad", "box"), read_jaxmd),
    Format("jamBashBulk text", _text_with(rb"(?m)^N = \d+ ,L = "), read_jambashbulk),
    Format("GSD", lambda path, head: head.startswith(GSD_SIGNATURE), read_gsd),
    Format("LAMMPS dump", _text_with(rb"\AITEM: "), read_lammps_dump),
    Format("LAMMPS data", _text_with(rb"(?m)^\s*\d+\s+atoms\b"), read_lammps_data),
    Format("extended XYZ", _text_with(rb"^\d+\s*\n.*(Lattice|Properties)="), read_xyz),
)
