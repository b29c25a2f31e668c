"""The slow twin of the molecular dynamics: forces, stress, energy and one time step with plain loops.

Written independently of the fast code, for tests and to be read together with VOT. Each evaluation tests every
pair of disks and every image. Units: ds, m, τe. Functions take a ``State`` and a ``Model``; ``masses`` are one
number, or one for each disk.
"""

from __future__ import annotations

from dataclasses import replace
from math import floor, hypot
from typing import NamedTuple

import numpy as np

from petscjam.base.types import Array


class Contact(NamedTuple):
    """Disk i, the image of disk j in contact with it, and their forces.

    ``r`` and ``v`` are r_ij = r_i − r_j and v_ij; ``elastic`` and ``dissipative`` the forces on i from j.
    """

    i: int
    j: int
    r: Array
    v: Array
    elastic: Array
    dissipative: Array
    torque_i: float
    torque_j: float
    heat: float


def turned(vector):
    """Return ẑ × vector."""
    return np.array([-vector[1], vector[0]])


def cross(a, b):
    """Return ẑ·(a × b).

    Parameters
    ----------
    a, b : (2,)
    """
    return a[0] * b[1] - a[1] * b[0]


def peculiar(state):
    """Return v − γ̇ y x̂, (N, 2): the same for every image."""
    fluctuations = state.velocities.copy()
    for v, (_, y) in zip(fluctuations, state.positions, strict=True):
        v[0] -= state.rate * y
    return fluctuations


def inside(state):
    """Return positions and velocities of the images in 0 ≤ x < Lx, 0 ≤ y < Ly, as lists of (x, y) and of (vx, vy)."""
    L, H, positions, velocities = state.length, state.height, [], []
    for (x, y), (vx, vy) in zip(state.positions.tolist(), state.velocities.tolist(), strict=True):
        n = floor(y / H)
        x -= n * state.strain * H
        positions.append((x - floor(x / L) * L, y - n * H))
        velocities.append((vx - n * state.rate * H, vy))
    return positions, velocities


def touching(state):
    """Yield i, j, r_ij and v_ij of every contact; the cell is more than twice as wide as its disks."""
    L, H = state.length, state.height
    tilt = state.strain * (H / L)
    offset = (tilt - round(tilt)) * L  # whole cells of it are images in x
    x, v = inside(state)
    radii = state.radii.tolist()
    for i in range(len(x)):
        for j in range(i):
            for m in (-1, 0, 1):
                for n in (-1, 0, 1):
                    rx = x[i][0] - x[j][0] - m * L - n * offset
                    ry = x[i][1] - x[j][1] - n * H
                    if hypot(rx, ry) <= radii[i] + radii[j]:
                        vx = v[i][0] - v[j][0] - n * state.rate * H
                        yield i, j, np.array([rx, ry]), np.array([vx, v[i][1] - v[j][1]])


def contacts(state, model):
    """Yield every contact with its forces (VOT eqs. 2–7), the damping split in normal and tangential.

    Parameters
    ----------
    state : State
    model : Model
    """
    for i, j, r, v in touching(state):
        Ri, Rj, wi, wj = state.radii[i], state.radii[j], state.spins[i], state.spins[j]
        d, distance = Ri + Rj, hypot(*r)
        normal = r / distance
        tangent = turned(normal)
        x, unit = overlap(d, distance, model)
        elastic = model.potential.dU(x) / unit * normal
        s_ji, s_ij = -r * Ri / d, r * Rj / d  # from the centres of i and of j to the contact point
        if not model.rolls:
            s_ji, s_ij = 0 * r, 0 * r
        slip = v + wi * turned(s_ji) - wj * turned(s_ij)
        dissipative = -model.normal * (slip @ normal) * normal - model.tangential * (slip @ tangent) * tangent
        if model.drag_exponent != 1:
            speed = hypot(*slip, model.drag_cutoff)
            dissipative = dissipative * (speed / model.drag_speed) ** (model.drag_exponent - 1)
        torques = cross(s_ji, dissipative), cross(s_ij, -dissipative)
        yield Contact(i, j, r, v, elastic, dissipative, *torques, -dissipative @ slip)


def overlap(d, distance, model):
    """Return the overlap x of U(x), and its unit of length: 1 − r/d and d (VOT eq. 1), or d − r and 1.

    Parameters
    ----------
    d, distance : float
        Ri + Rj and r, ds.
    model : Model
    """
    return (1 - distance / d, d) if model.potential.relative else (d - distance, 1.0)


def disk_forces(state, model):
    """Return the force (N, 2) and the torque (N,) on every disk: contacts, and the drag of the fluid.

    Parameters
    ----------
    state : State
    model : Model
    """
    forces = -model.body * peculiar(state)
    torques = -model.rotational_drag * (state.spins + state.rate / 2)
    for c in contacts(state, model):
        forces[c.i] += c.elastic + c.dissipative
        forces[c.j] -= c.elastic + c.dissipative
        torques[c.i] += c.torque_i
        torques[c.j] += c.torque_j
    return forces, torques


def pressure_tensor(state, model, masses=1.0):
    """Return the elastic, dissipative and kinetic pressure, (2, 2) each (VOT eqs. 12–14).

    First index force or velocity, second index separation or velocity.

    Parameters
    ----------
    state : State
    model : Model
    masses : (N,) or float
    """
    elastic, dissipative, kinetic = np.zeros((3, 2, 2))
    for c in contacts(state, model):
        elastic += np.outer(c.elastic, c.r)
        dissipative += np.outer(c.dissipative, c.r)
    dissipative -= model.fluid * state.rate * state.area * np.array([[0, 1], [1, 0]])
    for m, v in zip(np.broadcast_to(masses, len(state)), peculiar(state), strict=True):
        kinetic += m * np.outer(v, v)
    return elastic / state.area, dissipative / state.area, kinetic / state.area


def dissipation(state, model):
    """Return the dissipated power: of contacts, of drag, and of the fluid between the disks.

    With it dE/dt = −γ̇ Lx Ly p_xy + (γ̇/2) Σ ζr (θ̇ + γ̇/2) − dissipation: the second term is the work of the couple
    that maintains the vorticity of the fluid.

    Parameters
    ----------
    state : State
    model : Model
    """
    heat = sum(c.heat for c in contacts(state, model)) + model.fluid * state.rate**2 * state.area
    for v, spin in zip(peculiar(state), state.spins, strict=True):
        heat += model.body * v @ v + model.rotational_drag * (spin + state.rate / 2) ** 2
    return heat


def inertia(state, masses=1.0):
    """Return I = mR²/2 of every disk, (N,).

    Parameters
    ----------
    state : State
    masses : (N,) or float
    """
    return masses * state.radii**2 / 2


def energy(state, model, masses=1.0):
    """Return the sum of elastic (VOT eq. 1), peculiar kinetic and rotational energy.

    Parameters
    ----------
    state : State
    model : Model
    masses : (N,) or float
    """
    total = 0.0
    for i, j, r, _ in touching(state):
        x, _ = overlap(state.radii[i] + state.radii[j], hypot(*r), model)
        total += model.potential.U(x)
    kinetic = masses * np.sum(peculiar(state) ** 2, axis=1) / 2
    return total + np.sum(kinetic + inertia(state, masses) * state.spins**2 / 2)


def accelerations(state, model, masses=1.0):
    """Return the acceleration (N, 2) and the angular acceleration (N,) of every disk (VOT eqs. 4 and 7).

    Parameters
    ----------
    state : State
    model : Model
    masses : (N,) or float
    """
    forces, torques = disk_forces(state, model)
    return forces / np.broadcast_to(masses, len(state))[:, None], torques / inertia(state, masses)


def moved(state, dt, positions, velocities, spins):
    """Return the state after ``dt``, the strain advanced.

    Parameters
    ----------
    state : State
    dt : float
        τe.
    positions, velocities : (N, 2)
    spins : (N,)
    """
    return replace(
        state,
        positions=positions,
        velocities=velocities,
        spins=spins,
        strain=state.strain + state.rate * dt,
        time=state.time + dt,
    )


def heun_step(state, model, dt, masses=1.0):
    """Return the state after one step of VOT eqs. 21–24, two evaluations of the forces.

    Parameters
    ----------
    state : State
    model : Model
    dt : float
        τe.
    masses : (N,) or float
    """
    x, v, w = state.positions, state.velocities, state.spins
    f, a = accelerations(state, model, masses)
    predicted = moved(state, dt, x + v * dt, v + f * dt, w + a * dt)
    f1, a1 = accelerations(predicted, model, masses)
    v1 = v + (f + f1) * dt / 2
    return moved(state, dt, x + (v + v1) * dt / 2, v1, w + (a + a1) * dt / 2)


def single_step(state, model, dt, before, masses=1.0):
    """Return the state after one step and its ``accelerations``; ``before`` are those of the last step.

    One evaluation in each step: v̂ = v + f dt, x + v dt + f dt²/2, f′ of these, v + (f + f′) dt/2.

    Parameters
    ----------
    state : State
    model : Model
    dt : float
        τe.
    before : ((N, 2), (N,))
    masses : (N,) or float
    """
    x, v, w = state.positions, state.velocities, state.spins
    f, a = before
    predicted = moved(state, dt, x + v * dt + f * dt**2 / 2, v + f * dt, w + a * dt)
    f1, a1 = accelerations(predicted, model, masses)
    return replace(predicted, velocities=v + (f + f1) * dt / 2, spins=w + (a + a1) * dt / 2), (f1, a1)
