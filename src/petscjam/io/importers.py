"""Packings of other programs. The format is recognised from the content; a new format is one entry below.

A reader takes a path and a :class:`petscjam.io.reading.Wanted`, and returns a packing, with the potential of the
file if there is one. The name of the file is added to its error messages here. Lengths are not rescaled.
"""

from __future__ import annotations

import bz2
import gzip
import lzma
import re
import shutil
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from petscjam.base.errors import InputError
from petscjam.base.files import HDF5_SIGNATURE, naming, open_h5
from petscjam.base.types import Array
from petscjam.geometry import packing_file
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.packing import Packing
from petscjam.geometry.potential import POTENTIALS
from petscjam.io.arrays import NETCDF_SIGNATURE, open_arrays, read_h5md, read_jaxmd, read_jsrc
from petscjam.io.gsd_file import read_gsd
from petscjam.io.jambashbulk import read_jambashbulk
from petscjam.io.lammps import read_lammps_data, read_lammps_dump
from petscjam.io.reading import Wanted, digits_of
from petscjam.io.xyz import read_xyz

GSD_SIGNATURE = b"\xdf\x65" * 4
BYTE_ORDER_MARK = b"\xef\xbb\xbf"
UTF_16 = re.compile(rb"\xff\xfe|\xfe\xff|(?:[\t-~]\0){4}|(?:\0[\t-~]){4}")
PACKED: dict[bytes, Callable[..., Any]] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ\0": lzma.open}


@dataclass(frozen=True)
class Format:
    """A file format: how to recognise it from the path and the first bytes, and how to read it.

    ``typed``: whether disks may have types instead of radii.
    """

    name: str
    recognises: Callable[[Path, bytes], bool]
    read: Callable[[Path, Wanted], Packing]
    typed: bool = False


def import_packing(
    path: str | PathLike[str],
    index: int = 0,
    potential_name: str | None = None,
    diameters: Mapping[str, float] | None = None,
) -> Packing:
    """Read a packing of any known format; the file may be compressed by gzip, bzip2 or xz.

    Parameters
    ----------
    path : path
    index : int
        Number of the packing in a file with several, from 0 on.
    potential_name : str, optional
        The contact potential, if the file does not contain it: GSD, LAMMPS and H5MD of other programs (default
        ``harmonic``), jsrc (``harmonic-relative``), and extended XYZ without ``potential=``.
    diameters : mapping, optional
        The diameter of each type of disks by its name, as ``{"1": 1.0, "2": 1.4}``, in the length unit of the
        file, for a file without radii: extended XYZ, GSD, LAMMPS, H5MD of other programs. Without types,
        too, all disks are of type 1.

    Returns
    -------
    Packing
        In the length unit of the file. Except for petscjam's own files, the provenance has the name of the file,
        the format, its header as ``header``, and the ``precision`` of the positions, if that is less than double.

    Raises
    ------
    InputError
        If the file cannot be read, its format is unknown, it is contradictory, it has radii although
        ``diameters`` are given, or its potential is not ``potential_name``. For an error in text the message
        names the line.
    """
    path = Path(path)
    named = None if diameters is None else {str(name): float(value) for name, value in diameters.items()}
    with naming(path), _unpacked(path) as plain:
        with open(plain, "rb") as file:
            head = file.read(4096).removeprefix(BYTE_ORDER_MARK).lstrip()
        kind = next((kind for kind in FORMATS if kind.recognises(plain, head)), None)
        if kind is None:
            if UTF_16.match(head):
                raise InputError("the text is UTF-16, not UTF-8; convert it: iconv -f UTF-16 -t UTF-8")
            raise InputError(f"unknown format; known are {', '.join(kind.name for kind in FORMATS)}")
        if named is not None and not kind.typed:
            raise InputError(f"a file of {kind.name} has radii; leave out the diameters of types")
        packing = kind.read(plain, Wanted(index, potential_name, named))
        if potential_name not in (None, packing.potential_name):
            known = packing.potential_name
            raise InputError(f"the potential of this file is {known!r}, not {potential_name!r}")
        return packing


@contextmanager
def _unpacked(path: Path) -> Iterator[Path]:
    """Yield ``path``, or for a compressed file a decompressed copy of the same name."""
    with open(path, "rb") as file:
        head = file.read(8)
    unpack = next((unpack for signature, unpack in PACKED.items() if head.startswith(signature)), None)
    if unpack is None:
        yield path
        return
    with TemporaryDirectory() as folder:
        copy = Path(folder, path.name)
        try:
            with unpack(path) as packed, open(copy, "wb") as file:
                shutil.copyfileobj(packed, file)
        except (EOFError, zlib.error, lzma.LZMAError, gzip.BadGzipFile) as error:
            raise InputError(f"damaged or truncated, cannot be decompressed ({error})") from None
        try:
            yield copy
        except InputError as error:
            raise InputError(str(error).removeprefix(f"{copy}: ")) from None


def read_own(path: Path, wanted: Wanted) -> Packing:
    """Read petscjam's own H5MD.

    Parameters
    ----------
    path : Path
    wanted : Wanted
    """
    wanted.one_of(1)
    return Packing.read(path)


def read_sheared(path: Path, wanted: Wanted) -> Packing:
    """Read the last state of a sheared run, not minimised.

    Parameters
    ----------
    path : Path
    wanted : Wanted
    """
    from petscjam.md.quench import snapshot
    from petscjam.md.result import read_run

    wanted.one_of(1)
    with open_h5(path) as file:
        packing = snapshot(read_run(file))
    return replace(packing, provenance={**packing.provenance, "source": path.name, "format": "petscjam run"})


def imbalance(packing: Packing) -> str | None:
    """Return a text on the size of the net forces on disks and their likely cause; None if forces balance.

    Rounding of the numbers by up to δ gives forces of about k·δ on a disk.

    Raises
    ------
    InputError
        If two disks have the same position.
    """
    network = ContactNetwork.of(packing)
    if network.balanced:
        return None
    share, force = network.net_force, network.net_force * network.pressure * packing.mean_diameter
    size = f"up to {share:.2g} p·d on a disk, {force / network.force.mean():.2g} mean contact forces"
    return f"{size}; likely cause: {_cause(packing, network, force)}"


def _cause(packing: Packing, network: ContactNetwork, force: float) -> str:
    for name in POTENTIALS:
        left = ContactNetwork.of(replace(packing, potential_name=name)).net_force
        if left < 1e-3 * network.net_force:
            return f"the potential: under {name} they balance to {left:.1g} p·d (--potential {name})"
    reach = force / float(network.stiffness.max())
    largest, said = float(abs(packing.positions).max()), str(packing.provenance.get("precision"))
    x = packing.positions
    if said == "float32" or (x == x.astype(np.float32)).all():
        if reach < 30 * np.spacing(np.float32(largest)):
            return "positions in single precision (float32)"
    else:
        found = re.fullmatch(r"(\d+) digits", said)
        digits = int(found[1]) if found else _digits(x)
        if reach < 30 * _last_digit(largest, digits):
            return f"positions of {digits} digits"
    digits = _digits(np.unique(packing.radii))
    last = _last_digit(float(packing.radii.max()), digits)
    if digits < 8 and 0.1 * last < reach < 3 * last:
        return f"radii of {digits} digits, if these are rounded"
    return f"the disks are not at a minimum of the potential {packing.potential_name}"


def _digits(values: Array) -> int:
    return max(len(digits_of(repr(value))) for value in values.ravel()[:200].tolist())


def _last_digit(largest: float, digits: int) -> float:
    """Return the value of the last digit of a number of this size with ``digits`` digits."""
    return 10.0 ** (np.floor(np.log10(largest or 1.0)) + 1 - digits)


def _is_ours(path: Path, head: bytes) -> bool:
    if not head.startswith(HDF5_SIGNATURE):
        return False
    with open_h5(path) as file:
        creator = file["h5md/creator"].attrs.get("name") if "h5md/creator" in file else None
        return packing_file.OURS in file or creator in ("petscjam", b"petscjam")


def _arrays(*names: str) -> Callable[[Path, bytes], bool]:
    def recognises(path: Path, head: bytes) -> bool:
        if not head.startswith((HDF5_SIGNATURE, NETCDF_SIGNATURE)):
            return False
        with open_arrays(path) as file:
            return all(name in file for name in names)

    return recognises


def _text_with(pattern: bytes) -> Callable[[Path, bytes], bool]:
    return lambda path, head: re.search(pattern, head.replace(b"\r", b"\n")) is not None


FORMATS = (
    Format("H5MD of petscjam", _is_ours, read_own),
    Format("run of petscjam", _arrays("settings", "rows", "state"), read_sheared),
    Format("H5MD", _arrays("h5md"), read_h5md, typed=True),
    Format("jax-md netCDF-4", _arrays("pos", "rad", "box"), read_jaxmd),
    Format("jsrc database", _arrays("pos", "rad", "BoxMatrix"), read_jsrc),
    Format("jamBashBulk text", _text_with(rb"(?m)^N = \d+ ,L = "), read_jambashbulk),
    Format("GSD", lambda path, head: head.startswith(GSD_SIGNATURE), read_gsd, typed=True),
    Format("LAMMPS dump", _text_with(rb"\AITEM: "), read_lammps_dump, typed=True),
    Format("LAMMPS data", _text_with(rb"(?m)^\s*[-+.\d]+\s+atoms\b"), read_lammps_data, typed=True),
    Format("extended XYZ", _text_with(rb"\A[-+.\d]+[ \t]*\n"), read_xyz, typed=True),
)
