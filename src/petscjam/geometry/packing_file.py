"""Packings as H5MD 1.1 files (nongnu.org/h5md), which other programs can read.

H5MD allows two dimensions, but readers such as MDAnalysis require three. So positions have z = 0, and
the cell a third edge, one largest diameter long, along an axis that is not periodic (there the standard
calls the edge a placeholder). The group of particles is called "trajectory" because MDAnalysis reads the number
of particles there:

    universe = MDAnalysis.Universe.empty(len(packing), trajectory=True)
    universe.load_new("p.h5", format="H5MD", convert_units=False)

(A program that stores only lengths and angles of a cell, like MDAnalysis, puts the first edge along x.)
Everything outside the H5MD standard is in /parameters/petscjam.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from petscjam.base.errors import InputError
from petscjam.base.files import atomic_h5, check_output, group, open_h5
from petscjam.base.types import Array
from petscjam.base.versions import release

if TYPE_CHECKING:
    import h5py

SCHEMA = (1, 0)  # a new major number: older programs cannot read the file
PARTICLES, OURS = "particles/trajectory", "parameters/petscjam"
REQUIRED = (
    OURS,
    f"{OURS}/provenance",
    f"{OURS}/certificate",
    f"{PARTICLES}/position/value",
    f"{PARTICLES}/radius",
    f"{PARTICLES}/box/edges/value",
)
UNITS = "lengths as in the source (nothing is rescaled); the potential fixes the unit of energy"


class Stored(NamedTuple):
    """The content of a file of a packing.

    Attributes
    ----------
    positions, radii, cell : (N, 2), (N,), (2, 2)
    potential_name, checksum : str
    certificate : dict
        The measured fields of :class:`petscjam.Certificate`.
    provenance : dict
    """

    positions: Array
    radii: Array
    cell: Array
    potential_name: str
    checksum: str
    certificate: dict[str, Any]
    provenance: dict[str, Any]


def write(path: str | PathLike[str], stored: Stored, *, overwrite: bool = False) -> None:
    """Write a packing to ``path``, completely or not at all.

    Parameters
    ----------
    path : str or PathLike
    stored : Stored
    overwrite : bool

    Raises
    ------
    InputError
        If ``path`` exists and ``overwrite`` is not set, or cannot be written.
    """
    check_output(path, overwrite=overwrite)
    edges = np.diag([0.0, 0.0, 2 * stored.radii.max()])
    edges[:2, :2] = stored.cell
    with atomic_h5(path) as file:
        _write_header(file)
        particles = group(file, PARTICLES)
        position = group(particles, "position")
        position["step"], position["time"] = np.zeros(1, dtype=int), np.zeros(1)
        position["value"] = np.pad(stored.positions, ((0, 0), (0, 1)))[None]
        particles["radius"] = stored.radii
        particles["species"] = np.unique(stored.radii, return_inverse=True)[1]
        box = group(particles, "box")
        box.attrs.update(dimension=3, boundary=np.array([b"periodic", b"periodic", b"none"]))
        group(box, "edges")["value"] = edges[None]
        for name in ("step", "time"):  # hard links, as the standard requires
            box[f"edges/{name}"] = position[name]
        ours = group(file, OURS)
        ours.attrs.update(schema=SCHEMA, potential=stored.potential_name, checksum=stored.checksum, units=UNITS)
        ours["provenance"] = json.dumps(stored.provenance, default=lambda value: value.tolist())
        group(ours, "certificate").attrs.update(stored.certificate)


@contextmanager
def opened(path: str | PathLike[str]) -> Iterator[Stored]:
    """Yield the content of a file of :func:`write`; an InputError of the block names the file.

    Raises
    ------
    InputError
        If the file is missing, is not such a file, or is damaged.
    """
    with open_h5(path) as file:
        missing = [name for name in REQUIRED if name not in file]
        if missing:
            raise InputError(f"HDF5, but not a packing of petscjam: it lacks /{', /'.join(missing)}")
        ours, particles = file[OURS], file[PARTICLES]
        missing = [name for name in ("schema", "potential", "checksum") if name not in ours.attrs]
        if missing:
            raise InputError(f"not a packing of petscjam: /{OURS} lacks the attribute {', '.join(missing)}")
        if ours.attrs["schema"][0] > SCHEMA[0]:
            raise InputError(
                f"written by a newer petscjam (schema {ours.attrs['schema'][0]}; this one reads {SCHEMA[0]})"
            )
        certificate = {
            name: value if isinstance(value, str) else value.tolist()
            for name, value in ours["certificate"].attrs.items()
        }
        yield Stored(
            particles["position/value"][0, :, :2],
            particles["radius"][()],
            particles["box/edges/value"][0, :2, :2],
            ours.attrs["potential"],
            ours.attrs["checksum"],
            certificate,
            json.loads(ours["provenance"][()]),
        )


def _write_header(file: h5py.File) -> None:
    header = group(file, "h5md")
    header.attrs["version"] = (1, 1)
    group(header, "author").attrs["name"] = "unknown"
    group(header, "creator").attrs.update(name="petscjam", version=release("petscjam"))
