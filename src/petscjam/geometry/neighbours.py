"""Search for pairs of neighbouring disks, by size class, in time and memory O(N + pairs).

Disks of about one size (within a factor of two) form a class. Each class has its own grid, with bins about as
wide as its disks, and no more bins than disks. For each disk the search tests the disks of the same class and of
the classes of larger disks, in the bins within its reach: for one giant among many small disks each small disk
tests one or two bins. Bins repeat with the lattice: a disk may have several images of another disk, or its own,
as neighbours.

Axes: i, j disks of pair c, a disk, x Cartesian, l lattice vector.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.base.compiled import njit
from petscjam.base.errors import InputError
from petscjam.base.types import Array, Integers
from petscjam.geometry.box import Box
from petscjam.parallel.memory import available_memory

Indices = NDArray[np.uint32]

CHUNK = 4096  # disks
BYTES = 150  # of memory for each pair, at the peak of ContactNetwork.of


def pairs(box: Box, positions: ArrayLike, radii: ArrayLike, skin: float = 0.0) -> tuple[Integers, Integers, Array]:
    """Find every pair of disks, and of a disk and an image, with r ≤ ρi + ρj + ``skin``.

    Parameters
    ----------
    box : Box
        It may be so small that a disk touches two images of another disk, or its own.
    positions : (N, 2)
        Any periodic images.
    radii : (N,)
        Above 0.
    skin : float

    Returns
    -------
    i, j : (C,)
        Disks of each pair, ascending; ``i < j``, or ``i == j`` for a disk and its own image.
    r : (C, 2)
        Vector from i to that image of j, ascending for each i and j.

    Raises
    ------
    InputError
        If there is not enough memory for the pairs.
    """
    x, radii = np.array(positions, dtype=float, order="C"), np.array(radii, dtype=float)
    check_memory(box, radii, skin)
    lattice = np.array(box.reduced)
    rounding = 1e-12 * np.abs(lattice).max()
    i, j, chunks, images = find(x, lattice, radii, skin + rounding)
    image = np.zeros((len(i), 2))
    image[chunks[-1] :] = images
    back = (i > j) | ((i == j) & ((image[:, 0] < 0) | ((image[:, 0] == 0) & (image[:, 1] < 0))))
    image[back] *= -1
    i, j = np.where(back, j, i).astype(np.int64), np.where(back, i, j).astype(np.int64)
    r = x[j] - x[i] + image @ lattice
    near = np.hypot(r[:, 0], r[:, 1]) <= radii[i] + radii[j] + skin
    i, j, r = i[near], j[near], r[near]
    order = np.lexsort((r[:, 1], r[:, 0], j, i))
    return i[order], j[order], r[order]


def expected_pairs(box: Box, radii: Array, skin: float) -> float:
    """Return ½ Σij π (ρi + ρj + skin)²/V, the number of pairs, images included, of disks at random positions.

    Parameters
    ----------
    box : Box
    radii : (N,)
        ρ.
    skin : float
    """
    n, reach = float(len(radii)), radii + skin / 2
    return float(np.pi * (n * (reach**2).sum() + reach.sum() ** 2) / box.area)


def check_memory(box: Box, radii: Array, skin: float) -> None:
    """Raise an InputError if there is not enough memory for the pairs of disks at random positions.

    Parameters
    ----------
    box : Box
    radii : (N,)
    skin : float

    Raises
    ------
    InputError
        It names the packing fraction and the memory, in MB.
    """
    count = expected_pairs(box, radii, skin)
    need = count * BYTES / 2**20
    if need > 100 and need > available_memory():
        raise InputError(
            f"packing: {len(radii)} disks of packing fraction {np.pi * (radii**2).sum() / box.area:.3g} make "
            f"about {count:.1e} pairs, which need {need:.0f} MB, {available_memory():.0f} MB are free; "
            "are the radii and the cell in the same unit of length?"
        )


class Grids(NamedTuple):
    """Size classes, from small to large; the grid of each; and the disks, in the order of their bins.

    Attributes
    ----------
    kind : (N,)
        Class of each disk.
    largest : (classes,)
        Radius.
    bins : (classes, 2)
        Number along each lattice vector; the bins of all classes are numbered consecutively, row by row.
    first : (classes + 1,)
        Number of the first of each class.
    start : (bins + 1,)
        Where the disks of each bin begin in ``disk`` and ``there``.
    disk : (N,)
    there : (N, 3)
        Its image in the cell, and its radius.
    place : (N,)
        Of each disk in ``disk``.
    home : (N, 2)
        Column and row of its bin.
    s : (N, 2)
        Its image in the cell, in units of the lattice vectors.
    cell : (N, 2)
        The cell that contains the disk itself.
    """

    kind: Integers
    largest: Array
    bins: Integers
    first: Integers
    start: Integers
    disk: Integers
    there: Array
    place: Integers
    home: Integers
    s: Array
    cell: Integers


@njit(cache=True, error_model="numpy")
def _classes(radii: Array) -> tuple[Integers, Integers, Array]:
    """Return the class of each disk, by octaves of its radius, and the number and largest radius of each."""
    smallest, widest = np.inf, 0.0
    for radius in radii:
        smallest, widest = min(smallest, radius), max(widest, radius)
    number = np.zeros(int(np.log2(widest / smallest)) + 1, np.int64)
    kind = np.empty(len(radii), np.int64)
    for a in range(len(radii)):
        kind[a] = int(np.log2(radii[a] / smallest))
        number[kind[a]] = 1
    classes = 0
    for octave in range(len(number)):
        classes += number[octave]
        number[octave] = classes - 1
    count, largest = np.zeros(classes, np.int64), np.zeros(classes)
    for a in range(len(radii)):
        c = kind[a] = number[kind[a]]
        count[c] += 1
        largest[c] = max(largest[c], radii[a])
    return kind, count, largest


@njit(cache=True, error_model="numpy")
def _grids(x: Array, lattice: Array, inverse: Array, width: Array, radii: Array, skin: float) -> Grids:
    """Sort the disks into the bins of their classes."""
    n = len(x)
    kind, count, largest = _classes(radii)
    bins, first = np.empty((len(count), 2), np.int64), np.zeros(len(count) + 1, np.int64)
    for c in range(len(count)):
        edge = max(largest[c] + skin / 2, np.sqrt(width[0] * width[1] / count[c]))
        for axis in range(2):
            bins[c, axis] = min(max(width[axis] / edge, 1), count[c])
        first[c + 1] = first[c] + bins[c, 0] * bins[c, 1]
    s, cell = np.empty((n, 2)), np.empty((n, 2), np.int64)
    home, place = np.empty((n, 2), np.int64), np.empty(n, np.int64)
    start = np.zeros(first[-1] + 1, np.int64)
    for a in range(n):
        c = kind[a]
        for axis in range(2):
            u = x[a, 0] * inverse[0, axis] + x[a, 1] * inverse[1, axis]
            cell[a, axis] = np.floor(u)
            s[a, axis] = u - cell[a, axis]
            home[a, axis] = min(int(s[a, axis] * bins[c, axis]), bins[c, axis] - 1)
        place[a] = first[c] + home[a, 1] * bins[c, 0] + home[a, 0]
        start[place[a] + 1] += 1
    fill = np.empty(len(start), np.int64)
    for k in range(len(start)):
        start[k] += start[k - 1] if k > 0 else 0
        fill[k] = start[k]
    disk, there = np.empty(n, np.int64), np.empty((n, 3))
    for a in range(n):
        k = fill[place[a]]
        fill[place[a]] += 1
        place[a], disk[k] = k, a
        for axis in range(2):
            there[k, axis] = s[a, 0] * lattice[0, axis] + s[a, 1] * lattice[1, axis]
        there[k, 2] = radii[a]
    return Grids(kind, largest, bins, first, start, disk, there, place, home, s, cell)


@njit(cache=True, error_model="numpy")
def _list(
    a: int,
    g: Grids,
    lattice: Array,
    width: Array,
    skin: float,
    inside: Indices,
    across: Indices,
    images: Integers,
    m: int,
    rest: int,
) -> tuple[int, int, int]:
    """Add the pairs of disks from ``a`` on to the ``m`` inside chunks and to the others, ``rest``.

    Return the disk at which the arrays are full (N: not full), and both numbers before this disk. If the arrays
    grew in this loop, numba would count references to them: three times as slow.
    """
    kind, largest, bins, first, start, disk, there, place, home, s, cell = g
    while a < len(disk):
        found, others = m, rest
        X, Y, R = there[place[a], 0], there[place[a], 1], there[place[a], 2] + skin
        for c in range(kind[a], len(largest)):
            nx, ny = bins[c, 0], bins[c, 1]
            u, v, reach = s[a, 0] * nx, s[a, 1] * ny, (R + largest[c]) * (1 + 1e-12)
            left, right = int(np.floor(u - reach / width[0] * nx)), int(np.floor(u + reach / width[0] * nx))
            low, high = int(np.floor(v - reach / width[1] * ny)), int(np.floor(v + reach / width[1] * ny))
            own = c == kind[a]  # half of the bins are sufficient
            for row in range(home[a, 1] if own else low, high + 1):
                iy = int(np.floor(row / ny))
                at_home = own and row == home[a, 1]
                column = home[a, 0] if at_home else left
                while column <= right:
                    ix = int(np.floor(column / nx))
                    last = min(right, ix * nx + nx - 1)
                    base = first[c] + (row - iy * ny) * nx - ix * nx
                    begin, end = start[base + column], start[base + last + 1]
                    if at_home and column == home[a, 0]:
                        begin = place[a] + 1
                    if found + end - begin > len(inside) or others + end - begin > len(across):
                        return a, m, rest
                    dx0 = ix * lattice[0, 0] + iy * lattice[1, 0] - X
                    dy0 = ix * lattice[0, 1] + iy * lattice[1, 1] - Y
                    for k in range(begin, end):
                        dx, dy, sigma = there[k, 0] + dx0, there[k, 1] + dy0, there[k, 2] + R
                        if dx * dx + dy * dy <= sigma * sigma:
                            b = disk[k]
                            mx, my = ix + cell[a, 0] - cell[b, 0], iy + cell[a, 1] - cell[b, 1]
                            if mx == 0 and my == 0 and a // CHUNK == b // CHUNK:
                                inside[found, 0], inside[found, 1] = a, b
                                found += 1
                            else:
                                across[others, 0], across[others, 1] = a, b
                                images[others, 0], images[others, 1] = mx, my
                                others += 1
                    column = last + 1
        m, rest = found, others
        a += 1
    return a, m, rest


@njit(cache=True, error_model="numpy")
def _longer(old: NDArray[Any], used: int) -> NDArray[Any]:
    """Return an array with the ``used`` rows of ``old`` and twice its length."""
    new = np.empty((2 * len(old), old.shape[1]), old.dtype)
    for k in range(used):
        for column in range(old.shape[1]):
            new[k, column] = old[k, column]
    return new


@njit(cache=True, error_model="numpy")
def find(x: Array, lattice: Array, radii: Array, skin: float) -> tuple[Indices, Indices, Integers, Integers]:
    """List the pairs with r ≤ ρi + ρj + ``skin``, each once, the first disk not of a larger class.

    Disks are cut into chunks of CHUNK. Pairs inside a chunk that need no image come first, then the others, both
    in the order of their first disk: sums chunk by chunk do not depend on the number of threads.

    Parameters
    ----------
    x : (N, 2)
        The search is faster if they are sorted in space.
    lattice : (2, 2)
        Rows are lattice vectors, preferably the shortest (:attr:`petscjam.geometry.box.Box.reduced`).
    radii : (N,)
    skin : float

    Returns
    -------
    i, j : (C,) uint32
    chunks : (number of chunks + 1,)
        Where the pairs of each chunk begin, and the others.
    images : (C − chunks[-1], 2) integers
        Of the second disk of these: r = x_j − x_i + images·lattice.
    """
    n = len(x)
    inverse, width = np.empty((2, 2)), np.empty(2)  # of the cell, across the other lattice vector
    det = lattice[0, 0] * lattice[1, 1] - lattice[0, 1] * lattice[1, 0]
    for axis in range(2):
        inverse[axis, axis] = lattice[1 - axis, 1 - axis] / det
        inverse[axis, 1 - axis] = -lattice[axis, 1 - axis] / det
    for axis in range(2):
        width[axis] = 1 / np.hypot(inverse[0, axis], inverse[1, axis])
    grids = _grids(x, lattice, inverse, width, radii, skin)
    inside, across = np.empty((4 * n + 64, 2), np.uint32), np.empty((n + 64, 2), np.uint32)
    rows = np.empty((n + 64, 2), np.int64)
    a, m, rest = _list(0, grids, lattice, width, skin, inside, across, rows, 0, 0)
    while a < n:
        inside, across, rows = _longer(inside, m), _longer(across, rest), _longer(rows, rest)
        a, m, rest = _list(a, grids, lattice, width, skin, inside, across, rows, m, rest)
    i, j = np.empty(m + rest, np.uint32), np.empty(m + rest, np.uint32)
    chunks, images = np.zeros((n - 1) // CHUNK + 2, np.int64), np.empty((rest, 2), np.int64)
    for c in range(m):
        i[c], j[c] = inside[c, 0], inside[c, 1]
        chunks[i[c] // CHUNK + 1] = c + 1
    for k in range(1, len(chunks)):
        chunks[k] = max(chunks[k], chunks[k - 1])
    for c in range(rest):
        i[m + c], j[m + c] = across[c, 0], across[c, 1]
        images[c, 0], images[c, 1] = rows[c, 0], rows[c, 1]
    return i, j, chunks, images
