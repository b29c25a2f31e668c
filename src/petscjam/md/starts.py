"""The initial state of a run: random, from a packing, or from another run.

Axes: i disk, x Cartesian.
"""

from __future__ import annotations

from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from petscjam.base.errors import InputError, readable, shown
from petscjam.base.types import Array
from petscjam.geometry.box import Box
from petscjam.geometry.packing import Packing
from petscjam.md.model import Model
from petscjam.md.protocols import Protocol
from petscjam.md.result import Run, is_run, read
from petscjam.md.simulation import Simulation
from petscjam.md.state import State, random_state
from petscjam.rows.damping import ContactDamping

Start = State | Run | Packing | str | PathLike[str] | None
SETTLE = 200.0  # τe for disks at random positions to move apart


def first_state(
    state: State | None, origin: str, n: int | None, phi: float | None, seed: int, model: Model, protocol: Protocol
) -> State:
    """Return the initial state, with the linear profile of the first strain rate, from a given state or random.

    Disks at random positions first move apart. Velocities and spins of a run are scaled to the new rate (VOT eqs.
    40, 41), if ``bulk`` is ``scale``; a given state does not change if ``bulk`` is ``boundary``.

    Parameters
    ----------
    state : State or None
        None: disks at random positions.
    origin : str
        Its description, for messages.
    n, phi : int and float, optional
        Requested number of disks and packing fraction.
    seed : int
    model : Model
    protocol : Protocol

    Raises
    ------
    InputError
        If the start has another number of disks or packing fraction than ``n`` and ``phi``.
    """
    rate = float(protocol.rates(np.array([0.0]))[0])
    if state is None:
        state = random_state(1024 if n is None else n, 0.82 if phi is None else phi, seed)
        state = _settled(state, model)
    else:
        if n is not None and n != len(state):
            raise InputError(f"shear: {origin} has {len(state)} disks, not {n}")
        if phi is not None and abs(phi - state.phi) > 1e-6:
            raise InputError(f"shear: {origin} has packing fraction {state.phi:.8g}, not {shown(phi)}")
    if protocol.bulk == "boundary" and origin != "random":
        return replace(state.wrapped(), rate=rate)
    v, spins = state.velocities.copy(), state.spins
    if state.rate != 0 and protocol.bulk == "scale":
        v, spins = v * (rate / state.rate), spins * (rate / state.rate)
    else:
        v[:, 0] += (rate - state.rate) * state.positions[:, 1]
        spins = spins - (rate - state.rate) / 2 * model.rolls
    return replace(state, velocities=v, spins=spins, rate=rate)


def _settled(state: State, model: Model) -> State:
    """Return disks that have moved apart, as far as possible, under strong damping at rest."""
    law = Model(ContactDamping(), 1.0, model.potential)
    simulation = Simulation(state, law)
    steps = int(SETTLE / simulation.dt)
    simulation.advance(np.zeros(steps), np.zeros(steps))
    rest = np.zeros_like(state.velocities)
    return replace(simulation.state, velocities=rest, spins=np.zeros(len(state)), time=0.0)


def given_state(start: Start) -> tuple[State | None, str]:
    """Return the state to start from, None for a random one, and its description.

    Raises
    ------
    InputError
        If the start cannot be read, or is a packing whose lattice is not that of a sheared square.
    """
    if start is None:
        return None, "random"
    if isinstance(start, State):
        return start, "a state"
    if isinstance(start, Run):
        return start.state, _of(start)
    if isinstance(start, Packing):
        return _at_rest(start)
    if is_run(start):
        earlier = read(start)
        return earlier.state, f"{readable(Path(start).name)}: {_of(earlier)}"
    state, origin = _at_rest(Packing.read(start))
    return state, f"{readable(Path(start).name)}: {origin}"


def _of(run: Run) -> str:
    name, start, state = run.settings.model.name, run.settings.start, run.state
    return f"{name} from {start} at γ̇ = {state.rate:.4g}, γ = {state.strain:.6g}"


def _at_rest(packing: Packing) -> tuple[State, str]:
    """Return the disks of a packing at rest, in units of the smallest diameter, and the description of the start.

    Its lattice must be that of a square sheared along one of its lattice vectors. The packing is rotated until
    this vector is along x.
    """
    unit, n = 2 * packing.radii.min(), len(packing)
    edge, tilt, angle = _sheared_square(packing.box.cell)
    c, s = np.cos(angle), np.sin(angle)
    x = packing.positions @ np.array([[c, -s], [s, c]]) if angle else packing.positions
    state = State(
        x / unit,
        np.zeros((n, 2)),
        np.zeros(n),
        packing.radii / unit,
        edge / unit,
        tilt,
        potential_name=packing.potential_name,
    ).wrapped()
    turned = f", turned by {np.degrees(-angle):.6g} degrees" if angle else ""
    return state, f"packing {packing.checksum}{turned}"


def _sheared_square(cell: Array) -> tuple[float, float, float]:
    """Return the edge and the tilt of the sheared square with the lattice of ``cell``, and its direction.

    Only a shortest vector of a lattice can be the edge of a square of the same area that is sheared along it. Of
    two, the one with the smaller rotation is used.
    """
    (a, zero), (along, b) = cell
    if a > 0 and abs(zero) <= 1e-12 * a and abs(a - b) <= 1e-9 * a:
        return float(a), float(along / a), 0.0
    reduced, area = Box(cell).reduced, Box(cell).area
    edges = [v for v in (*reduced, *-reduced) if abs(v @ v / area - 1) <= 2e-9]
    if not edges:
        raise InputError(f"shear: the cell {cell.tolist()} of the packing is not a square one, sheared")
    edge = min(edges, key=lambda v: abs(np.arctan2(v[1], v[0])))
    for other in (*reduced, *-reduced):
        if edge[0] * other[1] - edge[1] * other[0] > area / 2:
            tilt = edge @ other / area
    return float(np.sqrt(area)), float(tilt - np.rint(tilt)), float(np.arctan2(edge[1], edge[0]))
