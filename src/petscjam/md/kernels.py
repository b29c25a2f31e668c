"""The hot loops of the disk MD, compiled by numba: forces, two integrators, sums, and contact events.

Units are ds, m, τe. With the surface speed w = Rθ̇ as the rotational variable, both disks of a contact feel
the same torque term: with arms R r/σ (VOT eq. 6), ẇ = 2 (r/σ) ft/m on either, whatever its radius.

Axes: i, j disks of pair c; columns of q: x, y, vx, vy, w; columns of F: the forces on these velocities.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from petscjam.base.compiled import njit, prange
from petscjam.base.types import Array
from petscjam.geometry.neighbours import CHUNK

BATCH = 256
BINS = 100
FAST = {"contract", "reassoc", "arcp", "nsz"}  # sums may be reordered, but NaN stays NaN
HEUN, SINGLE = 0, 1
TICKS = 1024  # a step: the finest parts that it can be divided into, a power of 2
SUMS = 14
(EXX, EXY, EYY, DXX, DXY, DYX, DYY, TOUCHING, HEAT, KXX, KXY, KYY, WORK, JUMPS) = range(SUMS)


class Law(NamedTuple):
    """A model as the kernel sees it.

    No exponent means 2: with a power the loop does not vectorise. Where overlaps count relative to σ, it is
    not ``absolute``, but None.
    """

    normal: float
    tangential: float
    rolls: float
    exponent: float | None
    absolute: float | None
    body: float
    spin_drag: float


class Disks(NamedTuple):
    """Disks sorted in space: now, predicted, forces, radii, masses, and places at the last build."""

    q: Array
    p: Array
    F: Array
    R: Array
    m: Array
    home: Array


class Events(NamedTuple):
    """Contact events of each run, and of the rest: made, broken, ticks touched; angles of both."""

    counts: NDArray[np.int64]
    angles: NDArray[np.int64]


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _contact(rx, ry, ux, uy, inverse, normal, tangential, exponent, absolute):
    """Return elastic force over distance, damping force on i, and 1 if they touch.

    r and u are position and velocity of j against i, u at the contact point if the law rolls.
    """
    near = 1.0 / np.sqrt(rx * rx + ry * ry)
    overlap = 1.0 - (rx * rx + ry * ry) * near * inverse
    touch = 1.0 if overlap > 0.0 else 0.0
    overlap *= touch
    spring = overlap if exponent is None else overlap ** (exponent - 1.0)
    along = (normal - tangential) * (ux * rx + uy * ry) * near * near
    gx = touch * (tangential * ux + along * rx)
    gy = touch * (tangential * uy + along * ry)
    if absolute is None:
        spring *= inverse
    else:
        spring /= inverse if exponent is None else inverse ** (exponent - 1.0)
    return spring * near, gx, gy, touch


@njit(cache=True, error_model="numpy")
def separation(c, q, pairs, L, strain, rate):
    """Return rji and vji of pair c, with the image of j that is meant."""
    a, b, image = pairs.i[c], pairs.j[c], c - pairs.runs[-1]
    x, y, vx, vy = q[b, 0] - q[a, 0], q[b, 1] - q[a, 1], q[b, 2] - q[a, 2], q[b, 3] - q[a, 3]
    if image >= 0:
        x += (pairs.nx[image] + pairs.ny[image] * strain) * L
        y += pairs.ny[image] * L
        vx += pairs.ny[image] * rate * L
    return x, y, vx, vy


@njit(cache=True, error_model="numpy")
def _event(c, q, pairs, L, strain, rate, tick, counts, angles):
    """Book that pair c begins or ceases to touch; ϑ turns the velocity vij onto rij (VOT eqs. 26, 27)."""
    x, y, vx, vy = separation(c, q, pairs, L, strain, rate)
    angle = np.arctan2(vx * y - vy * x, vx * x + vy * y)  # the signs of rji and vji cancel
    bin = min(max(int((angle / np.pi + 1.0) * (BINS // 2)), 0), BINS - 1)
    if pairs.touching[c]:
        counts[1] += 1
        counts[2] += tick - pairs.since[c]
        angles[1, bin] += 1
        pairs.touching[c] = 0
    else:
        counts[0] += 1
        angles[0, bin] += 1
        pairs.touching[c] = 1
        pairs.since[c] = tick


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _add_pairs(part, first, last, q, F, pairs, law, L, strain, rate, measure, tick, sums, events):
    """Add a range of pairs, in batches: in scratch arrays, overwritten, the main loop vectorises.

    ``part`` is the row of ``sums`` and ``events`` that they belong to; those of the last one have images.
    """
    X, Y, U, V, W = np.empty(BATCH), np.empty(BATCH), np.empty(BATCH), np.empty(BATCH), np.empty(BATCH)
    normal, tangential, rolls = law.normal, law.tangential, law.rolls
    exponent, absolute = law.exponent, law.absolute
    exx = exy = eyy = dxx = dxy = dyx = dyy = count = heat = 0.0
    images = pairs.runs[-1]
    for start in range(first, last, BATCH):
        n = min(BATCH, last - start)
        i, j = pairs.i[start : start + n], pairs.j[start : start + n]
        inverse, touching = pairs.inverse[start : start + n], pairs.touching[start : start + n]
        for c in range(n):
            a, b = i[c], j[c]
            X[c], Y[c] = q[b, 0] - q[a, 0], q[b, 1] - q[a, 1]
            U[c], V[c] = q[b, 2] - q[a, 2], q[b, 3] - q[a, 3]
            W[c] = q[a, 4] + q[b, 4]
        if start >= images:
            for c in range(n):
                row = pairs.ny[start - images + c]
                X[c] += (pairs.nx[start - images + c] + row * strain) * L
                Y[c] += row * L
                U[c] += row * rate * L
        if measure:
            for c in range(n):
                x, y, turn = X[c], Y[c], rolls * W[c] * inverse[c]
                ux, uy = U[c] + turn * y, V[c] - turn * x
                spring, gx, gy, touch = _contact(x, y, ux, uy, inverse[c], normal, tangential, exponent, absolute)
                X[c], Y[c] = gx - spring * x, gy - spring * y
                U[c], V[c] = 2.0 * rolls * inverse[c] * (x * gy - y * gx), touch
                exx, exy, eyy = exx + spring * x * x, exy + spring * x * y, eyy + spring * y * y
                dxx, dxy, dyx, dyy = dxx - gx * x, dxy - gx * y, dyx - gy * x, dyy - gy * y
                count, heat = count + touch, heat + gx * ux + gy * uy
            changed = 0
            for c in range(n):
                changed |= np.uint8(V[c]) ^ touching[c]
            if changed:
                for c in range(n):
                    if V[c] != touching[c]:
                        _event(start + c, q, pairs, L, strain, rate, tick, events.counts[part], events.angles[part])
        else:
            for c in range(n):
                x, y, turn = X[c], Y[c], rolls * W[c] * inverse[c]
                ux, uy = U[c] + turn * y, V[c] - turn * x
                spring, gx, gy, touch = _contact(x, y, ux, uy, inverse[c], normal, tangential, exponent, absolute)
                X[c], Y[c] = gx - spring * x, gy - spring * y
                U[c] = 2.0 * rolls * inverse[c] * (x * gy - y * gx)
        for c in range(n):
            a, b = i[c], j[c]
            fx, fy, torque = X[c], Y[c], U[c]
            F[a, 0] += fx
            F[a, 1] += fy
            F[a, 2] += torque
            F[b, 0] -= fx
            F[b, 1] -= fy
            F[b, 2] += torque
    sums[part, EXX], sums[part, EXY], sums[part, EYY] = exx, exy, eyy
    sums[part, DXX], sums[part, DXY], sums[part, DYX], sums[part, DYY] = dxx, dxy, dyx, dyy
    sums[part, TOUCHING], sums[part, HEAT], sums[part, WORK] = count, heat, 0.0


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _drag(run, q, F, R, law, rate, sums):
    """Add Stokes drag: −ζ(v − γ̇ y x̂) on a disk, −ζr(θ̇ + γ̇/2) on its rotation."""
    heat = couple = 0.0
    for a in range(run * CHUNK, min((run + 1) * CHUNK, len(q))):
        cx, cy, spin = q[a, 2] - rate * q[a, 1], q[a, 3], q[a, 4] / R[a] + 0.5 * rate
        F[a, 0] -= law.body * cx
        F[a, 1] -= law.body * cy
        F[a, 2] -= 2.0 * law.spin_drag * spin / R[a]
        heat += law.body * (cx * cx + cy * cy) + law.spin_drag * spin * spin
        couple += law.spin_drag * spin
    sums[run, HEAT] += heat
    sums[run, WORK] = 0.5 * rate * couple  # of what keeps the fluid turning


@njit(cache=True, error_model="numpy", fastmath=FAST)
def kinetic(q, m, rate, sums):
    """Sum the products of peculiar velocities (VOT eq. 14) into the last row of ``sums``."""
    for a in range(len(q)):
        x, y = q[a, 2] - rate * q[a, 1], q[a, 3]
        sums[-1, KXX] += m[a] * x * x
        sums[-1, KXY] += m[a] * x * y
        sums[-1, KYY] += m[a] * y * y


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _predict(run, disks, dt, scheme, rate, shear, room, sums):
    """Predict where disks go (VOT eqs. 21, 22, or to second order); return how many leave their room.

    ``shear`` is the strain since the list was built. On the way, sum the products of peculiar velocities (VOT
    eq. 14), now (HEUN) or as predicted (SINGLE).
    """
    q, p, F, m, home = disks.q, disks.p, disks.F, disks.m, disks.home
    half, later = (0.5 * dt, 1.0) if scheme == SINGLE else (0.0, 0.0)
    left = xx = xy = yy = 0.0
    for a in range(run * CHUNK, min((run + 1) * CHUNK, len(q))):
        gain = dt / m[a]
        ux, uy = gain * F[a, 0], gain * F[a, 1]
        x = q[a, 0] + dt * q[a, 2] + half * ux
        y = q[a, 1] + dt * q[a, 3] + half * uy
        p[a, 0] = x
        p[a, 1] = y
        p[a, 2] = q[a, 2] + ux
        p[a, 3] = q[a, 3] + uy
        p[a, 4] = q[a, 4] + gain * F[a, 2]
        cx = q[a, 2] + later * ux - rate * (q[a, 1] + later * (y - q[a, 1]))
        cy = q[a, 3] + later * uy
        xx, xy, yy = xx + m[a] * cx * cx, xy + m[a] * cx * cy, yy + m[a] * cy * cy
        dx, dy = x - shear * y - home[a, 0], y - home[a, 1]
        left += 1.0 if dx * dx + dy * dy > room * room else 0.0
    if scheme == SINGLE:
        F[run * CHUNK : (run + 1) * CHUNK] = 0.0
    sums[run, KXX], sums[run, KXY], sums[run, KYY] = xx, xy, yy
    return left


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _correct(run, disks, dt, scheme):
    """Average both forces. HEUN: F is their sum (VOT eqs. 23, 24). SINGLE: (v + v̂)/2 holds half of one."""
    q, p, F, m = disks.q, disks.p, disks.F, disks.m
    first, last = run * CHUNK, min((run + 1) * CHUNK, len(q))
    if scheme == HEUN:
        for a in range(first, last):
            h = 0.5 * dt / m[a]
            vx, vy = q[a, 2] + h * F[a, 0], q[a, 3] + h * F[a, 1]
            q[a, 0] += 0.5 * dt * (q[a, 2] + vx)
            q[a, 1] += 0.5 * dt * (q[a, 3] + vy)
            q[a, 2], q[a, 3] = vx, vy
            q[a, 4] += h * F[a, 2]
            F[a, 0] = F[a, 1] = F[a, 2] = 0.0
    else:
        for a in range(first, last):
            h = 0.5 * dt / m[a]
            q[a, 0], q[a, 1] = p[a, 0], p[a, 1]
            q[a, 2] = 0.5 * (q[a, 2] + p[a, 2]) + h * F[a, 0]
            q[a, 3] = 0.5 * (q[a, 3] + p[a, 3]) + h * F[a, 1]
            q[a, 4] = 0.5 * (q[a, 4] + p[a, 4]) + h * F[a, 2]


@njit(cache=True, error_model="numpy")
def jump(q, m, L, old, new, bulk):
    """Change the strain rate at once; return the change of the peculiar kinetic and rotational energy.

    ``bulk``: 0 changes nothing but the boundary, 1 scales velocities and spins (VOT eqs. 40, 41), 2 adds the
    change of the linear profile.
    """
    gain = 0.0
    factor = new / old if bulk == 1 else 1.0
    for a in range(len(q)):
        x, y, w = q[a, 2] - old * q[a, 1], q[a, 3], q[a, 4]
        gain -= m[a] * (0.5 * (x * x + y * y) + 0.25 * w * w)
        q[a, 2] *= factor
        q[a, 3] *= factor
        q[a, 4] *= factor
        if bulk == 2:
            q[a, 2] += (new - old) * q[a, 1]
        elif bulk == 0:  # an image outside the square moves with its row
            q[a, 2] += (new - old) * L * np.floor(q[a, 1] / L)
        x, y, w = q[a, 2] - new * q[a, 1], q[a, 3], q[a, 4]
        gain += m[a] * (0.5 * (x * x + y * y) + 0.25 * w * w)
    return gain


@njit(cache=True, error_model="numpy")
def _force_run(run, q, F, disks, pairs, law, rate, measure, tick, sums, events):
    """Add the forces inside a run."""
    first, last = pairs.runs[run], pairs.runs[run + 1]
    _add_pairs(run, first, last, q, F, pairs, law, 0.0, 0.0, 0.0, measure, tick, sums, events)
    if law.body != 0.0 or law.spin_drag != 0.0:
        _drag(run, q, F, disks.R, law, rate, sums)


@njit(cache=True)
def _force_runs(q, F, disks, pairs, law, rate, measure, tick, sums, events):
    for run in range(len(pairs.runs) - 1):
        _force_run(run, q, F, disks, pairs, law, rate, measure, tick, sums, events)


@njit(cache=True, parallel=True)
def _force_runs_threaded(q, F, disks, pairs, law, rate, measure, tick, sums, events):
    for run in prange(len(pairs.runs) - 1):
        _force_run(run, q, F, disks, pairs, law, rate, measure, tick, sums, events)


@njit(cache=True)
def _predict_runs(disks, dt, scheme, rate, shear, room, sums, left):
    for run in range(len(left)):
        left[run] = _predict(run, disks, dt, scheme, rate, shear, room, sums)


@njit(cache=True, parallel=True)
def _predict_runs_threaded(disks, dt, scheme, rate, shear, room, sums, left):
    for run in prange(len(left)):
        left[run] = _predict(run, disks, dt, scheme, rate, shear, room, sums)


@njit(cache=True)
def _correct_runs(disks, dt, scheme, runs):
    for run in range(runs):
        _correct(run, disks, dt, scheme)


@njit(cache=True, parallel=True)
def _correct_runs_threaded(disks, dt, scheme, runs):
    for run in prange(runs):
        _correct(run, disks, dt, scheme)


@njit(cache=True, error_model="numpy")
def forces(q, F, disks, pairs, law, L, strain, rate, threads, measure, tick, sums, events):
    """Add all forces on disks at ``q`` to ``F``.

    With ``measure``, sums over pairs and disks go to ``sums`` (one row a run, the last for the rest), and
    contacts that begin or cease to touch to ``events``.
    """
    if threads is not None:
        _force_runs_threaded(q, F, disks, pairs, law, rate, measure, tick, sums, events)
    else:
        _force_runs(q, F, disks, pairs, law, rate, measure, tick, sums, events)
    last, first, end = len(pairs.runs) - 1, pairs.runs[-1], len(pairs.i)
    _add_pairs(last, first, end, q, F, pairs, law, L, strain, rate, measure, tick, sums, events)


@njit(cache=True, error_model="numpy")
def book(sums, rate, weight, total):
    """Add ``weight`` times the sums of all runs, and the power of the shear stress, to ``total``."""
    shear = 0.0
    for name in range(WORK):
        value = sums[:, name].sum()
        total[name] += weight * value
        if name in (EXY, DXY, KXY):
            shear += value
    total[WORK] += weight * (sums[:, WORK].sum() - rate * shear)


@njit(cache=True, error_model="numpy")
def advance(
    disks, pairs, law, L, dt, parts, scheme, strains, rates, bulk, built, skin, threads, tick, sums, events, total
):
    """Make parts of steps as long as the list of pairs holds.

    Parameters
    ----------
    parts : int
        Parts of each step.
    strains : (K + 1,)
        At the beginnings of parts, and at the end of the last.
    rates : (K + 1,)
        Before the first part, and in each. ``bulk`` says what a change does (:func:`jump`).
    built, skin : float
        Strain at which the list was built, and its skin.
    tick : int
        Moment of the beginning, in :data:`TICKS` a step.
    total : (SUMS,)
        Gets the sums at the beginning (HEUN) or end (SINGLE) of each part, divided by ``parts``.

    Returns
    -------
    int
        Parts made: less than K if a new list is needed first.
    """
    q, p, F = disks.q, disks.p, disks.F
    runs = len(pairs.runs) - 1
    left = np.zeros(runs, np.int64)
    reach = 2.0 * disks.R.max()
    F[:] = 0.0
    fresh = True
    dt /= parts
    weight, ticks = 1.0 / parts, TICKS // parts
    for k in range(len(rates) - 1):
        rate, now = rates[k + 1], tick + k * ticks
        change = rate - rates[k]
        if change != 0.0:
            total[JUMPS] += jump(q, disks.m, L, rates[k], rate, bulk)
            rates[k] = rate
            F[:] = 0.0
            fresh = True
        if scheme == HEUN or fresh:
            look = scheme == HEUN or change != 0.0
            forces(q, F, disks, pairs, law, L, strains[k], rate, threads, look, now, sums, events)
            fresh = False
        if change != 0.0:  # the stress belongs to the part before and to this one, in equal shares
            kinetic(q, disks.m, rate, sums)
            shear = sums[:, EXY].sum() + sums[:, DXY].sum() + sums[-1, KXY]
            total[WORK] += (0.5 if scheme == HEUN else -0.5) * weight * change * shear
            sums[-1, KXX:WORK] = 0.0
        shear = strains[k + 1] - built
        room = 0.5 * (skin - reach * (np.sqrt(1.0 + 0.25 * shear**2) + 0.5 * abs(shear) - 1.0))
        if threads is not None:
            _predict_runs_threaded(disks, dt, scheme, rate, shear, max(room, 0.0), sums, left)
        else:
            _predict_runs(disks, dt, scheme, rate, shear, max(room, 0.0), sums, left)
        if room <= 0.0 or left.sum() > 0:
            return k
        if scheme == HEUN:
            book(sums, rate, weight, total)
        last = scheme == SINGLE
        forces(p, F, disks, pairs, law, L, strains[k + 1], rate, threads, last, now, sums, events)
        if last:
            book(sums, rate, weight, total)
        if threads is not None:
            _correct_runs_threaded(disks, dt, scheme, runs)
        else:
            _correct_runs(disks, dt, scheme, runs)
    return len(rates) - 1


@njit(cache=True, error_model="numpy")
def fastest(q, R, m, pairs, law, exponent, L, strain):
    """Bound the largest eigenvalues of M⁻¹B and of M⁻¹K, from the contacts at this moment.

    Of a relative velocity, |vi − vj|² ≤ (1 + zj/zi)|vi|² + (1 + zi/zj)|vj|² with the numbers of contacts z,
    so the forms of all disks come apart (docs/theory.md, Largest time steps). Pre-stress only lowers K.

    Returns
    -------
    relaxation, oscillation : float
        In 1/τe, and squared in 1/τe².
    """
    n, inverse, images = len(q), pairs.inverse, pairs.runs[-1]
    z, X, Y = np.zeros(n), np.empty(len(inverse)), np.empty(len(inverse))
    # of each disk Σ w, Σ w cos 2φ, Σ w sin 2φ, the same with the stiffness, Σ w ρ t, Σ w ρ²
    s = np.zeros((n, 9))
    for c in range(len(inverse)):
        a, b = pairs.i[c], pairs.j[c]
        X[c], Y[c] = (q[b, 0] - q[a, 0]) * inverse[c], (q[b, 1] - q[a, 1]) * inverse[c]
        if c >= images:
            X[c] += (pairs.nx[c - images] + pairs.ny[c - images] * strain) * L * inverse[c]
            Y[c] += pairs.ny[c - images] * L * inverse[c]
        if X[c] * X[c] + Y[c] * Y[c] < 1.0:
            z[a] += 1.0
            z[b] += 1.0
    for c in range(len(inverse)):
        x, y = X[c], Y[c]
        square = x * x + y * y
        if square < 1.0:
            a, b, sign = pairs.i[c], pairs.j[c], 1.0
            cos, sin = (x * x - y * y) / square, 2.0 * x * y / square
            k = inverse[c] * inverse[c] if law.absolute is None else 1.0
            if exponent != 2.0:
                k *= (exponent - 1.0) * (1.0 - np.sqrt(square)) ** (exponent - 2.0)
                if law.absolute is not None:
                    k *= inverse[c] ** (2.0 - exponent)
            for _ in range(2):
                w = 1.0 + z[b] / z[a]
                s[a, 0] += w
                s[a, 1] += w * cos
                s[a, 2] += w * sin
                s[a, 3] += w * k
                s[a, 4] += w * k * cos
                s[a, 5] += w * k * sin
                s[a, 6] += sign * w * x
                s[a, 7] += sign * w * y
                s[a, 8] += w * square
                a, b, sign = b, a, -1.0
    relaxation = oscillation = 0.0
    for a in range(n):
        along = 0.5 * (law.normal + law.tangential) * s[a, 0] + law.body
        along += 0.5 * abs(law.normal - law.tangential) * np.sqrt(s[a, 1] ** 2 + s[a, 2] ** 2)
        turning = 2.0 * law.rolls * law.tangential * s[a, 8] + 2.0 * law.spin_drag / R[a] ** 2
        both = 8.0 * (law.rolls * law.tangential) ** 2 * (s[a, 6] ** 2 + s[a, 7] ** 2)
        rate = 0.5 * (along + turning + np.sqrt((along - turning) ** 2 + both)) / m[a]
        relaxation = max(relaxation, rate)
        oscillation = max(oscillation, 0.5 * (s[a, 3] + np.sqrt(s[a, 4] ** 2 + s[a, 5] ** 2)) / m[a])
    return relaxation, oscillation


@njit(cache=True, error_model="numpy")
def elastic_energy(q, pairs, law, exponent, L, strain):
    """Energy Σ k δ^α/α of the contacts (VOT eq. 1)."""
    energy = 0.0
    for c in range(len(pairs.i)):
        x, y, _, _ = separation(c, q, pairs, L, strain, 0.0)
        overlap = 1.0 - np.sqrt(x * x + y * y) * pairs.inverse[c]
        if overlap > 0.0:
            scale = 1.0 if law.absolute is None else pairs.inverse[c] ** -exponent
            energy += scale * overlap**exponent / exponent
    return energy


@njit(cache=True, error_model="numpy")
def observe(q, R, pairs, L, strain, rate, pick, layers, moments, scatter):
    """Look at every disk and contact once.

    Parameters
    ----------
    pick : int
        The contact whose velocities go to ``scatter`` (4,), modulo their number.
    layers : (3, M)
        Gets disks, their vx and their area by layer in y.
    moments : (5, 4)
        Gets the sums of V_T, V^R, V^C_T, V_N over contacts, then those of their products.

    Returns
    -------
    sums : (7,)
        Over disks: θ̇, θ̇², δvx², vy² (VOT eqs. 29, 35, 36); over contacts: vN², vT², and their number.
    """
    sums, v = np.zeros(7), np.zeros(4)
    for a in range(len(q)):
        spin, row = q[a, 4] / R[a], np.floor(q[a, 1] / L)
        y, vx = q[a, 1] - row * L, q[a, 2] - row * rate * L
        sums[0] += spin
        sums[1] += spin * spin
        sums[2] += (vx - rate * y) ** 2
        sums[3] += q[a, 3] ** 2
        layer = min(int(y / L * layers.shape[1]), layers.shape[1] - 1)
        layers[0, layer] += 1.0
        layers[1, layer] += vx
        layers[2, layer] += np.pi * R[a] ** 2
    touching = 0
    for c in range(len(pairs.i)):
        touching += pairs.touching[c]
    chosen = pick % max(touching, 1)
    for c in range(len(pairs.i)):
        if pairs.touching[c]:
            x, y, vx, vy = separation(c, q, pairs, L, strain, rate)
            r = np.sqrt(x * x + y * y)
            v[0] = (vx * y - vy * x) / r
            v[1] = (q[pairs.i[c], 4] + q[pairs.j[c], 4]) * r * pairs.inverse[c]
            v[2] = v[0] + v[1]
            v[3] = -(vx * x + vy * y) / r
            sums[4] += v[3] ** 2
            sums[5] += v[0] ** 2
            if rate != 0.0:
                v /= rate
                moments[0] += v
                for k in range(4):
                    moments[k + 1] += v[k] * v
                if sums[6] == chosen:
                    scatter[:] = v
            sums[6] += 1.0
    return sums
