"""The loops of the disk MD, compiled by numba: forces, two integrators, sums, and contact events.

Units are ds, m, τe. With the surface speed w = Rθ̇ as the rotational variable, both disks of a contact have the
same torque term: with lever arms R r/σ (VOT eq. 6), ẇ = 2 (r/σ) ft/m for both, independent of their radii.

Axes: i, j disks of pair c; columns of q: x, y, vx, vy, w; columns of F: the forces on these velocities.
Sums are taken chunk by chunk, one row each; the last row is that of pairs of two chunks or with an image.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from petscjam.base.compiled import BATCH, FAST, njit, prange
from petscjam.base.types import Array
from petscjam.geometry.neighbours import CHUNK
from petscjam.md import contact
from petscjam.md.engine import (
    CONTACTS,
    DVX2,
    DXX,
    DXY,
    DYX,
    DYY,
    EXX,
    EXY,
    EYY,
    HEAT,
    JUMPS,
    KXX,
    KXY,
    KYY,
    NORMAL2,
    SPIN,
    SPIN2,
    TANGENTIAL2,
    TICKS,
    TOUCHING,
    VY2,
    WORK,
)


class Law(NamedTuple):
    """A model for the kernels.

    An exponent of 2 is given as None: with a power the loop does not vectorise. ``absolute`` is 1 if overlaps
    are absolute, None if they are relative to σ. ``U``, ``dU`` and ``d2U`` are addresses
    (:class:`petscjam.geometry.potential.Compiled`). ``film``: :func:`petscjam.md.contact.contact`.
    """

    normal: float
    tangential: float
    film: tuple[float, float, float] | None
    rolls: float
    exponent: float | None
    absolute: float | None
    body: float
    rotational_drag: float
    U: int | None
    dU: int | None
    d2U: int | None


class Disks(NamedTuple):
    """Disks sorted in space: current and predicted values, forces, radii, masses, and positions at the last build.

    ``angle`` has θ, or no element if angles are not kept.
    """

    q: Array
    p: Array
    F: Array
    R: Array
    m: Array
    home: Array
    angle: Array


class Moment(NamedTuple):
    """γ, γ̇ in 1/τe, and the time in ticks."""

    strain: float
    rate: float
    tick: int


class Measured(NamedTuple):
    """Sums and contact events of each chunk, one row each, and of the rest in the last row.

    ``counts`` has contacts made, contacts broken, and the duration of the broken ones in ticks; ``angles`` the
    collision angles of both. ``total`` is the sum of all rows, added at each step.
    """

    sums: Array
    counts: NDArray[np.int64]
    angles: NDArray[np.int64]
    total: Array


class Scheme(NamedTuple):
    """The integrator, dt of a part, parts of a step, effect of a change of the rate.

    ``single`` (one evaluation of the forces a step) and ``threads`` are True or None: numba removes the other branch.
    """

    single: bool | None
    dt: float
    parts: int
    bulk: int
    threads: bool | None


_contact = njit(cache=True, error_model="numpy", fastmath=FAST)(contact.contact)
_angle_bin = njit(cache=True, error_model="numpy", fastmath=FAST)(contact.angle_bin)
_stiffness = njit(cache=True, error_model="numpy")(contact.stiffness)
_energy = njit(cache=True, error_model="numpy")(contact.energy)
_largest = njit(cache=True, error_model="numpy")(contact.largest)
_fastest = njit(cache=True, error_model="numpy")(contact.fastest)


@njit(cache=True, error_model="numpy", fastmath=FAST)
def separation(c, q, pairs, strain, rate):
    """Return rji and vji of pair c, with the image of j of this pair.

    Parameters
    ----------
    c : int
    q : (N, 5)
    pairs : Pairs
    strain, rate : float
    """
    a, b, image = pairs.i[c], pairs.j[c], c - pairs.chunks[-1]
    x, y, vx, vy = q[b, 0] - q[a, 0], q[b, 1] - q[a, 1], q[b, 2] - q[a, 2], q[b, 3] - q[a, 3]
    if image >= 0:
        x += (pairs.nx[image] + pairs.ny[image] * (strain * pairs.aspect)) * pairs.length
        y += pairs.ny[image] * pairs.height
        vx += pairs.ny[image] * rate * pairs.height
    return x, y, vx, vy


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _event(c, q, pairs, now, counts, angles):
    """Record that pair c begins or ceases to touch."""
    x, y, vx, vy = separation(c, q, pairs, now.strain, now.rate)
    bin = _angle_bin(x, y, vx, vy)
    if pairs.touching[c]:
        counts[1] += 1
        counts[2] += now.tick - pairs.since[c]
        angles[1, bin] += 1
        pairs.touching[c] = 0
    else:
        counts[0] += 1
        angles[0, bin] += 1
        pairs.touching[c] = 1
        pairs.since[c] = now.tick


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _events(start, n, touch, touching, q, pairs, now, counts, angles):
    """Record the pairs of a batch that begin or cease to touch."""
    for c in range(n):
        if touch[c] != touching[c]:
            _event(start + c, q, pairs, now, counts, angles)


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _move_to_images(first, n, pairs, now, X, Y, U):
    """Change separations and velocities of a batch to those of the images of the pairs."""
    tilt = now.strain * pairs.aspect
    for c in range(n):
        row = pairs.ny[first + c]
        X[c] += (pairs.nx[first + c] + row * tilt) * pairs.length
        Y[c] += row * pairs.height
        U[c] += row * now.rate * pairs.height


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _add_pairs(chunk, q, F, pairs, law, now, measure, measured):
    """Add the forces of the pairs of a chunk, or of the rest, in batches.

    The main loop vectorises over scratch arrays: separations and velocities, then forces and torques.
    """
    X, Y, U, V, W = np.empty(BATCH), np.empty(BATCH), np.empty(BATCH), np.empty(BATCH), np.empty(BATCH)
    exx = exy = eyy = dxx = dxy = dyx = dyy = count = heat = 0.0
    rest, sums, normal, tangential = len(pairs.chunks) - 1, measured.sums, law.normal, law.tangential
    film, kind = law.film, (law.exponent, law.absolute, law.dU)
    end = len(pairs.i) if chunk == rest else pairs.chunks[chunk + 1]
    for start in range(pairs.chunks[chunk], end, BATCH):
        n = min(BATCH, end - start)
        i, j = pairs.i[start : start + n], pairs.j[start : start + n]
        inverse, touching = pairs.inverse[start : start + n], pairs.touching[start : start + n]
        for c in range(n):
            a, b = i[c], j[c]
            X[c], Y[c] = q[b, 0] - q[a, 0], q[b, 1] - q[a, 1]
            U[c], V[c] = q[b, 2] - q[a, 2], q[b, 3] - q[a, 3]
            W[c] = q[a, 4] + q[b, 4]
        if chunk == rest:
            _move_to_images(start - pairs.chunks[rest], n, pairs, now, X, Y, U)
        if measure:
            changed = 0.0
            for c in range(n):
                x, y, turn = X[c], Y[c], law.rolls * W[c] * inverse[c]
                ux, uy = U[c] + turn * y, V[c] - turn * x
                spring, gx, gy, touch = _contact(
                    x, y, ux, uy, 1.0 / np.sqrt(x * x + y * y), inverse[c], normal, tangential, film, *kind
                )
                X[c], Y[c] = gx - spring * x, gy - spring * y
                U[c], V[c] = 2.0 * law.rolls * inverse[c] * (x * gy - y * gx), touch
                exx, exy, eyy = exx + spring * x * x, exy + spring * x * y, eyy + spring * y * y
                dxx, dxy, dyx, dyy = dxx - gx * x, dxy - gx * y, dyx - gy * x, dyy - gy * y
                count, heat = count + touch, heat + gx * ux + gy * uy
                changed += abs(touch - touching[c])
            if changed > 0.0:
                _events(start, n, V, touching, q, pairs, now, measured.counts[chunk], measured.angles[chunk])
        else:
            for c in range(n):
                x, y, turn = X[c], Y[c], law.rolls * W[c] * inverse[c]
                ux, uy = U[c] + turn * y, V[c] - turn * x
                spring, gx, gy, touch = _contact(
                    x, y, ux, uy, 1.0 / np.sqrt(x * x + y * y), inverse[c], normal, tangential, film, *kind
                )
                X[c], Y[c] = gx - spring * x, gy - spring * y
                U[c] = 2.0 * law.rolls * inverse[c] * (x * gy - y * gx)
        for c in range(n):
            a, b = i[c], j[c]
            fx, fy, torque = X[c], Y[c], U[c]
            F[a, 0] += fx
            F[a, 1] += fy
            F[a, 2] += torque
            F[b, 0] -= fx
            F[b, 1] -= fy
            F[b, 2] += torque
    sums[chunk, EXX], sums[chunk, EXY], sums[chunk, EYY] = exx, exy, eyy
    sums[chunk, DXX], sums[chunk, DXY], sums[chunk, DYX], sums[chunk, DYY] = dxx, dxy, dyx, dyy
    sums[chunk, TOUCHING], sums[chunk, HEAT], sums[chunk, WORK] = count, heat, 0.0


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _drag(chunk, q, F, R, law, rate, sums):
    """Add Stokes drag: −ζ(v − γ̇ y x̂) on a disk, −ζr(θ̇ + γ̇/2) on its rotation."""
    heat = couple = 0.0
    for a in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(q))):
        cx, cy, spin = q[a, 2] - rate * q[a, 1], q[a, 3], q[a, 4] / R[a] + 0.5 * rate
        F[a, 0] -= law.body * cx
        F[a, 1] -= law.body * cy
        F[a, 2] -= 2.0 * law.rotational_drag * spin / R[a]
        heat += law.body * (cx * cx + cy * cy) + law.rotational_drag * spin * spin
        couple += law.rotational_drag * spin
    sums[chunk, HEAT] += heat
    sums[chunk, WORK] = 0.5 * rate * couple  # of the couple that rotates the fluid


@njit(cache=True, error_model="numpy", fastmath=FAST)
def kinetic(q, m, rate, sums):
    """Sum the products of peculiar velocities (VOT eq. 14) into the last row of ``sums``.

    Parameters
    ----------
    q : (N, 5)
    m : (N,)
    rate : float
    sums : (chunks + 1, sums)
    """
    for a in range(len(q)):
        x, y = q[a, 2] - rate * q[a, 1], q[a, 3]
        sums[-1, KXX] += m[a] * x * x
        sums[-1, KXY] += m[a] * x * y
        sums[-1, KYY] += m[a] * y * y


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _predict(chunk, disks, scheme, rate, shear, correct, sums):
    """Predict positions and velocities (VOT eqs. 21, 22, or to second order); return the largest displacement².

    ``shear`` is the strain since the list was built. With one evaluation a step, ``correct`` first completes the
    step before (:func:`_correct`). Also sum the products of peculiar velocities (VOT eq. 14): current or, with one
    evaluation a step, predicted.
    """
    q, p, F, m, home, dt, single = disks.q, disks.p, disks.F, disks.m, disks.home, scheme.dt, scheme.single
    largest = xx = xy = yy = 0.0
    for a in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(q))):
        gain = dt / m[a]
        ax, ay, at = gain * F[a, 0], gain * F[a, 1], gain * F[a, 2]
        x, y, u, v, w = q[a, 0], q[a, 1], q[a, 2], q[a, 3], q[a, 4]
        if single is not None:
            if correct:
                x, y = p[a, 0], p[a, 1]
                u, v, w = 0.5 * (u + p[a, 2] + ax), 0.5 * (v + p[a, 3] + ay), 0.5 * (w + p[a, 4] + at)
                q[a, 0], q[a, 1], q[a, 2], q[a, 3], q[a, 4] = x, y, u, v, w
            x, y = x + dt * (u + 0.5 * ax), y + dt * (v + 0.5 * ay)
            cx, cy = u + ax - rate * y, v + ay
            F[a, 0] = F[a, 1] = F[a, 2] = 0.0
        else:
            cx, cy = u - rate * y, v
            x, y = x + dt * u, y + dt * v
        p[a, 0], p[a, 1], p[a, 2], p[a, 3], p[a, 4] = x, y, u + ax, v + ay, w + at
        xx, xy, yy = xx + m[a] * cx * cx, xy + m[a] * cx * cy, yy + m[a] * cy * cy
        dx, dy = x - shear * y - home[a, 0], y - home[a, 1]
        largest = max(largest, dx * dx + dy * dy)
    sums[chunk, KXX], sums[chunk, KXY], sums[chunk, KYY] = xx, xy, yy
    return largest


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _correct(chunk, disks, scheme):
    """Average both forces: F is their sum (VOT eqs. 23, 24); with one evaluation, (v + v̂)/2 contains half of one."""
    q, p, F, m, dt, single = disks.q, disks.p, disks.F, disks.m, scheme.dt, scheme.single
    for a in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(q))):
        h = 0.5 * dt / m[a]
        u, v, w = q[a, 2], q[a, 3], q[a, 4]
        if single is not None:
            q[a, 0], q[a, 1] = p[a, 0], p[a, 1]
            q[a, 2], q[a, 3] = 0.5 * (u + p[a, 2]) + h * F[a, 0], 0.5 * (v + p[a, 3]) + h * F[a, 1]
            q[a, 4] = 0.5 * (w + p[a, 4]) + h * F[a, 2]
        else:
            q[a, 2], q[a, 3], q[a, 4] = u + h * F[a, 0], v + h * F[a, 1], w + h * F[a, 2]
            q[a, 0] += 0.5 * dt * (u + q[a, 2])
            q[a, 1] += 0.5 * dt * (v + q[a, 3])
            F[a, 0] = F[a, 1] = F[a, 2] = 0.0


@njit(cache=True, error_model="numpy")
def jump(q, m, height, old, new, bulk):
    """Change the strain rate; return the change of the peculiar kinetic and rotational energy.

    ``bulk``: 0 changes only the boundary, 1 scales velocities and spins (VOT eqs. 40, 41), 2 adds the change of
    the linear profile.

    Parameters
    ----------
    q : (N, 5)
        Overwritten.
    m : (N,)
    height : float
        Ly.
    old, new : float
        Strain rates.
    bulk : int
        A value of ``BULK``.
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
        elif bulk == 0:  # an image outside the cell moves with its row of images
            q[a, 2] += (new - old) * height * np.floor(q[a, 1] / height)
        x, y, w = q[a, 2] - new * q[a, 1], q[a, 3], q[a, 4]
        gain += m[a] * (0.5 * (x * x + y * y) + 0.25 * w * w)
    return gain


@njit(cache=True, error_model="numpy")
def _force(chunk, q, disks, pairs, law, now, measure, measured):
    """Add the forces inside a chunk."""
    _add_pairs(chunk, q, disks.F, pairs, law, now, measure, measured)
    if law.body != 0.0 or law.rotational_drag != 0.0:
        _drag(chunk, q, disks.F, disks.R, law, now.rate, measured.sums)


@njit(cache=True)
def _force_chunks(q, disks, pairs, law, now, measure, measured):
    for chunk in range(len(pairs.chunks) - 1):
        _force(chunk, q, disks, pairs, law, now, measure, measured)


@njit(cache=True, parallel=True)
def _force_chunks_threaded(q, disks, pairs, law, now, measure, measured):
    for chunk in prange(len(pairs.chunks) - 1):
        _force(chunk, q, disks, pairs, law, now, measure, measured)


@njit(cache=True)
def _predict_chunks(disks, scheme, rate, shear, correct, sums, moved):
    for chunk in range(len(moved)):
        moved[chunk] = _predict(chunk, disks, scheme, rate, shear, correct, sums)


@njit(cache=True, parallel=True)
def _predict_chunks_threaded(disks, scheme, rate, shear, correct, sums, moved):
    for chunk in prange(len(moved)):
        moved[chunk] = _predict(chunk, disks, scheme, rate, shear, correct, sums)


@njit(cache=True)
def _correct_chunks(disks, scheme, chunks):
    for chunk in range(chunks):
        _correct(chunk, disks, scheme)


@njit(cache=True, parallel=True)
def _correct_chunks_threaded(disks, scheme, chunks):
    for chunk in prange(chunks):
        _correct(chunk, disks, scheme)


@njit(cache=True, error_model="numpy")
def forces(q, disks, pairs, law, now, threads, measure, measured):
    """Add all forces on disks at ``q`` to those of ``disks``; with ``measure``, fill ``measured``.

    Parameters
    ----------
    q : (N, 5)
    disks : Disks
    pairs : Pairs
    law : Law
    now : Moment
    threads : True or None
    measure : bool
    measured : Measured
    """
    if threads is not None:
        _force_chunks_threaded(q, disks, pairs, law, now, measure, measured)
    else:
        _force_chunks(q, disks, pairs, law, now, measure, measured)
    _add_pairs(len(pairs.chunks) - 1, q, disks.F, pairs, law, now, measure, measured)


@njit(cache=True, error_model="numpy")
def _predict_all(disks, scheme, rate, shear, correct, sums, moved):
    if scheme.threads is not None:
        _predict_chunks_threaded(disks, scheme, rate, shear, correct, sums, moved)
    else:
        _predict_chunks(disks, scheme, rate, shear, correct, sums, moved)


@njit(cache=True, error_model="numpy")
def record(sums, rate, weight, total):
    """Add ``weight`` times the sums of all chunks, and the power of the shear stress, to ``total``.

    Parameters
    ----------
    sums : (chunks + 1, sums)
    rate, weight : float
    total : (sums,)
        Overwritten.
    """
    shear = 0.0
    for name in range(WORK):
        value = sums[:, name].sum()
        total[name] += weight * value
        if name in (EXY, DXY, KXY):
            shear += value
    total[WORK] += weight * (sums[:, WORK].sum() - rate * shear)


@njit(cache=True, error_model="numpy")
def _change(disks, pairs, law, now, old, scheme, measured):
    """Change the strain rate from ``old``, and add the change of the energy and of the work.

    Half of the stress counts for the part before, and half for this part.
    """
    sums, change, heun = measured.sums, now.rate - old, scheme.single is None
    measured.total[JUMPS] += jump(disks.q, disks.m, pairs.height, old, now.rate, scheme.bulk)
    disks.F[:] = 0.0
    forces(disks.q, disks, pairs, law, now, scheme.threads, True, measured)
    kinetic(disks.q, disks.m, now.rate, sums)
    shear = sums[:, EXY].sum() + sums[:, DXY].sum() + sums[-1, KXY]
    measured.total[WORK] += (0.5 if heun else -0.5) / scheme.parts * change * shear
    sums[-1, KXX:WORK] = 0.0


@njit(cache=True, error_model="numpy")
def _turn(disks, time):
    """Add θ̇ times ``time`` to the angles: half a step before and half after is the trapezoidal rule."""
    for a in range(len(disks.angle)):
        disks.angle[a] += time * disks.q[a, 4] / disks.R[a]


@njit(cache=True, error_model="numpy")
def advance(disks, pairs, law, scheme, strains, rates, tick, measured):
    """Make parts of steps as long as the list of pairs is valid.

    Parameters
    ----------
    disks : Disks
    pairs : Pairs
    law : Law
    scheme : Scheme
    strains : (K + 1,)
        At the beginnings of parts, and at the end of the last.
    rates : (K + 1,)
        Before the first part, and in each.
    tick : int
        Time of the beginning, in ticks, :data:`petscjam.md.engine.TICKS` per step.
    measured : Measured
        The sums at the beginning (two evaluations of the forces a step) or end (one) of each part, divided by
        ``parts``, are added to ``total``.

    Returns
    -------
    int
        Parts made: less than K if a new list is needed first.
    """
    sums, heun, threads = measured.sums, scheme.single is None, scheme.threads
    chunks, last = len(pairs.chunks) - 1, len(rates) - 2
    moved = np.zeros(chunks)
    reach = 2.0 * disks.R.max()
    disks.F[:] = 0.0
    fresh, predicted = True, False
    weight, ticks = 1.0 / scheme.parts, TICKS // scheme.parts
    for k in range(last + 1):
        rate = rates[k + 1]
        now, then = Moment(strains[k], rate, tick + k * ticks), Moment(strains[k + 1], rate, tick + k * ticks)
        if rate != rates[k]:
            _change(disks, pairs, law, now, rates[k], scheme, measured)
            rates[k] = rate
        elif heun or fresh:
            forces(disks.q, disks, pairs, law, now, threads, heun, measured)
        fresh = False
        if not predicted:
            _predict_all(disks, scheme, rate, strains[k + 1] - pairs.strain, False, sums, moved)
        shear = strains[k + 1] - pairs.strain
        room = 0.5 * (pairs.skin - reach * (np.sqrt(1.0 + 0.25 * shear**2) + 0.5 * abs(shear) - 1.0))
        if room <= 0.0 or moved.max() > room * room:
            return k
        if heun:
            record(sums, rate, weight, measured.total)
        _turn(disks, 0.5 * scheme.dt)
        forces(disks.p, disks, pairs, law, then, threads, not heun, measured)
        if not heun:
            record(sums, rate, weight, measured.total)
        predicted = not heun and k < last and rates[k + 2] == rate
        if predicted:
            _predict_all(disks, scheme, rate, strains[k + 2] - pairs.strain, True, sums, moved)
        elif threads is not None:
            _correct_chunks_threaded(disks, scheme, chunks)
        else:
            _correct_chunks(disks, scheme, chunks)
        _turn(disks, 0.5 * scheme.dt)
    return last + 1


@njit(cache=True, error_model="numpy")
def _moments(q, pairs, law, exponent, strain):
    """Return sums over the contacts of each disk, (N, 9).

    Σ w, Σ w cos 2φ, Σ w sin 2φ, the same with the stiffness, Σ w ρ t, Σ w ρ², where w = 1 + zj/zi.
    """
    images, tilt = pairs.chunks[-1], strain * pairs.aspect
    z, X, Y = np.zeros(len(q)), np.empty(len(pairs.i)), np.empty(len(pairs.i))
    for c in range(len(pairs.i)):
        a, b, inverse = pairs.i[c], pairs.j[c], pairs.inverse[c]
        X[c], Y[c] = (q[b, 0] - q[a, 0]) * inverse, (q[b, 1] - q[a, 1]) * inverse
        if c >= images:
            X[c] += (pairs.nx[c - images] + pairs.ny[c - images] * tilt) * pairs.length * inverse
            Y[c] += pairs.ny[c - images] * pairs.height * inverse
        if X[c] * X[c] + Y[c] * Y[c] <= 1.0:
            z[a] += 1.0
            z[b] += 1.0
    s = np.zeros((len(q), 9))
    for c in range(len(pairs.i)):
        x, y = X[c], Y[c]
        square = x * x + y * y
        if square <= 1.0:
            a, b, sign = pairs.i[c], pairs.j[c], 1.0
            cos, sin = (x * x - y * y) / square, 2.0 * x * y / square
            k = _stiffness(np.sqrt(square), pairs.inverse[c], exponent, law.absolute, law.d2U)
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
    return s


@njit(cache=True, error_model="numpy")
def fastest(disks, pairs, law, exponent, strain):
    """Return bounds on the largest eigenvalues of M⁻¹B and of M⁻¹K, from the contacts of the current state.

    Of a relative velocity, |vi − vj|² ≤ (1 + zj/zi)|vi|² + (1 + zi/zj)|vj|² with the numbers of contacts z,
    so the bound is a sum of forms of single disks (docs/theory.md, Largest time steps). Pre-stress only reduces K.

    Parameters
    ----------
    disks : Disks
    pairs : Pairs
    law : Law
    exponent : float
        α of the repulsion, if it is a power.
    strain : float
        γ.

    Returns
    -------
    relaxation, oscillation : float
        In 1/τe, and squared in 1/τe².
    """
    s, relaxation, oscillation = _moments(disks.q, pairs, law, exponent, strain), 0.0, 0.0
    normal, tangential, rolls, body, drag = law.normal, law.tangential, law.rolls, law.body, law.rotational_drag
    largest = _largest(law.film)
    normal, tangential = normal * largest, tangential * largest
    for a in range(len(s)):
        most = _fastest(s[a], disks.m[a], disks.R[a], normal, tangential, rolls, body, drag)
        relaxation, oscillation = max(relaxation, most[0]), max(oscillation, most[1])
    return relaxation, oscillation


@njit(cache=True, error_model="numpy")
def elastic_energy(q, pairs, law, exponent, strain):
    """Return the sum of U over the contacts, in m ds²/τe².

    Parameters
    ----------
    q : (N, 5)
    pairs : Pairs
    law : Law
    exponent, strain : float
    """
    energy = 0.0
    for c in range(len(pairs.i)):
        x, y, _, _ = separation(c, q, pairs, strain, 0.0)
        overlap = 1.0 - np.sqrt(x * x + y * y) * pairs.inverse[c]
        if overlap > 0.0:
            energy += _energy(overlap, pairs.inverse[c], exponent, law.absolute, law.U)
    return energy


@njit(cache=True, error_model="numpy")
def sample_disks(q, R, m, height, rate, layers, sums):
    """Add observables of disks to ``layers`` and ``sums`` (:meth:`petscjam.md.engine.Engine.sample`).

    Parameters
    ----------
    q : (N, 5)
    R, m : (N,)
    height, rate : float
        Ly and γ̇.
    layers, sums : arrays
        Overwritten.
    """
    for a in range(len(q)):
        spin, row = q[a, 4] / R[a], np.floor(q[a, 1] / height)
        y, vx = q[a, 1] - row * height, q[a, 2] - row * rate * height
        sums[SPIN] += spin
        sums[SPIN2] += spin * spin
        sums[DVX2] += (vx - rate * y) ** 2
        sums[VY2] += q[a, 3] ** 2
        layer = min(int(y / height * layers.shape[1]), layers.shape[1] - 1)
        layers[0, layer] += 1.0
        layers[1, layer] += vx
        layers[2, layer] += np.pi * R[a] ** 2
        cx, cy = vx - rate * y, q[a, 3]
        layers[3, layer] += m[a] * cx * cx
        layers[4, layer] += m[a] * cx * cy
        layers[5, layer] += m[a] * cy * cy


@njit(cache=True, error_model="numpy")
def sample_contacts(q, pairs, law, now, layers, moments, scatter, sums):
    """Add observables of contacts (:meth:`petscjam.md.engine.Engine.sample`); those of one contact go to ``scatter``.

    The choice of this contact varies from sample to sample, and is the same after a restart.

    Parameters
    ----------
    q : (N, 5)
    pairs : Pairs
    law : Law
    now : Moment
    layers, moments, scatter, sums : arrays
        Overwritten.
    """
    v, touching, rate, count = np.zeros(4), 0, now.rate, layers.shape[1]
    for c in range(len(pairs.i)):
        touching += pairs.touching[c]
    chosen = now.tick // TICKS % 2**31 * 2654435761 % 2**31 % max(touching, 1)
    for c in range(len(pairs.i)):
        if pairs.touching[c]:
            x, y, vx, vy = separation(c, q, pairs, now.strain, rate)
            r = np.sqrt(x * x + y * y)
            v[0] = (vx * y - vy * x) / r
            v[1] = (q[pairs.i[c], 4] + q[pairs.j[c], 4]) * r * pairs.inverse[c]
            v[2] = v[0] + v[1]
            v[3] = -(vx * x + vy * y) / r
            turn = law.rolls * v[1] / r
            friction, kind = (law.normal, law.tangential, law.film), (law.exponent, law.absolute, law.dU)
            spring, gx, gy, _ = _contact(
                x, y, vx + turn * y, vy - turn * x, 1.0 / r, pairs.inverse[c], *friction, *kind
            )
            for a in (pairs.i[c], pairs.j[c]):
                s = q[a, 1] / pairs.height
                layer = min(int((s - np.floor(s)) * count), count - 1)
                layers[3, layer] += (spring * x - gx) * x / 2
                layers[4, layer] += (spring * x - gx) * y / 2
                layers[5, layer] += (spring * y - gy) * y / 2
            sums[NORMAL2] += v[3] ** 2
            sums[TANGENTIAL2] += v[0] ** 2
            if rate != 0.0:
                v /= rate
                moments[0] += v
                for k in range(4):
                    moments[k + 1] += v[k] * v
                if sums[CONTACTS] == chosen:
                    scatter[:] = v
            sums[CONTACTS] += 1.0
