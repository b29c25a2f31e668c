"""The pair search: against loops over images and another program, and what it looks at."""

from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from test_geometry import boxes, seeds, sheared_by_whole_vectors

from petscjam.base.errors import InputError
from petscjam.geometry.box import Box
from petscjam.geometry.neighbours import CHUNK, _grids, _list, find, pairs
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.packing import Packing

skins = st.one_of(st.just(0.0), st.floats(1e-3, 0.3))


def pairs_by_loops(box, positions, radii, skin):
    """Every pair (i, j, r), i < j, and half of the pairs of a disk with its own images.

    Pairs just at the end of their reach, where rounding decides, spoil the example.
    """
    found = []
    shifts = np.array(list(product(range(-12, 13), repeat=2)))
    ahead = np.array([tuple(shift) > (0, 0) for shift in shifts])
    for i, j in product(range(len(positions)), repeat=2):
        r = positions[j] - positions[i] + shifts @ box.cell
        gap = np.hypot(*r.T) - radii[i] - radii[j] - skin
        assume((abs(gap) > 1e-9).all())
        found += [(i, j, v) for v in r[(gap < 0) & ((i < j) | ((i == j) & ahead))]]
    return found


def disks(box, n, decades, seed):
    """Disks anywhere, also outside the cell; the largest are about as wide as the cell."""
    random = np.random.default_rng(seed)
    return random.uniform(-1, 2, (n, 2)) @ box.cell, 10 ** random.uniform(-decades, 0, n) * random.uniform(0.05, 0.9)


def crowd(n, phi, sizes, seed=1):
    """``n`` disks at random in a square cell of packing fraction ``phi``, sorted by rows; ``sizes`` (n,)."""
    L = float(np.sqrt(np.pi * (sizes**2).sum() / phi))
    x = np.random.default_rng(seed).random((n, 2)) * L
    return x[np.argsort(x[:, 1])], sizes, L


SIZES = {
    "one size": lambda n, random: np.full(n, 0.5),
    "bidisperse": lambda n, random: np.where(random.random(n) < 0.5, 0.5, 0.7),
    "ratio 30": lambda n, random: np.where(random.random(n) < 0.5, 0.5, 15.0),
    "one giant": lambda n, random: np.append(np.full(n - 1, 0.5), 0.25 * n**0.5),
    "one dwarf": lambda n, random: np.append(np.full(n - 1, 0.5), 5e-4),
    "three decades": lambda n, random: 10 ** random.uniform(-3, 0, n),
    "Apollonian": lambda n, random: 1e-3 * random.uniform(1e-4, 1, n) ** (-1 / 1.3),
}


def sizes(name, n):
    return SIZES[name](n, np.random.default_rng(2))


@given(boxes(tilts=2.0), st.integers(1, 5), st.floats(0, 3), skins, seeds)
def test_pairs_are_those_of_loops(box, n, decades, skin, seed):
    """Disks of all sizes, up to twice the cell: two images of a neighbour, and a disk's own images, count."""
    positions, radii = disks(box, n, decades, seed)
    i, j, r = pairs(box, positions, radii, skin)
    loops = pairs_by_loops(box, positions, radii, skin)
    assert len(i) == len(loops)
    for a, b, v in loops:
        distance = np.linalg.norm(r - v, axis=1)
        if a == b:
            distance = np.minimum(distance, np.linalg.norm(r + v, axis=1))
        assert ((i == a) & (j == b) & (distance < 1e-9)).sum() == 1


@given(boxes(), st.integers(-4, 4), seeds)
def test_pairs_do_not_see_a_tilt_by_whole_lattice_vectors(box, n, seed):
    positions, radii = disks(box, 6, 1.0, seed)
    here = pairs(box, positions, radii)
    there = pairs(sheared_by_whole_vectors(box, n), positions, radii)
    assert sorted(np.hypot(*here[2].T)) == pytest.approx(sorted(np.hypot(*there[2].T)), abs=1e-9)


@given(boxes(tilts=2.0), seeds)
def test_pairs_come_in_ascending_order(box, seed):
    i, j, r = pairs(box, *disks(box, 5, 2.0, seed))
    rows = list(zip(i, j, *r.T, strict=True))
    assert rows == sorted(rows)


@given(boxes(tilts=2.0), st.floats(1e-9, 1e9), seeds)
def test_pairs_do_not_depend_on_the_unit_of_length(box, unit, seed):
    positions, radii = disks(box, 5, 2.0, seed)
    here = pairs(box, positions, radii, 0.1)
    there = pairs(Box(unit * box.cell), unit * positions, unit * radii, unit * 0.1)
    assert [x.tolist() for x in here[:2]] == [x.tolist() for x in there[:2]]


@pytest.mark.parametrize("name", SIZES)
def test_large_systems_against_a_periodic_tree(name):
    """Another program: SciPy's tree, asked for one distance, and all that is too far thrown away."""
    n, skin = 2000, 0.02
    x, radii, L = crowd(n, 0.9, sizes(name, n))
    tree = cKDTree(x, boxsize=L)
    close = tree.query_pairs(min(2 * radii.max() + skin, L / 2 - 1e-9), output_type="ndarray")
    d = x[close[:, 1]] - x[close[:, 0]]
    d -= L * np.rint(d / L)
    reach = radii[close].sum(axis=1) + skin
    expected = close[np.hypot(*d.T) <= reach]
    i, j, _ = pairs(Box.square(L), x, radii, skin)
    assert 2 * radii.max() + skin < L / 2  # else the tree would miss images
    assert sorted(zip(i, j, strict=True)) == sorted(map(tuple, expected))


def test_a_disk_meets_two_images_of_its_neighbour():
    i, j, r = pairs(Box.square(1.0), [[0.0, 0.0], [0.5, 0.0]], [0.3, 0.3])
    assert (i.tolist(), j.tolist()) == ([0, 0], [1, 1])
    assert r == pytest.approx(np.array([[-0.5, 0], [0.5, 0]]))


def test_no_pairs_of_small_disks():
    i, j, r = pairs(Box.square(1.0), [[0.0, 0.0], [0.5, 0.5]], [0.05, 0.05])
    assert len(i) == len(j) == len(r) == 0


def test_disks_that_just_touch_are_a_pair():
    i, _, r = pairs(Box.square(8.0), [[0.25, 1.0], [7.5, 1.0]], [0.25, 0.5])
    assert len(i) == 1 and r.tolist() == [[-0.75, 0.0]]


@pytest.mark.parametrize("name", ["bidisperse", "one giant"])
def test_chunks_of_disks_are_apart(name):
    """What is said of the order: threads rely on it."""
    n = 2 * CHUNK + 100
    x, radii, L = crowd(n, 0.9, sizes(name, n))
    i, j, chunks, images = find(x, L * np.eye(2), radii, 0.3)
    inside = chunks[-1]
    assert len(chunks) == 4 and len(images) == len(i) - inside > 0
    for k in range(3):
        own = slice(chunks[k], chunks[k + 1])
        assert (i[own] // CHUNK == k).all() and (j[own] // CHUNK == k).all()
    assert (np.diff(i[:inside].astype(int)) >= 0).all() and (np.diff(i[inside:].astype(int)) >= 0).all()
    alone = (i[inside:] // CHUNK == j[inside:] // CHUNK) & ~images.any(axis=1)
    assert not alone.any()
    image = np.zeros((len(i), 2))
    image[inside:] = images
    r = np.hypot(*(x[j] - x[i] + L * image).T)
    assert (r <= radii[i] + radii[j] + 0.3).all()


class Counted:
    """An array that counts how often it is read."""

    def __init__(self, array):
        self.array, self.reads = array, 0

    def __getitem__(self, index):
        self.reads += 1
        return self.array[index]


@pytest.mark.parametrize("name", SIZES)
def test_few_disks_are_looked_at(name):
    """Whatever the sizes: O(N). Three numbers are read of each."""
    n = 2000
    x, radii, L = crowd(n, 0.9, sizes(name, n))
    cell, width = L * np.eye(2), np.full(2, L)
    grids = _grids(x, cell, np.eye(2) / L, width, radii, 0.0)
    there = Counted(grids.there)
    room = [np.empty((40 * n, 2), np.int64) for _ in range(3)]
    _list.py_func(0, grids._replace(there=there), cell, width, 0.0, *room, 0, 0)
    assert there.reads / 3 < 40 * n
    assert len(grids.start) < 2 * n  # bins


def test_one_giant_among_a_hundred_thousand():
    """Found at once; every pair within two giant radii would be 5e9."""
    n = 100_000
    x, radii, L = crowd(n, 0.8, sizes("one giant", n))
    network = ContactNetwork.of(Packing(x, radii, Box.square(L)))
    around = np.hypot(*Box.square(L).minimum_image(x - x[-1]).T) <= radii + radii[-1]
    around[-1] = False
    mine = (network.i == n - 1) | (network.j == n - 1)
    supported = network.backbone[around].sum()
    assert supported <= mine.sum() <= around.sum() and supported > 100


def test_more_pairs_than_memory_is_refused():
    """Radii in another unit than the cell."""
    x, radii, L = crowd(10_000, 0.9, sizes("bidisperse", 10_000))
    with pytest.raises(InputError, match=r"packing fraction 9e\+05 make about .* same unit of length\?"):
        ContactNetwork.of(Packing(x, 1000 * radii, Box.square(L)))
