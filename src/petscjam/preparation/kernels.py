"""The hot loops of packing preparation, compiled by numba: forces, and two minimisers.

Disks are sorted in space; pairs come run by run (:func:`petscjam.geometry.neighbours.find`). Runs are shared among
threads, each run is added up in order: sums do not depend on the number of threads.

Axes: i, j disks of pair c.
"""

from __future__ import annotations

import numpy as np

from petscjam.base.compiled import njit, prange
from petscjam.geometry.neighbours import CHUNK

BATCH = 256
FAST = {"contract", "reassoc", "arcp", "nsz"}  # sums may be reordered, but NaN stays NaN


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _add_run(run, x, i, j, sigma, k, runs, exponent, out, sums):
    """Add the pairs of a run. In batches, because their middle loop vectorises: a quarter is gained."""
    energy = xx = xy = yy = 0.0
    r = np.empty(BATCH, dtype=np.complex128)
    out[run * CHUNK : (run + 1) * CHUNK] = 0.0
    for first in range(runs[run], runs[run + 1], BATCH):
        last = min(first + BATCH, runs[run + 1])
        one, two, reach, stiff = i[first:last], j[first:last], sigma[first:last], k[first:last]
        for c in range(last - first):
            r[c] = x[two[c]] - x[one[c]]
        if exponent == 2.0:
            for c in range(last - first):
                dx, dy = r[c].real, r[c].imag
                distance = np.sqrt(dx * dx + dy * dy)
                overlap = max(reach[c] - distance, 0.0)
                f = stiff[c] * overlap
                fx, fy = f / distance * dx, f / distance * dy
                r[c] = complex(fx, fy)
                energy += f * overlap
                xx, xy, yy = xx + fx * dx, xy + fx * dy, yy + fy * dy
        else:
            for c in range(last - first):
                dx, dy = r[c].real, r[c].imag
                distance = np.sqrt(dx * dx + dy * dy)
                overlap = max(reach[c] - distance, 0.0)
                f = stiff[c] * overlap ** (exponent - 1)
                fx, fy = f / distance * dx, f / distance * dy
                r[c] = complex(fx, fy)
                energy += f * overlap
                xx, xy, yy = xx + fx * dx, xy + fx * dy, yy + fy * dy
        for c in range(last - first):
            out[one[c]] += r[c]
            out[two[c]] -= r[c]
    sums[run, 0], sums[run, 1], sums[run, 2], sums[run, 3] = energy / exponent, xx, xy, yy


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _add_rest(x, i, j, sigma, k, first, image, exponent, out, sums):
    """Add the pairs that join two runs, or a disk and an image."""
    energy = xx = xy = yy = 0.0
    for rest in range(len(image)):
        a, b = i[first + rest], j[first + rest]
        r = x[b] - x[a] + image[rest]
        dx, dy = r.real, r.imag
        distance = np.sqrt(dx * dx + dy * dy)
        overlap = max(sigma[first + rest] - distance, 0.0)
        f = k[first + rest] * overlap ** (exponent - 1)
        fx, fy = f / distance * dx, f / distance * dy
        energy += f * overlap
        xx, xy, yy = xx + fx * dx, xy + fx * dy, yy + fy * dy
        out[a] += complex(fx, fy)
        out[b] -= complex(fx, fy)
    sums[-1, 0], sums[-1, 1], sums[-1, 2], sums[-1, 3] = energy / exponent, xx, xy, yy


@njit(cache=True)
def gradient(x, i, j, sigma, k, runs, image, exponent, out, sums):
    """Elastic energy U and its gradient. Vectors in the plane are complex numbers, x + iy, here.

    Parameters
    ----------
    x : (N,) complex
    i, j : (C,) unsigned
        Pairs that may overlap; two disks that meet through two images are listed twice.
    sigma, k : (C,)
        Sum of radii; U = k δ^exponent / exponent.
    runs : (R + 1,)
        Where the pairs of each run start; those from runs[R] on join runs or cross the edge.
    image : (C − runs[R],) complex
        Lattice translation of j for the latter.
    exponent : float
    out : (N,) complex
        Overwritten with dU/dx.
    sums : (R + 1, 4)
        Overwritten with U and the xx, xy, yy parts of Σ f r⊗n: of each run, and of the rest.
    """
    for run in range(len(runs) - 1):
        _add_run(run, x, i, j, sigma, k, runs, exponent, out, sums)
    _add_rest(x, i, j, sigma, k, runs[-1], image, exponent, out, sums)


@njit(cache=True, parallel=True)
def gradient_threaded(x, i, j, sigma, k, runs, image, exponent, out, sums):
    """Do what :func:`gradient` does, the runs shared among threads."""
    for run in prange(len(runs) - 1):
        _add_run(run, x, i, j, sigma, k, runs, exponent, out, sums)
    _add_rest(x, i, j, sigma, k, runs[-1], image, exponent, out, sums)


@njit(cache=True, fastmath=FAST)
def _map(x, F, out):
    """Set ``out`` (N,) complex to F·x."""
    for a in range(len(x)):
        X, Y = x[a].real, x[a].imag
        out[a] = complex(F[0, 0] * X + F[0, 1] * Y, F[1, 0] * X + F[1, 1] * Y)


@njit(cache=True)
def deformation(z, n, cell):
    """Return F = 1 + Σ e_s E_s, where w e_s = z[2n + s]."""
    strains, weight, _, _ = cell
    F = np.eye(2)
    for s in range(len(strains)):
        F += z[2 * n + s] / weight * strains[s]
    return F


@njit(cache=True)
def evaluate(z, n, cell, pairs, exponent, threads, true, sums, g):
    """Gradient of H = U + pV.

    Parameters
    ----------
    z : (2n + S,)
        As described in :class:`petscjam.preparation.minimise.Enthalpy`.
    n : int
    cell : (S, 2, 2), float, float, float
        Strains, weight w, target pressure, area of the reference cell.
    pairs, exponent, sums
        As in :func:`gradient`: i, j, sigma, k, runs, image.
    threads : bool
    true : (n,) complex
        Overwritten.
    g : (2n + S,)
        Overwritten with dH/dz.

    Returns
    -------
    force : float
        Largest net force on a disk.
    energy : float
    stress : (3,)
        Pressure tensor Σ f r⊗n / V: xx, xy, yy.
    """
    i, j, sigma, k, runs, image = pairs
    strains, weight, target, area = cell
    x, forces = z[: 2 * n].view(np.complex128), g[: 2 * n].view(np.complex128)
    F = deformation(z, n, cell)
    if len(strains) > 0:
        _map(x, F, true)
        x, there = true, np.empty_like(image)
        _map(image, F, there)
        image = there
    if threads:
        gradient_threaded(x, i, j, sigma, k, runs, image, exponent, forces, sums)
    else:
        gradient(x, i, j, sigma, k, runs, image, exponent, forces, sums)
    energy, xx, xy, yy = sums[:, 0].sum(), sums[:, 1].sum(), sums[:, 2].sum(), sums[:, 3].sum()
    force = np.sqrt(_largest_square(forces))
    if len(strains) > 0:
        _map(forces, F.T, forces)
        det = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
        area *= det
        excess = np.array([[target * area - xx, -xy], [-xy, target * area - yy]])
        first = excess @ np.array([[F[1, 1], -F[1, 0]], [-F[0, 1], F[0, 0]]]) / det  # times F⁻ᵀ
        for s in range(len(strains)):
            g[2 * n + s] = (first * strains[s]).sum() / weight
    return force, energy, np.array([xx, xy, yy]) / area


@njit(cache=True, fastmath=FAST)
def _survey_run(run, n, g, v, found):
    gg = gv = vv = most = 0.0
    for a in range(run * CHUNK, min(n, (run + 1) * CHUNK)):
        gx, gy, vx, vy = g[2 * a], g[2 * a + 1], v[2 * a], v[2 * a + 1]
        size = gx * gx + gy * gy
        gg += size
        gv += gx * vx + gy * vy
        vv += vx * vx + vy * vy
        most = max(most, size)
    found[run, 0], found[run, 1], found[run, 2], found[run, 3] = gg, gv, vv, most


@njit(cache=True, fastmath=FAST)
def _advance_run(run, n, z, v, g, keep, push, step, built, found):
    fastest = farthest = 0.0
    for a in range(run * CHUNK, min(n, (run + 1) * CHUNK)):
        vx = keep * v[2 * a] - push * g[2 * a]
        vy = keep * v[2 * a + 1] - push * g[2 * a + 1]
        x, y = z[2 * a] + step * vx, z[2 * a + 1] + step * vy
        v[2 * a], v[2 * a + 1], z[2 * a], z[2 * a + 1] = vx, vy, x, y
        fastest = max(fastest, vx * vx + vy * vy)
        farthest = max(farthest, (x - built[2 * a]) ** 2 + (y - built[2 * a + 1]) ** 2)
    found[run, 0], found[run, 1] = fastest, farthest


@njit(cache=True)
def survey(n, g, v, threads):
    """Return g·g, g·v, v·v, and the largest gradient on a disk or a strain."""
    found = np.empty(((n + CHUNK - 1) // CHUNK, 4))
    if threads:
        _survey_threaded(n, g, v, found)
    else:
        for run in range(len(found)):
            _survey_run(run, n, g, v, found)
    gg, gv, vv, most = found[:, 0].sum(), found[:, 1].sum(), found[:, 2].sum(), found[:, 3].max()
    for s in range(2 * n, len(g)):
        gg, gv, vv = gg + g[s] ** 2, gv + g[s] * v[s], vv + v[s] ** 2
        most = max(most, g[s] ** 2)
    return gg, gv, vv, np.sqrt(most)


@njit(cache=True, parallel=True)
def _survey_threaded(n, g, v, found):
    for run in prange(len(found)):
        _survey_run(run, n, g, v, found)


@njit(cache=True)
def advance(n, z, v, g, keep, push, step, built, threads):
    """Set v to keep·v − push·g, move z by step·v.

    Return the largest velocity, and the longest way of a disk since ``built``.
    """
    found = np.empty(((n + CHUNK - 1) // CHUNK, 2))
    if threads:
        _advance_threaded(n, z, v, g, keep, push, step, built, found)
    else:
        for run in range(len(found)):
            _advance_run(run, n, z, v, g, keep, push, step, built, found)
    fastest = found[:, 0].max()
    for s in range(2 * n, len(z)):
        v[s] = keep * v[s] - push * g[s]
        z[s] += step * v[s]
        fastest = max(fastest, v[s] ** 2)
    return np.sqrt(fastest), np.sqrt(found[:, 1].max())


@njit(cache=True, parallel=True)
def _advance_threaded(n, z, v, g, keep, push, step, built, found):
    for run in prange(len(found)):
        _advance_run(run, n, z, v, g, keep, push, step, built, found)


@njit(cache=True)
def stale(moved, z, built, n, cell, largest, skin):
    """Whether a pair that was farther apart than ρi + ρj + ``skin`` at ``built`` may touch at ``z``.

    Only non-affine motion counts, of which ``moved`` is the longest: F·F_built⁻¹ shrinks the distance of
    a pair by at most its smallest singular value.
    """
    if len(cell[0]) == 0:
        return 2 * moved >= skin
    F, F0 = deformation(z, n, cell), deformation(built, n, cell)
    ratio = np.linalg.svd(F @ np.linalg.inv(F0))[1][1]
    stretch = np.linalg.svd(F)[1][0]
    return 2 * stretch * moved >= ratio * skin - max(1 - ratio, 0.0) * largest


@njit(cache=True, fastmath=FAST)
def _largest_square(vectors):
    """Largest |v|² of ``vectors`` (N,) complex."""
    most = 0.0
    for v in vectors:
        most = max(most, v.real * v.real + v.imag * v.imag)
    return most


@njit(cache=True, fastmath=FAST)
def farthest(n, z, built):
    """Longest way of a disk from ``built`` to ``z``, (2n + S,) both."""
    most = 0.0
    for a in range(n):
        most = max(most, (z[2 * a] - built[2 * a]) ** 2 + (z[2 * a + 1] - built[2 * a + 1]) ** 2)
    return np.sqrt(most)


@njit(cache=True)
def stress_error(stress, cell):
    """Largest error of what the cell relaxes: the pressure, or every part of the pressure tensor."""
    xx, xy, yy = stress
    target = cell[2]
    if len(cell[0]) == 0:
        return 0.0
    if len(cell[0]) == 1:
        return abs((xx + yy) / 2 - target)
    return max(abs(xx - target), abs(yy - target), abs(xy))


@njit(cache=True)
def reached(force, stress, cell, goal):
    """Whether the largest force is below goal[0], or goal[1] times the pressure, and the stress right."""
    absolute, relative, error = goal
    pressure = (stress[0] + stress[2]) / 2
    return force <= max(absolute, relative * pressure) and stress_error(stress, cell) <= error


@njit(cache=True)
def fire(
    z,
    g,
    v,
    state,
    force,
    energy,
    stress,
    goal,
    steps,
    slowest,
    limit,
    built,
    largest,
    skin,
    n,
    cell,
    pairs,
    exponent,
    threads,
    true,
    sums,
):
    """Take steps of FIRE until the goal is reached, the neighbour list is stale, or ``steps`` are done.

    ``z``, ``v`` and ``state`` (time step, mixing, steps downhill, largest velocity) change in place, and
    ``g``, the gradient at z, unless the list is stale. The time step stays below ``slowest``, a step below
    ``limit``.

    Returns
    -------
    taken : int
        Gradients evaluated.
    fresh : bool
        Whether g is the gradient at z.
    force, energy, stress
        As from :func:`evaluate`.
    """
    gg, gv, vv, most = survey(n, g, v, threads)
    for taken in range(steps):
        if reached(force, stress, cell, goal):
            return taken, True, force, energy, stress
        if gv < 0:
            keep, push = 1 - state[1], state[1] * np.sqrt(vv / gg)
            state[2] += 1
            if state[2] > 5:
                state[0], state[1] = 1.1 * state[0], 0.99 * state[1]
        else:
            keep = push = 0.0
            state[0], state[1], state[2] = 0.5 * state[0], 0.1, 0.0
        state[0] = min(state[0], slowest)
        push += state[0]
        step = min(state[0], limit / (keep * state[3] + push * most))
        state[3], moved = advance(n, z, v, g, keep, push, step, built, threads)
        if stale(moved, z, built, n, cell, largest, skin):
            return taken, False, force, energy, stress
        force, energy, stress = evaluate(z, n, cell, pairs, exponent, threads, true, sums, g)
        gg, gv, vv, most = survey(n, g, v, threads)
    return steps, True, force, energy, stress


@njit(cache=True, fastmath=FAST)
def _along(z, d, step, trial, built, n):
    """Set ``trial`` to z + step·d; return the longest way of a disk since ``built``."""
    for s in range(2 * n, len(z)):
        trial[s] = z[s] + step * d[s]
    most = 0.0
    for a in range(n):
        x, y = z[2 * a] + step * d[2 * a], z[2 * a + 1] + step * d[2 * a + 1]
        trial[2 * a], trial[2 * a + 1] = x, y
        most = max(most, (x - built[2 * a]) ** 2 + (y - built[2 * a + 1]) ** 2)
    return np.sqrt(most)


@njit(cache=True, fastmath=FAST)
def _dot(a, b):
    total = 0.0
    for s in range(len(a)):
        total += a[s] * b[s]
    return total


@njit(cache=True, fastmath=FAST)
def _turn(z, g, d, trial, g_trial):
    """Move z and g to the trial point, turn d by Polak–Ribière+; return the slope along d, and max |d|."""
    gg = across = new = 0.0
    for s in range(len(z)):
        gg += g[s] * g[s]
        across += g[s] * g_trial[s]
        new += g_trial[s] * g_trial[s]
    beta = max(0.0, (new - across) / gg)
    slope = most = 0.0
    for s in range(len(z)):
        z[s], g[s] = trial[s], g_trial[s]
        d[s] = beta * d[s] - g[s]
        slope += g[s] * d[s]
        most = max(most, abs(d[s]))
    if slope >= 0:
        slope, most = -new, 0.0
        for s in range(len(z)):
            d[s] = -g[s]
            most = max(most, abs(d[s]))
    return slope, most


@njit(cache=True)
def conjugate_gradients(
    z,
    g,
    d,
    trial,
    g_trial,
    state,
    force,
    energy,
    stress,
    goal,
    steps,
    limit,
    built,
    largest,
    skin,
    n,
    cell,
    pairs,
    exponent,
    threads,
    true,
    sums,
):
    """Take steps of Polak–Ribière+ conjugate gradients until the goal, a stale list, or enough gradients.

    A line is followed until the slope of H along d has risen to within 5 % of zero, by secants; a looser
    search takes more gradients at low pressure, a tighter one no fewer. Only gradients are compared: energies
    stop telling points apart at √ε of the way. z, g, d, trial and its gradient, and ``state`` change in
    place: the slope at z, the step, the bracket (low, slope, high, slope), the largest step, and the trials.

    Returns
    -------
    taken : int
        Gradients evaluated.
    force, energy, stress
        At z, as from :func:`evaluate`.
    """
    for taken in range(steps):
        moved = _along(z, d, state[1], trial, built, n)
        if stale(moved, trial, built, n, cell, largest, skin):
            return taken, force, energy, stress
        there = evaluate(trial, n, cell, pairs, exponent, threads, true, sums, g_trial)
        slope, step = _dot(g_trial, d), state[1]
        state[7] += 1
        if abs(slope) <= -0.05 * state[0] or (slope < 0 and step >= state[6]) or state[7] == 20:
            force, energy, stress = there
            state[0], most = _turn(z, g, d, trial, g_trial)
            state[6] = limit / most
            state[1] = min(step, state[6])
            state[2], state[3], state[4], state[5], state[7] = 0.0, state[0], np.inf, np.inf, 0.0
            if reached(force, stress, cell, goal):
                return taken + 1, force, energy, stress
        elif slope > 0 or state[4] < np.inf:
            if slope > 0:
                state[4], state[5] = step, slope
            else:
                state[2], state[3] = step, slope
            state[1] = state[2] + (state[4] - state[2]) * state[3] / (state[3] - state[5])
        else:
            zero = step + (step - state[2]) * slope / (state[3] - slope) if slope > state[3] else np.inf
            state[1], state[2], state[3] = min(zero, 4 * step, state[6]), step, slope
    return steps, force, energy, stress
