"""Which disks may touch before the list is built anew: a cell list over disks that are sorted in space.

Sorted disks are cut into runs of CHUNK. Pairs inside a run come first and need no image; the others, which
join two runs or cross the edge of the cell, come last, with the image (nx, ny) of the second disk. So runs
are independent, and sums do not depend on the number of threads.

Between two builds disks keep their coordinates, wherever they go. A list holds while twice the largest
non-affine displacement, and what the shear brings together, are less than the skin.

Axes: i, j disks of pair c; columns of q: x, y, vx, vy, and the surface speed Rθ̇.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from petscjam.box import Array

CHUNK = 4096


class Pairs(NamedTuple):
    """Pairs in the order of their first disk, runs first.

    Attributes
    ----------
    i, j : (C,) uint32
    inverse : (C,)
        1/(Ri + Rj).
    touching : (C,) uint8
    since : (C,) int64
        Step at which they came to touch.
    runs : (number of runs + 1,) int64
        Where the pairs of each run begin; those after the last join runs or images.
    nx, ny : int64
        Images of these.
    """

    i: NDArray[np.uint32]
    j: NDArray[np.uint32]
    inverse: Array
    touching: NDArray[np.uint8]
    since: NDArray[np.int64]
    runs: NDArray[np.int64]
    nx: NDArray[np.int64]
    ny: NDArray[np.int64]


@njit(cache=True, error_model="numpy")
def wrap(q, L, strain, rate):
    """Move every disk to its image in the square, with the velocity of that image."""
    for a in range(len(q)):
        row = np.floor(q[a, 1] / L)
        q[a, 1] -= row * L
        if q[a, 1] >= L:  # rounding
            row += 1
            q[a, 1] = 0.0
        q[a, 0] -= row * strain * L
        q[a, 2] -= row * rate * L
        q[a, 0] -= np.floor(q[a, 0] / L) * L
        if q[a, 0] >= L:
            q[a, 0] = 0.0


@njit(cache=True, error_model="numpy")
def order_by_cell(q, L, cells):
    """Return the stable order of disks by cell, row by row, and where each cell starts."""
    n = len(q)
    cell, order = np.empty(n, np.int64), np.empty(n, np.int64)
    start = np.zeros(cells * cells + 1, np.int64)
    for a in range(n):
        column, row = min(int(q[a, 0] / L * cells), cells - 1), min(int(q[a, 1] / L * cells), cells - 1)
        cell[a] = row * cells + column
        start[cell[a] + 1] += 1
    start = np.cumsum(start)
    fill = start.copy()
    for a in range(n):
        order[fill[cell[a]]] = a
        fill[cell[a]] += 1
    return order, start


@njit(cache=True, error_model="numpy")
def find_pairs(q, R, L, strain, skin, cells, start):
    """List the pairs of sorted disks closer than Ri + Rj + ``skin``; ``cells`` is at least 3."""
    n = len(q)
    size = 8 * n + 64
    inside = np.empty((size, 2), np.uint32)
    across = np.empty((size, 2), np.uint32)
    images = np.empty((size, 2), np.int64)
    runs = np.zeros((n - 1) // CHUNK + 2, np.int64)
    m = rest = 0
    for row in range(cells):
        for column in range(cells):
            here = row * cells + column
            for a in range(start[here], start[here + 1]):
                if max(m, rest) + n > size:
                    inside = np.concatenate((inside, np.empty_like(inside)))
                    across = np.concatenate((across, np.empty_like(across)))
                    images = np.concatenate((images, np.empty_like(images)))
                    size *= 2
                for up in range(2):
                    over = row + up == cells
                    ny = 1 if over else 0
                    middle = int(np.floor((q[a, 0] - strain * L) / L * cells)) if over else column
                    for side in range(-1 if up else 0, 2):
                        nx = (middle + side) // cells
                        there = (0 if over else row + up) * cells + middle + side - nx * cells
                        for b in range(a + 1 if there == here else start[there], start[there + 1]):
                            dx = q[b, 0] - q[a, 0] + (nx + ny * strain) * L
                            dy = q[b, 1] - q[a, 1] + ny * L
                            reach = R[a] + R[b] + skin
                            if dx * dx + dy * dy < reach * reach:
                                if nx == 0 and ny == 0 and a // CHUNK == b // CHUNK:
                                    inside[m, 0], inside[m, 1] = a, b
                                    m += 1
                                else:
                                    across[rest, 0], across[rest, 1] = a, b
                                    images[rest, 0], images[rest, 1] = nx, ny
                                    rest += 1
                runs[a // CHUNK + 1] = m
    i = np.concatenate((inside[:m, 0], across[:rest, 0]))
    j = np.concatenate((inside[:m, 1], across[:rest, 1]))
    inverse = np.empty(m + rest)
    for c in range(m + rest):
        inverse[c] = 1.0 / (R[i[c]] + R[j[c]])
    touching, since = np.zeros(m + rest, np.uint8), np.zeros(m + rest, np.int64)
    return Pairs(i, j, inverse, touching, since, runs, images[:rest, 0].copy(), images[:rest, 1].copy())


@njit(cache=True)
def open_contacts(pairs, tag):
    """Return the disks, by tag, of the pairs that touch, and since when, (C, 3)."""
    found = np.empty((len(pairs.i), 3), np.int64)
    n = 0
    for c in range(len(pairs.i)):
        if pairs.touching[c]:
            found[n, 0], found[n, 1] = tag[pairs.i[c]], tag[pairs.j[c]]
            found[n, 2] = pairs.since[c]
            n += 1
    return found[:n].copy()


@njit(cache=True)
def mark(pairs, tag, contacts):
    """Mark ``contacts`` of :func:`open_contacts` in a new list; return how many are not in it."""
    n = len(tag)
    place = np.empty(n, np.int64)
    for a in range(n):
        place[tag[a]] = a
    total, inside = len(pairs.i), pairs.runs[-1]
    first = np.full((2, n), total, np.int64)  # where the pairs of a disk begin: inside runs, and the rest
    for c in range(total - 1, -1, -1):
        first[0 if c < inside else 1, pairs.i[c]] = c
    lost = 0
    for k in range(len(contacts)):
        a, b = place[contacts[k, 0]], place[contacts[k, 1]]
        found = False
        for one, two in ((a, b), (b, a)):
            for part in range(2):
                c = first[part, one]
                while c < total and pairs.i[c] == one and not found:
                    if pairs.j[c] == two:
                        pairs.touching[c], pairs.since[c] = 1, contacts[k, 2]
                        found = True
                    c += 1
        lost += not found
    return lost
