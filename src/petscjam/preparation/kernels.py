"""The loops of packing preparation, compiled by numba: forces, and two minimisers.

Disks are sorted in space and divided into chunks; pairs are listed chunk by chunk
(:func:`petscjam.geometry.neighbours.find`). Chunks are distributed over threads, and each is summed in order:
sums do not depend on the number of threads. Vectors are complex numbers, x + iy, here.

Axes: i, j disks of pair c, s strain of the cell.
"""

from __future__ import annotations

import numpy as np

from petscjam.base.compiled import BATCH, FAST, call, njit, prange
from petscjam.geometry.neighbours import CHUNK
from petscjam.preparation.records import Forces, Step


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _repulsion(overlap, k, exponent, U, dU):
    """Return the force of a pair, and ``exponent`` times its energy."""
    if dU is None:
        f = k * overlap ** (exponent - 1)
        return f, f * overlap
    if overlap == 0.0:
        return 0.0, 0.0
    return k * call(dU, k * overlap), call(U, k * overlap)


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _add_chunk(chunk, x, pairs, exponent, compiled, out, sums):
    """Add the pairs of a chunk, in batches, because the middle loop vectorises: a quarter faster."""
    i, j, sigma, k, U, dU = pairs.i, pairs.j, pairs.sigma, pairs.k, compiled.U, compiled.dU
    energy = xx = xy = yy = 0.0
    r = np.empty(BATCH, dtype=np.complex128)
    out[chunk * CHUNK : (chunk + 1) * CHUNK] = 0.0
    end = pairs.chunks[chunk + 1]
    for first in range(pairs.chunks[chunk], end, BATCH):
        last = min(first + BATCH, end)
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
                f, u = _repulsion(overlap, stiff[c], exponent, U, dU)
                fx, fy = f / distance * dx, f / distance * dy
                r[c] = complex(fx, fy)
                energy += u
                xx, xy, yy = xx + fx * dx, xy + fx * dy, yy + fy * dy
        for c in range(last - first):
            out[one[c]] += r[c]
            out[two[c]] -= r[c]
    sums[chunk, 0], sums[chunk, 1], sums[chunk, 2], sums[chunk, 3] = energy / exponent, xx, xy, yy


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _add_rest(x, pairs, image, exponent, compiled, out, sums):
    """Add the pairs of two chunks, or of a disk and an image."""
    i, j, sigma, k, first = pairs.i, pairs.j, pairs.sigma, pairs.k, pairs.chunks[-1]
    U, dU = compiled.U, compiled.dU
    energy = xx = xy = yy = 0.0
    for rest in range(len(image)):
        a, b = i[first + rest], j[first + rest]
        r = x[b] - x[a] + image[rest]
        dx, dy = r.real, r.imag
        distance = np.sqrt(dx * dx + dy * dy)
        overlap = max(sigma[first + rest] - distance, 0.0)
        f, u = _repulsion(overlap, k[first + rest], exponent, U, dU)
        fx, fy = f / distance * dx, f / distance * dy
        energy += u
        xx, xy, yy = xx + fx * dx, xy + fx * dy, yy + fy * dy
        out[a] += complex(fx, fy)
        out[b] -= complex(fx, fy)
    sums[-1, 0], sums[-1, 1], sums[-1, 2], sums[-1, 3] = energy / exponent, xx, xy, yy


@njit(cache=True)
def gradient(x, pairs, image, exponent, compiled, out, sums):
    """Add up the elastic energy U and its gradient.

    Parameters
    ----------
    x : (n,) complex
    pairs : NeighbourList
    image : (C − chunks[R],) complex
        Its lattice translations in the cell of ``x``.
    exponent : float
    compiled : Compiled
    out : (n,) complex
        Overwritten with dU/dx.
    sums : (R + 1, 4)
        As in :class:`System`.
    """
    for chunk in range(len(pairs.chunks) - 1):
        _add_chunk(chunk, x, pairs, exponent, compiled, out, sums)
    _add_rest(x, pairs, image, exponent, compiled, out, sums)


@njit(cache=True, parallel=True)
def _gradient_threaded(x, pairs, image, exponent, compiled, out, sums):
    """Do what :func:`gradient` does, with the chunks distributed over threads."""
    for chunk in prange(len(pairs.chunks) - 1):
        _add_chunk(chunk, x, pairs, exponent, compiled, out, sums)
    _add_rest(x, pairs, image, exponent, compiled, out, sums)


@njit(cache=True, fastmath=FAST)
def _map(x, F, out):
    """Set ``out`` (N,) complex to F·x."""
    for a in range(len(x)):
        X, Y = x[a].real, x[a].imag
        out[a] = complex(F[0, 0] * X + F[0, 1] * Y, F[1, 0] * X + F[1, 1] * Y)


@njit(cache=True)
def _deformation(z, n, cell):
    """Return F = 1 + Σ e_s E_s, where w e_s = z[2n + s]."""
    F = np.eye(2)
    for s in range(len(cell.directions)):
        F += z[2 * n + s] / cell.weight * cell.directions[s]
    return F


@njit(cache=True)
def evaluate(z, system, g):
    """Evaluate H = U + pV and its gradient.

    Parameters
    ----------
    z : (2n + S,)
        As in :class:`petscjam.preparation.minimise.Enthalpy`.
    system : System
    g : (2n + S,)
        Overwritten with dH/dz.

    Returns
    -------
    Forces
    """
    n, cell, pairs, exponent, compiled, threads, true, sums = system
    strains, weight, target, area = cell
    x, forces = z[: 2 * n].view(np.complex128), g[: 2 * n].view(np.complex128)
    F, image = _deformation(z, n, cell), pairs.image
    if len(strains) > 0:
        _map(x, F, true)
        x, there = true, np.empty_like(image)
        _map(image, F, there)
        image = there
    if threads:
        _gradient_threaded(x, pairs, image, exponent, compiled, forces, sums)
    else:
        gradient(x, pairs, image, exponent, compiled, forces, sums)
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
    return Forces(force, energy, np.array([xx, xy, yy]) / area)


@njit(cache=True, fastmath=FAST)
def _inner_chunk(chunk, n, g, v, found):
    gg = gv = vv = most = 0.0
    for a in range(chunk * CHUNK, min(n, (chunk + 1) * CHUNK)):
        gx, gy, vx, vy = g[2 * a], g[2 * a + 1], v[2 * a], v[2 * a + 1]
        size = gx * gx + gy * gy
        gg += size
        gv += gx * vx + gy * vy
        vv += vx * vx + vy * vy
        most = max(most, size)
    found[chunk, 0], found[chunk, 1], found[chunk, 2], found[chunk, 3] = gg, gv, vv, most


@njit(cache=True, fastmath=FAST)
def _advance_chunk(chunk, z, v, g, step, built, n, found):
    keep, push, time = step
    fastest = farthest = 0.0
    for a in range(chunk * CHUNK, min(n, (chunk + 1) * CHUNK)):
        vx = keep * v[2 * a] - push * g[2 * a]
        vy = keep * v[2 * a + 1] - push * g[2 * a + 1]
        x, y = z[2 * a] + time * vx, z[2 * a + 1] + time * vy
        v[2 * a], v[2 * a + 1], z[2 * a], z[2 * a + 1] = vx, vy, x, y
        fastest = max(fastest, vx * vx + vy * vy)
        farthest = max(farthest, (x - built[2 * a]) ** 2 + (y - built[2 * a + 1]) ** 2)
    found[chunk, 0], found[chunk, 1] = fastest, farthest


@njit(cache=True)
def _inner_products(n, g, v, threads):
    """Return g·g, g·v, v·v, and the largest gradient on a disk or a strain."""
    found = np.empty(((n + CHUNK - 1) // CHUNK, 4))
    if threads:
        _inner_threaded(n, g, v, found)
    else:
        for chunk in range(len(found)):
            _inner_chunk(chunk, n, g, v, found)
    gg, gv, vv, most = found[:, 0].sum(), found[:, 1].sum(), found[:, 2].sum(), found[:, 3].max()
    for s in range(2 * n, len(g)):
        gg, gv, vv = gg + g[s] ** 2, gv + g[s] * v[s], vv + v[s] ** 2
        most = max(most, g[s] ** 2)
    return gg, gv, vv, np.sqrt(most)


@njit(cache=True, parallel=True)
def _inner_threaded(n, g, v, found):
    for chunk in prange(len(found)):
        _inner_chunk(chunk, n, g, v, found)


@njit(cache=True)
def _advance(z, v, g, step, system):
    """Take a :class:`Step`; return the largest velocity, and the largest displacement since the list was built."""
    n, built, threads = system.n, system.pairs.built, system.threads
    found = np.empty(((n + CHUNK - 1) // CHUNK, 2))
    if threads:
        _advance_threaded(z, v, g, step, built, n, found)
    else:
        for chunk in range(len(found)):
            _advance_chunk(chunk, z, v, g, step, built, n, found)
    fastest = found[:, 0].max()
    for s in range(2 * n, len(z)):
        v[s] = step.keep * v[s] - step.push * g[s]
        z[s] += step.time * v[s]
        fastest = max(fastest, v[s] ** 2)
    return np.sqrt(fastest), np.sqrt(found[:, 1].max())


@njit(cache=True, parallel=True)
def _advance_threaded(z, v, g, step, built, n, found):
    for chunk in prange(len(found)):
        _advance_chunk(chunk, z, v, g, step, built, n, found)


@njit(cache=True)
def stale(moved, z, pairs, cell):
    """Return whether a pair that is not in the list may touch at ``z``.

    Only non-affine motion counts: F·F_built⁻¹ shrinks the distance of a pair by at most its smallest singular
    value.

    Parameters
    ----------
    moved : float
        Largest non-affine displacement of a disk since the list was made.
    z : (2n + S,)
    pairs : NeighbourList
    cell : CellStrains
    """
    skin = pairs.skin
    n = (len(z) - len(cell.directions)) // 2
    if len(cell.directions) == 0:
        return 2 * moved >= skin
    F, F0 = _deformation(z, n, cell), _deformation(pairs.built, n, cell)
    ratio = np.linalg.svd(F @ np.linalg.inv(F0))[1][1]
    stretch = np.linalg.svd(F)[1][0]
    return 2 * stretch * moved >= ratio * skin - max(1 - ratio, 0.0) * pairs.largest


@njit(cache=True, fastmath=FAST)
def _largest_square(vectors):
    """Largest |v|² of ``vectors`` (N,) complex."""
    most = 0.0
    for v in vectors:
        most = max(most, v.real * v.real + v.imag * v.imag)
    return most


@njit(cache=True, fastmath=FAST)
def farthest(n, z, built):
    """Return the largest displacement of a disk.

    Parameters
    ----------
    n : int
        Number of disks.
    z, built : (2n + S,)
    """
    most = 0.0
    for a in range(n):
        most = max(most, (z[2 * a] - built[2 * a]) ** 2 + (z[2 * a + 1] - built[2 * a + 1]) ** 2)
    return np.sqrt(most)


@njit(cache=True)
def stress_error(stress, cell):
    """Return the largest error of the relaxed part of the stress: of the pressure, or of the pressure tensor.

    Parameters
    ----------
    stress : (3,)
        xx, xy, yy.
    cell : CellStrains
    """
    xx, xy, yy = stress
    target = cell.pressure
    if len(cell.directions) == 0:
        return 0.0
    if len(cell.directions) == 1:
        return abs((xx + yy) / 2 - target)
    return max(abs(xx - target), abs(yy - target), abs(xy))


@njit(cache=True)
def reached(now, cell, goal):
    """Return whether forces and stress meet the goal.

    Parameters
    ----------
    now : Forces
    cell : CellStrains
    goal : Goal
    """
    pressure = (now.stress[0] + now.stress[2]) / 2
    return now.force <= max(goal.force, goal.relative * pressure) and stress_error(now.stress, cell) <= goal.stress


@njit(cache=True)
def fire(z, g, v, state, now, goal, bounds, system):
    """Take steps of FIRE until the goal is reached, the list is invalid, or the gradients are used up.

    ``z``, ``v`` and ``state`` change in place, and ``g`` unless the list is invalid (Bitzek et al., Phys. Rev.
    Lett. 97, 170201).

    Parameters
    ----------
    z, g, v : (2n + S,)
        Point, gradient and velocity.
    state : (4,)
        Time step, mixing, steps downhill, largest velocity.
    now : Forces
        At z.
    goal : Goal
    bounds : Bounds
    system : System

    Returns
    -------
    taken : int
        Gradients evaluated.
    fresh : bool
        Whether g is the gradient at z.
    now : Forces
    """
    n, cell, pairs, threads = system.n, system.cell, system.pairs, system.threads
    gg, gv, vv, most = _inner_products(n, g, v, threads)
    for taken in range(bounds.gradients):
        if reached(now, cell, goal):
            return taken, True, now
        if gv < 0:
            keep, push = 1 - state[1], state[1] * np.sqrt(vv / gg)
            state[2] += 1
            if state[2] > 5:
                state[0], state[1] = 1.1 * state[0], 0.99 * state[1]
        else:
            keep = push = 0.0
            state[0], state[1], state[2] = 0.5 * state[0], 0.1, 0.0
        state[0] = min(state[0], bounds.time)
        push += state[0]
        time = min(state[0], bounds.displacement / (keep * state[3] + push * most))
        state[3], moved = _advance(z, v, g, Step(keep, push, time), system)
        if stale(moved, z, pairs, cell):
            return taken, False, now
        now = evaluate(z, system, g)
        gg, gv, vv, most = _inner_products(n, g, v, threads)
    return bounds.gradients, True, now


@njit(cache=True, fastmath=FAST)
def _along(z, d, step, trial, built, n):
    """Set ``trial`` to z + step·d; return the largest displacement of a disk since ``built``."""
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
    """Move z and g to the trial point, update d by Polak–Ribière+; return the slope along d, and max |d|."""
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
def conjugate_gradients(line, state, now, goal, gradients, limit, system):
    """Take steps of Polak–Ribière+ conjugate gradients until the goal, an invalid list, or ``gradients``.

    A line search with secants ends when the slope of H along d is within 5 % of zero; with a larger tolerance
    more gradients are needed at low pressure, with a smaller one not fewer. Only gradients are compared, because
    energies have a resolution of only √ε in the position along the line. ``line`` and ``state`` change in place.

    Parameters
    ----------
    line : Line
    state : (8,)
        Slope at z, step, bracket (low, slope, high, slope), largest step, and number of trials.
    now : Forces
        At z.
    goal : Goal
    gradients : int
        Largest number of gradients.
    limit : float
        Largest displacement of a step.
    system : System

    Returns
    -------
    taken : int
        Gradients evaluated.
    now : Forces
        At z.
    """
    z, g, d, trial, g_trial = line
    n, cell, pairs = system.n, system.cell, system.pairs
    for taken in range(gradients):
        moved = _along(z, d, state[1], trial, pairs.built, n)
        if stale(moved, trial, pairs, cell):
            return taken, now
        there = evaluate(trial, system, g_trial)
        slope, step = _dot(g_trial, d), state[1]
        state[7] += 1
        if abs(slope) <= -0.05 * state[0] or (slope < 0 and step >= state[6]) or state[7] == 20:
            now = there
            state[0], most = _turn(z, g, d, trial, g_trial)
            state[6] = limit / most
            state[1] = min(step, state[6])
            state[2], state[3], state[4], state[5], state[7] = 0.0, state[0], np.inf, np.inf, 0.0
            if reached(now, cell, goal):
                return taken + 1, now
        elif slope > 0 or state[4] < np.inf:
            if slope > 0:
                state[4], state[5] = step, slope
            else:
                state[2], state[3] = step, slope
            state[1] = state[2] + (state[4] - state[2]) * state[3] / (state[3] - state[5])
        else:
            zero = step + (step - state[2]) * slope / (state[3] - slope) if slope > state[3] else np.inf
            state[1], state[2], state[3] = min(zero, 4 * step, state[6]), step, slope
    return gradients, now
