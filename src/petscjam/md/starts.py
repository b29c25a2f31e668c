"""Where a run starts: at random, from a packing, or from another run.

Axes: i disk, x Cartesian.
"""

from __future__ import annotations

from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from petscjam.damping import ContactDamping
from petscjam.errors import InputError, shown
from petscjam.md.model import Model
from petscjam.md.protocols import Protocol
from petscjam.md.result import Run, is_run, read
from petscjam.md.simulation import Simulation
from petscjam.md.state import State, random_state
from petscjam.packing.packing import Packing

Start = State | Run | Packing | str | PathLike[str] | None
SETTLE = 200.0  # τe that disks at random positions are given to part


def first_state(
    start: Start, n: int | None, phi: float | None, seed: int, model: Model, protocol: Protocol
) -> tuple[State, str]:
    """Return the first state, on the linear profile of the first strain rate, and where it comes from.

    Without ``start``, disks at random positions part first. Of a run, velocities and spins are scaled to the
    new rate (VOT eqs. 40, 41), if changes of the rate scale them.

    Raises
    ------
    InputError
        If the start is damaged, or has another number of disks or packing fraction than asked for.
    """
    rate = float(protocol.rates(np.array([0.0]))[0])
    if start is None:
        at_random = random_state(1024 if n is None else n, 0.82 if phi is None else phi, seed)
        state, origin = _settled(at_random, model), "random"
    else:
        state, origin = _given(start)
        if n is not None and n != len(state):
            raise InputError(f"shear: {origin} has {len(state)} disks, not {n}")
        if phi is not None and abs(phi - state.phi) > 1e-6:
            raise InputError(f"shear: {origin} has packing fraction {state.phi:.8g}, not {shown(phi)}")
    v, spins = state.velocities.copy(), state.spins
    if state.rate != 0 and protocol.bulk == "scale":
        v, spins = v * (rate / state.rate), spins * (rate / state.rate)
    else:
        v[:, 0] += (rate - state.rate) * state.positions[:, 1]
        spins = spins - (rate - state.rate) / 2 * model.rolls
    return replace(state, velocities=v, spins=spins, rate=rate), origin


def _settled(state: State, model: Model) -> State:
    """Return disks that have parted, as far as they can, under strong damping at rest."""
    law = Model(ContactDamping(), 1.0, exponent=model.exponent)
    simulation = Simulation(state, law)
    steps = int(SETTLE / simulation.dt)
    simulation.advance(np.zeros(steps), np.zeros(steps))
    rest = np.zeros_like(state.velocities)
    return replace(simulation.state, velocities=rest, spins=np.zeros(len(state)), time=0.0)


def _given(start: State | Run | Packing | str | PathLike[str]) -> tuple[State, str]:
    if isinstance(start, State):
        return start, "a state"
    if isinstance(start, Run):
        return start.state, _of(start)
    if isinstance(start, Packing):
        return _at_rest(start), f"packing {start.checksum}"
    if is_run(start):
        earlier = read(start)
        return earlier.state, f"{Path(start).name}: {_of(earlier)}"
    packing = Packing.read(start)
    return _at_rest(packing), f"{Path(start).name}: packing {packing.checksum}"


def _of(run: Run) -> str:
    name, start, state = run.settings["model"], run.settings["start"], run.state
    return f"{name} from {start} at γ̇ = {state.rate:.4g}, γ = {state.strain:.6g}"


def _at_rest(packing: Packing) -> State:
    """Return the disks of a packing at rest, in units of the smallest diameter."""
    (a, zero), (tilt, b) = packing.box.cell / (2 * packing.radii.min())
    if abs(zero) > 1e-12 * a or abs(a - b) > 1e-9 * a:
        cell = packing.box.cell.tolist()
        raise InputError(f"shear: the cell {cell} of the packing is not a square one, sheared along x")
    n = len(packing)
    x, radii = (values / (2 * packing.radii.min()) for values in (packing.positions, packing.radii))
    return State(x, np.zeros((n, 2)), np.zeros(n), radii, a, tilt / a).wrapped()
