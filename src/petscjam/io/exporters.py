"""Packings for other programs. A new format is one entry below: a function from a packing to bytes."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from petscjam.base.errors import InputError
from petscjam.base.files import check_output, naming, write_atomically
from petscjam.base.types import Array, Integers
from petscjam.base.versions import release
from petscjam.geometry.box import Box
from petscjam.geometry.packing import Packing
from petscjam.io.gsd_file import gsd_library


def export_packing(packing: Packing, path: str | PathLike[str], to: str | None = None, overwrite: bool = False) -> None:
    """Write ``packing`` to ``path``, in its own length unit.

    Parameters
    ----------
    packing : Packing
    path : path
    to : str, optional
        ``xyz``, ``gsd`` or ``h5md``. Default: from the extension of ``path``; without one, ``xyz``.
    overwrite : bool

    Raises
    ------
    InputError
        If the format is unknown or not that of the extension, its library is missing, or ``path`` exists (unless
        ``overwrite``) or cannot be written.
    """
    to = format_of(path, to, "xyz")
    if to not in FORMATS:
        raise InputError(f"export: {to!r} is unknown; known are {', '.join(FORMATS)}")
    check_output(path, overwrite=overwrite)
    with naming(path):
        write_atomically(path, FORMATS[to](packing))


def format_of(path: str | PathLike[str], to: str | None, default: str) -> str:
    """Return the format for ``path``: ``to``, or that of the extension, or, without one, ``default``.

    Parameters
    ----------
    path : str or PathLike
    to, default : str
        Names of formats.

    Raises
    ------
    InputError
        If the extension belongs to another format than ``to``, or, without ``to``, to none.
    """
    ending = Path(path).suffix
    meant = ENDINGS.get(ending.lower())
    if to is None and meant is None and ending:
        known = ", ".join(ENDINGS)
        raise InputError(f"export: {path}: no format ends in {ending!r}; known are {known}; or say --to")
    if None not in (to, meant) and to != meant:
        raise InputError(f"export: {path}: {ending!r} is the ending of {meant}, not of {to}")
    return to or meant or default


def extended_xyz(packing: Packing) -> bytes:
    """Extended XYZ for OVITO and ASE; :func:`petscjam.import_packing` reads it with all bits equal.

    The third lattice vector is one largest diameter. Species are chemical symbols, because some readers require
    them.
    """
    symbols, species = _species(packing.radii)
    (ax, ay), (bx, by) = packing.box.cell.tolist()
    lattice = f"{ax} {ay} 0 {bx} {by} 0 0 0 {2 * packing.radii.max()}"
    lines = [
        str(len(packing)),
        f'Lattice="{lattice}" Properties=species:S:1:pos:R:3:radius:R:1 pbc="T T F" '
        f"potential={packing.potential_name} source_checksum={packing.checksum}",
    ]
    for s, (x, y), radius in zip(species, packing.positions.tolist(), packing.radii.tolist(), strict=True):
        lines.append(f"{symbols[s]} {x} {y} 0 {radius}")  # all digits, to read equal bits
    return "\n".join([*lines, ""]).encode()


def gsd(packing: Packing) -> bytes:
    """GSD of HOOMD's schema 1.4 for HOOMD-blue, OVITO and freud: single precision.

    In HOOMD the first lattice vector is along x, the second above it, and the origin in the centre of the cell.
    So the packing is rotated by the angle of its first vector and wrapped into the cell. If the second vector
    would point below the x-axis, it is reversed; the lattice is the same.
    """
    library = gsd_library()
    a, b = packing.box.cell
    b = b * np.sign(a[0] * b[1] - a[1] * b[0])
    width = np.hypot(*a)
    height, tilt = packing.box.area / width, a @ b / width
    s = Box(np.array([a, b])).fractional(packing.positions)
    frame = library.hoomd.Frame()
    frame.configuration.dimensions = 2
    frame.configuration.box = np.array([width, height, 0, tilt / height, 0, 0], dtype=np.float32)
    frame.particles.N = len(packing)
    x, y = ((s - np.floor(s) - 0.5) @ [[width, 0], [tilt, height]]).astype(np.float32).T
    Lx, Ly, _, xy, _, _ = frame.configuration.box
    y = _inside(y, np.zeros_like(y), np.float32(0), Ly)
    x = _inside(x, y, xy, Lx)
    frame.particles.position = np.stack([x, y, np.zeros_like(x)], axis=1)
    frame.particles.diameter = (2 * packing.radii).astype(np.float32)
    frame.particles.types, frame.particles.typeid = _species(packing.radii)
    with TemporaryDirectory() as folder:
        path = Path(folder, "packing.gsd")
        # The schema is given because many readers do not know the default of gsd.open, 2.0 since version 5.
        with library.fl.open(
            str(path), "w", application=f"petscjam {release('petscjam')}", schema="hoomd", schema_version=[1, 4]
        ) as file:
            library.hoomd.HOOMDTrajectory(file).append(frame)
        return path.read_bytes()


def _inside(x: NDArray[Any], y: NDArray[Any], xy: Any, L: Any) -> NDArray[Any]:
    """Return ``x`` (N,) of single precision with −L/2 ≤ x − xy·y < L/2, computed in single and in double.

    The cast may put a disk on the upper edge; then it is rounded towards the centre.
    """
    for power in range(-24, 0):
        s = [(x.astype(t) - xy.astype(t) * y.astype(t)) / L.astype(t) for t in (np.float32, np.float64)]
        out = (np.minimum(*s) < -0.5).astype(np.float32) - (np.maximum(*s) >= 0.5)
        if not out.any():
            break
        x = x + out * np.float32(L * 2.0**power)
    return x


def h5md(packing: Packing) -> bytes:
    """H5MD of petscjam, which MDAnalysis can read (:mod:`petscjam.geometry.packing_file`)."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "packing.h5")
        packing.write(path)
        return path.read_bytes()


def _species(radii: Array) -> tuple[list[str], Integers]:
    """Return names by size, from H on, and the name of each disk; X for all if there are more than ten."""
    sizes, species = np.unique(radii, return_inverse=True)
    if len(sizes) > len(SYMBOLS):
        return ["X"], np.zeros(len(radii), dtype=int)
    return SYMBOLS[: len(sizes)], species


SYMBOLS = ["H", "He", "Li", "Be", "B", "C", "N", "O", "F", "Ne"]
ENDINGS = {
    ".xyz": "xyz",
    ".extxyz": "xyz",
    ".gsd": "gsd",
    ".h5md": "h5md",
    ".h5": "h5md",
    ".hdf5": "h5md",
    ".csv": "csv",
    ".parquet": "parquet",
    ".tts": "tts",
    ".gt": "gt",
}
FORMATS = {"xyz": extended_xyz, "gsd": gsd, "h5md": h5md}
