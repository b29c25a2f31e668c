"""A path of quasi-static shear as text."""

from __future__ import annotations

from os import PathLike

import numpy as np
from numpy.typing import ArrayLike

from petscjam.analysis.aqs import ShearPath
from petscjam.base.errors import InputError
from petscjam.base.files import check_output, write_atomically

COLUMNS = ("gamma", "stress", "pressure", "contacts", "Z", "modulus", "eigenvalue", "net_force", "proved")


def export_path(
    path: ShearPath,
    file: str | PathLike[str],
    fmt: str = "csv",
    *,
    omegas: ArrayLike | None = None,
    times: ArrayLike | None = None,
    overwrite: bool = False,
) -> None:
    """Write the states of a path as CSV, with the event between a state and the one before it.

    Parameters
    ----------
    path : ShearPath
    file : path
    fmt : str
        ``csv``.
    omegas, times : array_like
        Not used: a path has neither.
    overwrite : bool

    Raises
    ------
    InputError
        If the format is another one, ``omegas`` or ``times`` are given, or ``file`` exists (unless ``overwrite``) or
        cannot be written.
    """
    if fmt != "csv":
        raise InputError(f"export: the format of paths is csv, not {fmt}")
    for name, given in (("omegas", omegas), ("times", times)):
        if given is not None:
            raise InputError(f"{name}: a path of quasi-static shear has none")
    check_output(file, overwrite=overwrite)
    events = np.full(len(path.gamma), "", dtype=object)
    events[path.events + 1] = [path.kind(e) for e in range(len(path.events))]
    made, lost, drop = (np.zeros(len(path.gamma)) for _ in range(3))
    made[path.events + 1], lost[path.events + 1], drop[path.events + 1] = path.count(1), path.count(-1), path.drop
    lines = [
        f"# {path.origin.name}: gamma_xy at constant area; stresses in k, eigenvalue of K in k, net force in p d",
        f"# event, contacts made and lost, stress drop: between the state before and this one; {path.state}",
        ",".join([*COLUMNS, "event", "made", "lost", "drop"]),
    ]
    for k in range(len(path.gamma)):
        values = [f"{getattr(path, name)[k]:.17g}" for name in COLUMNS]
        lines.append(",".join([*values, events[k], f"{made[k]:.0f}", f"{lost[k]:.0f}", f"{drop[k]:.17g}"]))
    write_atomically(file, "\n".join([*lines, ""]).encode())
