"""Packings for other programs. A new format is one entry below: a function from a packing to bytes."""

from __future__ import annotations

from os import PathLike

import numpy as np

from petscjam.errors import InputError
from petscjam.packing.packing import Packing
from petscjam.storage import check_output, write_atomically


def export_packing(
    packing: Packing, path: str | PathLike[str], to: str = "xyz", overwrite: bool = False
) -> None:
    """Write ``packing`` to ``path`` in the format ``to``, in its own length unit.

    Raises
    ------
    InputError
        If the format is unknown, or ``path`` exists (unless ``overwrite``) or cannot be written.
    """
    if to not in FORMATS:
        raise InputError(f"export: {to!r} is unknown; known are {', '.join(FORMATS)}")
    check_output(path, overwrite=overwrite)
    write_atomically(path, FORMATS[to](packing))


def extended_xyz(packing: Packing) -> bytes:
    """Extended XYZ, as OVITO and ASE read it; :func:`petscjam.import_packing` gives back the same bits.

    The third lattice vector is one largest diameter. Species are chemical symbols, because some readers
    insist, by size from H on; "X" where there are more than ten sizes.
    """
    _, size = np.unique(packing.radii, return_inverse=True)
    symbols = SYMBOLS if size.max() < len(SYMBOLS) else ["X"] * (size.max() + 1)
    (ax, ay), (bx, by) = packing.box.cell.tolist()
    lattice = f"{ax!r} {ay!r} 0 {bx!r} {by!r} 0 0 0 {2 * packing.radii.max()}"
    lines = [
        str(len(packing)),
        f'Lattice="{lattice}" Properties=species:S:1:pos:R:3:radius:R:1 pbc="T T F" '
        f"potential={packing.potential_name} source_checksum={packing.checksum}",
    ]
    for s, (x, y), radius in zip(size, packing.positions.tolist(), packing.radii.tolist(), strict=True):
        lines.append(f"{symbols[s]} {x!r} {y!r} 0 {radius!r}")  # repr gives the digits that round-trip
    return "\n".join([*lines, ""]).encode()


SYMBOLS = ["H", "He", "Li", "Be", "B", "C", "N", "O", "F", "Ne"]
FORMATS = {"xyz": extended_xyz}
