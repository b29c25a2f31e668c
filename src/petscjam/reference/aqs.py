"""The slow twin of quasi-static shear: dense Newton steps with the contacts held fixed, in plain loops.

While the contacts do not change, harmonic disks are springs that also pull. So the path of given contacts is smooth,
and the first change of contacts is where a spring has its natural length, or two other disks touch. There K of the
new contacts decides: if it has a negative mode, the path ends at an instability. Written independently of the fast
code, for tests; for harmonic disks without rattlers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from petscjam.reference.linear import Contact, hessian

NEWTON = 20  # steps at most


class Change(NamedTuple):
    """Strain at which disks i and j make (1) or lose (−1) a contact, the stress, and the lowest eigenvalue after."""

    strain: float
    i: int
    j: int
    change: int
    stress: float
    eigenvalue: float


def candidates(n):
    """Return every pair of ``n`` disks with every image of the second: (i, j, a, b)."""
    return [(i, j, a, b) for i in range(n) for j in range(i + 1, n) for a in range(-1, 2) for b in range(-1, 2)]


def springs(x, radii, cell, strain, pairs):
    """Return a contact for each of ``pairs``, whether its disks touch or not; it pulls if they do not.

    Parameters
    ----------
    x : (N, 2)
        Positions.
    radii : (N,)
    cell : (2, 2)
        Rows are lattice vectors at zero strain.
    strain : float
    pairs : list of (i, j, a, b)
    """
    found = []
    for i, j, a, b in pairs:
        shift_y = a * cell[0][1] + b * cell[1][1]
        rx = x[j][0] - x[i][0] + a * cell[0][0] + b * cell[1][0] + strain * shift_y
        ry = x[j][1] - x[i][1] + shift_y
        found.append(Contact(i, j, rx, ry, radii[i] + radii[j] - (rx * rx + ry * ry) ** 0.5, 1.0))
    return found


def lowest_eigenvalue(found, radii):
    """Return the lowest eigenvalue of K_uu without translations.

    Parameters
    ----------
    found : list of contacts
    radii : (N,)
    """
    n2 = 2 * len(radii)
    K = hessian(found, radii)[:n2, :n2]
    size = abs(np.diag(K)).max()
    for e in ([1.0, 0.0], [0.0, 1.0]):
        translation = np.tile(e, len(radii)) / len(radii) ** 0.5
        K = K + 10 * size * np.outer(translation, translation)
    return np.linalg.eigvalsh(K)[0]


def balanced(x, radii, cell, strain, pairs):
    """Return positions at which the springs of ``pairs`` balance, by Newton's method.

    Parameters
    ----------
    x, radii, cell, strain, pairs
        As for :func:`springs`.
    """
    n2 = 2 * len(radii)
    for _ in range(NEWTON):
        found = springs(x, radii, cell, strain, pairs)
        force = np.zeros(n2)
        for c in found:
            r = (c.rx**2 + c.ry**2) ** 0.5
            for sign, disk in ((-1, c.i), (1, c.j)):
                force[2 * disk] += sign * c.force * c.rx / r
                force[2 * disk + 1] += sign * c.force * c.ry / r
        move = np.linalg.lstsq(hessian(found, radii)[:n2, :n2], force, rcond=1e-12)[0]
        x = x + move.reshape(-1, 2)
        if abs(move).max() < 1e-13:
            break
    return x


def stress(found, area):
    """Return σ_xy = −Σ f r_x r_y / (r V).

    Parameters
    ----------
    found : list of contacts
    area : float
    """
    total = 0.0
    for c in found:
        total -= c.force * c.rx * c.ry / (c.rx**2 + c.ry**2) ** 0.5
    return total / area


def sheared(x, radii, cell, old, new, pairs):
    """Return positions in balance at the strain ``new`` from those at ``old``.

    Parameters
    ----------
    x, radii, cell, pairs
        As for :func:`springs`.
    old, new : float
    """
    moved = [[x[i][0] + (new - old) * x[i][1], x[i][1]] for i in range(len(x))]
    return balanced(np.array(moved), radii, cell, new, pairs)


def wrong(x, radii, cell, strain, pairs):
    """Return the pairs whose disks touch though they have no spring, or have one and do not touch.

    Parameters
    ----------
    x, radii, cell, strain, pairs
        As for :func:`springs`.
    """
    everything = candidates(len(radii))
    gaps = springs(x, radii, cell, strain, everything)
    return [pair for pair, c in zip(everything, gaps, strict=True) if (c.force > 0) != (pair in pairs)]


def changes(positions, radii, cell, strain, step):
    """Return every :class:`Change` up to ``strain``, or up to the first instability.

    A change is located by bisection to 1e-12 in strain.

    Parameters
    ----------
    positions : (N, 2)
        In equilibrium, without rattlers, in the cell.
    radii : (N,)
    cell : (2, 2)
        Rows are lattice vectors.
    strain : float
        Of either sign.
    step : float
        Above 0; two changes in one step may be missed.
    """
    area = abs(cell[0][0] * cell[1][1] - cell[0][1] * cell[1][0])
    x, now, found = np.array(positions), 0.0, []
    pairs = wrong(x, radii, cell, now, [])
    while abs(now) < abs(strain):
        goal = now + np.sign(strain) * min(step, abs(strain - now))
        after = sheared(x, radii, cell, now, goal, pairs)
        if not wrong(after, radii, cell, goal, pairs):
            x, now = after, goal
            continue
        while abs(goal - now) > 1e-12:
            middle = (now + goal) / 2
            trial = sheared(x, radii, cell, now, middle, pairs)
            if wrong(trial, radii, cell, middle, pairs):
                after, goal = trial, middle
            else:
                x, now = trial, middle
        ((i, j, a, b),) = wrong(after, radii, cell, goal, pairs)
        change = -1 if (i, j, a, b) in pairs else 1
        force = stress(springs(x, radii, cell, now, pairs), area)
        pairs = sorted({*pairs} ^ {(i, j, a, b)})
        lowest = lowest_eigenvalue(springs(after, radii, cell, goal, pairs), radii)
        found.append(Change(goal, i, j, change, force, lowest))
        x, now = after, goal
        if lowest <= 0:
            break
    return found
