"""The initial state of a run: random, from a packing, or from another run.

Axes: i disk, x Cartesian.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from petscjam.base import ranges
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
Phases = Sequence[tuple[float, float]]  # (φ, γ̇) of two bands
SETTLE = 200.0  # τe for disks at random positions to move apart
RESCALED = 0.2  # largest relative change of the rates of two bands


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
            raise InputError(
                f"shear: {origin} has packing fraction {state.phi:.8g}, not {shown(phi)}; rescale changes its cell"
            )
    if protocol.bulk == "boundary" and origin != "random":
        return replace(state.wrapped(), rate=rate)
    v, spins = state.velocities.copy(), state.spins
    if state.rate != 0 and protocol.bulk == "scale":
        v, spins = v * (rate / state.rate), spins * (rate / state.rate)
    else:
        v[:, 0] += (rate - state.rate) * state.positions[:, 1]
        spins = spins - (rate - state.rate) / 2 * model.rolls
    return replace(state, velocities=v, spins=spins, rate=rate)


def two_phases(state: State, bands: Phases) -> State:
    """Return ``state`` with two shear bands: the Bagnoldian one at 0 ≤ y < f Ly, the Newtonian one above it.

    The share f of the height is that of φ = f φ_B + (1 − f) φ_N. Positions are stretched in y to φ_B, and compressed
    to φ_N. Both rates are multiplied by one number, at most 20 % from 1, that gives γ̇ = f γ̇_B + (1 − f) γ̇_N. The
    mean velocity is linear in each band, without momentum relative to γ̇y; peculiar velocities and spins are
    multiplied by the rate of the band divided by γ̇ (VOT eqs. 40, 41).

    Parameters
    ----------
    state : State
        With the linear profile of its rate.
    bands : ((float, float), (float, float))
        (φ_B, γ̇_B) and (φ_N, γ̇_N), rates in 1/τe.

    Raises
    ------
    InputError
        If the bands are not two, φ is not between φ_B and φ_N or γ̇ not between γ̇_N and γ̇_B, or γ̇ is not the mean.
    """
    if len(bands) != 2:
        raise InputError(f"shear: a start with bands has two of them, (phi, rate) each, not {len(bands)}")
    (low, fast), (high, slow) = bands
    for phi, rate in bands:
        ranges.PHI.check("shear: the packing fraction phi of a band", phi)
        ranges.RATE.check("shear: the strain rate of a band", rate)
    if not low < state.phi < high:
        raise InputError(f"shear: phi = {state.phi:.6g} is not between those of the bands, {low:g} and {high:g}")
    if state.rate == 0 or not 0 <= slow / state.rate < 1 < fast / state.rate:
        raise InputError(f"shear: the rate {state.rate:g} is not between those of the bands, {fast:g} and {slow:g}")
    share = (high - state.phi) / (high - low)
    mean = share * fast + (1 - share) * slow
    scale = state.rate / mean
    if abs(scale - 1) > RESCALED:
        raise InputError(
            f"shear: bands of {share:.4g} and {1 - share:.4g} of the height (from phi) have a mean rate of {mean:.4g}, "
            f"not {state.rate:g} within {RESCALED:.0%}"
        )
    state, L = state.wrapped(), state.height
    edge, was = share * L, share * low / state.phi * L
    rates = scale * np.array([fast, slow])
    x, y = state.positions.T
    y = np.interp(y, [0, was, L], [0, edge, L])
    ratio = rates[(y >= edge).astype(int)] / state.rate
    v = ratio[:, None] * state.peculiar
    profile = np.interp(y, [0, edge, L], [0, rates[0] * edge, state.rate * L])
    v[:, 0] += profile - (profile - state.rate * y).mean()  # no momentum relative to γ̇ y
    return replace(state, positions=np.column_stack([x, y]), velocities=v, spins=ratio * state.spins)


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
        If the start cannot be read, or its potential has a unit of length that is not its smallest diameter.
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


def rescaled(state: State, phi: float) -> State:
    """Return the state at another packing fraction: positions and cell scaled, radii and peculiar velocities kept.

    Parameters
    ----------
    state : State
    phi : float

    Raises
    ------
    InputError
        If ``phi`` is out of range.
    """
    ranges.PHI.check("shear: the packing fraction phi", phi)
    factor, v = np.sqrt(state.phi / phi), state.velocities.copy()
    v[:, 0] += state.rate * (factor - 1) * state.positions[:, 1]
    cell = {"length": factor * state.length, "height": factor * state.height}
    return replace(state, positions=factor * state.positions, velocities=v, **cell)


def _of(run: Run) -> str:
    name, start, state = run.settings.model.name, run.settings.start, run.state
    return f"{name} from {start} at γ̇ = {state.rate:.4g}, γ = {state.strain:.6g}"


def along_x(packing: Packing) -> tuple[Packing, float]:
    """Return a packing turned until an edge of its cell is along x, as it is sheared, and the angle.

    Parameters
    ----------
    packing : Packing

    Returns
    -------
    packing : Packing
        The same object if nothing is turned.
    angle : float
        Clockwise, in radians.
    """
    length, height, strain, angle = _along_x(packing.box.cell)
    if not angle:
        return packing, 0.0
    c, s = np.cos(angle), np.sin(angle)
    cell = Box(np.array([[length, 0.0], [strain * height, height]]))
    return replace(packing, positions=packing.positions @ np.array([[c, -s], [s, c]]), box=cell), angle


def _at_rest(packing: Packing) -> tuple[State, str]:
    """Return the disks of a packing at rest, in units of the smallest diameter, and the description of the start."""
    unit, n, law = 2 * packing.radii.min(), len(packing), packing.potential
    if not law.relative and law.exponent is None and abs(unit - 1) > 1e-9:
        raise InputError(
            f"shear: {law.name} depends on the unit of length: the smallest diameter must be 1, not {unit:g}"
        )
    length, height, strain, angle = _along_x(packing.box.cell)
    c, s = np.cos(angle), np.sin(angle)
    x = packing.positions @ np.array([[c, -s], [s, c]]) if angle else packing.positions
    state = State(
        x / unit,
        np.zeros((n, 2)),
        np.zeros(n),
        packing.radii / unit,
        length / unit,
        strain,
        potential_name=packing.potential_name,
        height=height / unit,
    ).wrapped()
    turned = f", turned by {np.degrees(-angle):.6g} degrees" if angle else ""
    return state, f"packing {packing.checksum}{turned}"


def _along_x(cell: Array) -> tuple[float, float, float, float]:
    """Return Lx, Ly and γ of the cell with the lattice of ``cell`` and an edge along x, and the angle of this edge.

    The edge is the first lattice vector if it is along x. Else it is one of the two shortest vectors of the lattice,
    ± each, with the smallest rotation; of a sheared square, one that is an edge of the square.
    """
    (a, zero), (along, b) = cell
    if a > 0 and abs(zero) <= 1e-12 * a:
        height = a if abs(a - abs(b)) <= 1e-9 * a else abs(b)
        return float(a), float(height), float(np.sign(b) * along / height), 0.0
    reduced, area = Box(cell).reduced, Box(cell).area
    shortest = [*reduced, *-reduced]
    square = [v for v in shortest if abs(v @ v / area - 1) <= 2e-9]
    edge = min(square or shortest, key=lambda v: abs(np.arctan2(v[1], v[0])))
    length = np.sqrt(area if square else edge @ edge)
    width = length**2 / area  # Lx/Ly, the strain of a whole turn
    other = next(v for v in shortest if edge[0] * v[1] - edge[1] * v[0] > area / 2)
    strain = edge @ other / area
    strain -= width * np.rint(strain / width)
    return float(length), float(area / length), float(strain), float(np.arctan2(edge[1], edge[0]))
