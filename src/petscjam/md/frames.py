"""Frames of a sheared run for OVITO: one extended XYZ file for each time, which OVITO opens as an animation."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import numpy as np

from petscjam.base.errors import InputError
from petscjam.base.files import naming, write_atomically
from petscjam.md.fields import local_maps
from petscjam.md.state import State

SYMBOLS = "H", "He", "Li", "Be"  # species by size; all larger ones have the last
# OVITO reads the first five as Particle Type, Position, Radius, Velocity and Angular Velocity; the others are
# additional properties.
COLUMNS = "species:S:1:pos:R:3:radius:R:1:velo:R:3:omega:R:3:peculiar:R:1:local_phi:R:1:local_rate:R:1"
ANGLE = ":angle:R:1"  # if the state has angles


def write_frame(state: State, folder: str | PathLike[str], index: int) -> Path:
    """Write ``state`` as frame ``index`` into ``folder``, which is made if necessary, and return the file.

    OVITO opens all frames if one of them is opened: ``frame_*.xyz``. The cell is tilted by γLy modulo Lx.
    Each disk has its velocity (of the image in the cell), spin, magnitude of the peculiar velocity, v − γ̇ y x̂,
    and the packing fraction and the strain rate around it (:func:`petscjam.md.fields.local_maps`), and its angle in
    radians if the run keeps angles; strain, rate and time are attributes of the frame. Units: ds, m, τe.
    :func:`petscjam.import_packing` can read a frame.

    Parameters
    ----------
    state : State
    folder : str or PathLike
    index : int

    Raises
    ------
    InputError
        If the folder or the file cannot be written.
    """
    path = Path(folder) / f"frame_{index:06d}.xyz"
    with naming(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, frame(state))
    return path


def frames_of(output: str | PathLike[str]) -> Path:
    """Return the folder of the frames of a run: that of its file, with another extension."""
    return Path(output).with_suffix(".frames")


def remove_frames(output: str | PathLike[str], *, overwrite: bool) -> None:
    """Remove the frames of the run that ``output`` replaces.

    Parameters
    ----------
    output : str or PathLike
        File of the run.
    overwrite : bool

    Raises
    ------
    InputError
        If there are some and ``overwrite`` is not set.
    """
    for file in frames_of(output).glob("frame_*.xyz"):
        if not overwrite:
            raise InputError(f"{file}: is of another run; choose another name or ask to overwrite it")
        with naming(file):
            file.unlink()


def frame(state: State) -> bytes:
    """Return ``state`` as extended XYZ with the columns :data:`COLUMNS`, and :data:`ANGLE`."""
    moved = state.wrapped()
    cell, nothing = state.box.cell, np.zeros(len(state))
    species = np.minimum(np.unique(state.radii, return_inverse=True)[1], len(SYMBOLS) - 1)
    values = np.column_stack(
        [
            state.box.wrap(moved.positions),
            nothing,
            state.radii,
            moved.velocities,
            nothing,
            nothing,
            nothing,
            state.spins,
            np.hypot(*state.peculiar.T),
            *local_maps(state),
            *([] if state.angles is None else [state.angles]),
        ]
    )
    (ax, ay), (bx, by) = cell.tolist()
    columns = COLUMNS + ANGLE * (state.angles is not None)
    row = " ".join(["%.12g"] * 4 + ["%.7g"] * (values.shape[1] - 4))
    lines = [
        str(len(state)),
        f'Lattice="{ax} {ay} 0 {bx} {by} 0 0 0 {2 * state.radii.max()}" Properties={columns} '
        f'pbc="T T F" Time={state.time} strain={state.strain} rate={state.rate} '
        f"potential={state.potential_name}",
        *(f"{SYMBOLS[s]} {row % tuple(some)}" for s, some in zip(species, values.tolist(), strict=True)),
    ]
    return "\n".join([*lines, ""]).encode()
