"""Packings as arrays in HDF5 and NetCDF: databases of jsrc and jax-md, and H5MD of other programs.

Axes: i disk, x Cartesian.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from petscjam.base.errors import InputError
from petscjam.base.files import HDF5_SIGNATURE, naming, open_h5, understanding
from petscjam.base.types import Array
from petscjam.geometry.box import Box
from petscjam.geometry.packing import Packing
from petscjam.io.reading import Wanted, check_plane

NETCDF_SIGNATURE = b"CDF"  # of the classic format; version 4 is HDF5
JSRC_POTENTIALS = {"HarmonicPotential": "harmonic-relative", "HertzianPotential": "hertzian-relative"}


@contextmanager
def open_arrays(path: Path) -> Iterator[Mapping[str, Any]]:
    """Open the arrays of an HDF5 or NetCDF file by name, for reading."""
    from scipy.io import netcdf_file

    with naming(path), open(path, "rb") as file:
        signature = file.read(8)
    if signature == HDF5_SIGNATURE:
        with open_h5(path) as h5:
            yield h5
        return
    with understanding("NetCDF file"), netcdf_file(path, mmap=False) as classic:
        yield classic.variables


def read_jaxmd(path: Path, wanted: Wanted) -> Packing:
    """Read the NetCDF files of jax-md's tests: ½(1 − r/σ)², positions as fractions of the box.

    A box of jax-md multiplies columns, so its lattice vectors are columns.

    Parameters
    ----------
    path : Path
    wanted : Wanted
    """
    with open_arrays(path) as file:
        index = wanted.one_of(file["pos"].shape[0])
        cell = np.reshape(file["box"][index], (2, 2)).T
        origin = {"source": path.name, "format": "jax-md netCDF-4", "index": index}
        return _from_fractions(file, index, cell, "harmonic-relative", origin)


def read_jsrc(path: Path, wanted: Wanted) -> Packing:
    """Read a database of jsrc (Goodrich, Liu and Nagel's jamming code): positions as fractions of the box.

    Its boxes multiply columns and are stored column by column: two numbers in sequence are a lattice vector. Its
    potentials are functions of r/σ.

    Parameters
    ----------
    path : Path
    wanted : Wanted
    """
    with open_arrays(path) as file:
        index = wanted.one_of(file["pos"].shape[0])
        matrix = np.ravel(file["BoxMatrix"][index])
        if len(matrix) != 4:
            raise InputError(f"not in the plane: BoxMatrix has {len(matrix)} numbers, not 4")
        box, law = (_string(file, name, index) for name in ("BoxString", "PotString"))
        if box not in ("", "PeriodicBox", "PeriodicBox_2D_0NonPDim"):
            raise InputError(f"the box is {box!r}; a packing is periodic along both lattice vectors")
        if law and law not in JSRC_POTENTIALS:
            raise InputError(f"the potential is {law!r}; known are {', '.join(JSRC_POTENTIALS)}")
        kind = JSRC_POTENTIALS[law] if law else wanted.potential or "harmonic-relative"
        origin = {"source": path.name, "format": "jsrc database", "index": index}
        return _from_fractions(file, index, np.reshape(matrix, (2, 2)), kind, origin)


def _string(file: Mapping[str, Any], name: str, index: int) -> str:
    """Return the name at the beginning of a string of jsrc; parameters follow after colons."""
    if name not in file:
        return ""
    said = np.asarray(file[name][index]).tobytes().decode(errors="replace")
    return said.replace("\0", ":").partition(":")[0].strip()


def _from_fractions(file: Mapping[str, Any], index: int, cell: Array, law: str, origin: dict[str, Any]) -> Packing:
    positions = np.reshape(file["pos"][index], (-1, 2)) @ cell
    return Packing(positions, file["rad"][index], Box(cell), law, provenance=origin)


def read_h5md(path: Path, wanted: Wanted) -> Packing:
    """Read H5MD of another program: its only group of particles, with radii, diameters or species.

    Parameters
    ----------
    path : Path
    wanted : Wanted
    """
    with open_h5(path) as file:
        particles = file.get("particles", {})
        groups = [name for name, node in particles.items() if {"position", "box"} <= set(node)]
        if len(groups) != 1:
            raise InputError(
                f"H5MD with {len(groups)} groups of particles that have positions and a box, not one; "
                "read them in Python and make a Packing(positions, radii, Box(cell))"
            )
        node = particles[groups[0]]
        position, box = node["position"], node["box"]
        index = wanted.one_of(len(position["value"]) if hasattr(position, "keys") else 1)

        def sample(of: Any) -> Any:
            """Return an H5MD element, at the step of the positions if it depends on time."""
            if not hasattr(of, "keys"):
                return of[()]
            if not np.array_equal(of["step"][()], position["step"][()]):
                raise InputError(f"{of.name} is sampled at other steps than the positions")
            return of["value"][index]

        x = sample(position)
        edges = sample(box["edges"]) if "edges" in box else np.empty(0)
        vectors = np.diag(edges) if edges.ndim == 1 else edges
        if x.ndim != 2 or x.shape[1] not in (2, 3) or vectors.shape != (x.shape[1],) * 2:
            raise InputError(f"not in the plane: positions {x.shape}, edges of the box {edges.shape}")
        boundary = np.atleast_1d(box.attrs.get("boundary", [])).astype(str).tolist()
        if boundary[:2] != ["periodic", "periodic"]:
            raise InputError(f"a packing is periodic along both lattice vectors; the boundary is {boundary}")
        sizes = {name: sample(node[name]) for name in ("radius", "diameter") if name in node}
        types = map(str, sample(node["species"])) if "species" in node else ["1"] * len(x)
        radii = wanted.radii(sizes, list(types))
        check_plane(x[:, 2:], radii)
        check_plane(np.append(0, vectors[:2, 2:]), radii)
        origin: dict[str, Any] = {"source": path.name, "format": "H5MD", "index": index}
        origin |= {"precision": str(x.dtype)} if x.dtype != float else {}
        creator = file["h5md/creator"].attrs if "h5md/creator" in file else {}
        origin["header"] = {name: str(creator[name]) for name in ("name", "version") if name in creator}
        law = wanted.potential or "harmonic"
        return Packing(x[:, :2], radii, Box(vectors[:2, :2]), law, provenance=origin)
