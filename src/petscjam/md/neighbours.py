"""The list of pairs that may touch before the next build, by :func:`petscjam.geometry.neighbours.find`.

Disks are sorted in space. Pairs inside a chunk of them come first and need no image; the others come last,
with the image (nx, ny) of the second disk. So chunks are independent: sums do not depend on their threads.

Between two builds coordinates are not wrapped into the cell. A list is valid as long as twice the largest
non-affine displacement, plus the approach by shear, is less than the skin.

Axes: i, j disks of pair c; columns of q: x, y, vx, vy, and the surface speed Rθ̇.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from petscjam.base.compiled import njit
from petscjam.base.types import Array, Integers
from petscjam.geometry.neighbours import find


class Pairs(NamedTuple):
    """Pairs in the order of their first disk, those inside chunks first.

    Attributes
    ----------
    i, j : (C,) uint32
    inverse : (C,)
        1/(Ri + Rj).
    touching : (C,) uint8
    since : (C,) int64
        Tick at which the contact was made.
    chunks : (number of chunks + 1,) int64
        Where the pairs of each chunk begin; those after the last are pairs of two chunks or with an image.
    nx, ny : int64
        Images of these.
    length, height, aspect : float
        Lx, Ly, and Ly/Lx.
    strain, skin : float
        γ at the build, and largest gap between the disks of a pair.
    """

    i: NDArray[np.uint32]
    j: NDArray[np.uint32]
    inverse: Array
    touching: NDArray[np.uint8]
    since: NDArray[np.int64]
    chunks: NDArray[np.int64]
    nx: NDArray[np.int64]
    ny: NDArray[np.int64]
    length: float
    height: float
    aspect: float
    strain: float
    skin: float


@njit(cache=True, error_model="numpy")
def wrap(q: Array, length: float, height: float, strain: float, rate: float) -> None:
    """Move every disk to its image with 0 ≤ x < Lx and 0 ≤ y < Ly, with the velocity of that image.

    Parameters
    ----------
    q : (N, ≥ 3)
        Overwritten.
    length, height : float
        Lx and Ly.
    strain, rate : float
        γ and γ̇.
    """
    for a in range(len(q)):
        row = np.floor(q[a, 1] / height)
        q[a, 1] -= row * height
        if q[a, 1] >= height:  # rounding
            row += 1
            q[a, 1] = 0.0
        q[a, 0] -= row * strain * height
        q[a, 2] -= row * rate * height
        q[a, 0] -= np.floor(q[a, 0] / length) * length
        if q[a, 0] >= length:
            q[a, 0] = 0.0


@njit(cache=True, error_model="numpy")
def order_in_space(q: Array, length: float, height: float) -> Integers:
    """Return the stable order of disks by bins, about one for each disk and about square, row by row.

    Parameters
    ----------
    q : (N, ≥ 2)
        With 0 ≤ x < Lx and 0 ≤ y < Ly.
    length, height : float
        Lx and Ly.

    Returns
    -------
    (N,)
    """
    n = len(q)
    across, along = max(int(np.sqrt(n * (length / height))), 1), max(int(np.sqrt(n * (height / length))), 1)
    bin, order = np.empty(n, np.int64), np.empty(n, np.int64)
    fill = np.zeros(across * along + 1, np.int64)
    for a in range(n):
        column, row = min(int(q[a, 0] / length * across), across - 1), min(int(q[a, 1] / height * along), along - 1)
        bin[a] = row * across + column
        fill[bin[a] + 1] += 1
    fill = np.cumsum(fill)
    for a in range(n):
        order[fill[bin[a]]] = a
        fill[bin[a]] += 1
    return order


@njit(cache=True, error_model="numpy")
def list_pairs(x: Array, R: Array, length: float, height: float, strain: float, skin: float) -> Pairs:
    """List the pairs of disks closer than Ri + Rj + ``skin``.

    Parameters
    ----------
    x : (N, 2)
        Sorted, with 0 ≤ x < Lx and 0 ≤ y < Ly.
    R : (N,)
    length, height, strain, skin : float
    """
    aspect = height / length
    turns = np.rint(strain * aspect)
    lattice = np.zeros((2, 2))
    lattice[0, 0], lattice[1, 1] = length, height
    lattice[1, 0] = (strain * aspect - turns) * length
    i, j, chunks, images = find(x, lattice, R, skin)
    inverse = np.empty(len(i))
    for c in range(len(i)):
        inverse[c] = 1.0 / (R[i[c]] + R[j[c]])
    nx, ny = np.empty(len(images), np.int64), np.empty(len(images), np.int64)
    for c in range(len(images)):
        nx[c], ny[c] = images[c, 0] - int(turns) * images[c, 1], images[c, 1]
    touching, since = np.zeros(len(i), np.uint8), np.zeros(len(i), np.int64)
    return Pairs(i, j, inverse, touching, since, chunks, nx, ny, length, height, aspect, strain, skin)


@njit(cache=True)
def open_contacts(pairs: Pairs, tag: Integers) -> Integers:
    """Return the disks, by tag, of touching pairs, and the tick of their contact.

    Parameters
    ----------
    pairs : Pairs
    tag : (N,)
        Number of each disk in the first state.

    Returns
    -------
    (C, 3)
    """
    found = np.empty((len(pairs.i), 3), np.int64)
    n = 0
    for c in range(len(pairs.i)):
        if pairs.touching[c]:
            found[n, 0], found[n, 1] = tag[pairs.i[c]], tag[pairs.j[c]]
            found[n, 2] = pairs.since[c]
            n += 1
    return found[:n].copy()


@njit(cache=True)
def mark(pairs: Pairs, tag: Integers, contacts: Integers) -> int:
    """Mark ``contacts`` of :func:`open_contacts` in a new list; return the number that is not in it.

    Parameters
    ----------
    pairs : Pairs
        Its ``touching`` and ``since`` are overwritten.
    tag : (N,)
    contacts : (C, 3)
    """
    n = len(tag)
    place = np.empty(n, np.int64)
    for a in range(n):
        place[tag[a]] = a
    total, inside = len(pairs.i), pairs.chunks[-1]
    first = np.full((2, n), total, np.int64)  # first pair of each disk: inside chunks, and of the rest
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
