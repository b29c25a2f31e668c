"""The sheared periodic cell and the contact network, against loops and against drawings on paper."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from petscjam.base.errors import InputError
from petscjam.geometry.box import Box
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.packing import Packing
from petscjam.io.importers import import_packing

seeds = st.integers(0, 2**32)


@st.composite
def boxes(draw, tilts=4.0):
    """Rotated, tilted, elongated, left- and right-handed cells of area near 1."""
    angle, tilt, aspect = draw(st.floats(0, 6.3)), draw(st.floats(-tilts, tilts)), draw(st.floats(0.5, 2))
    rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    cell = np.array([[aspect, 0], [tilt, draw(st.sampled_from([-1, 1])) / aspect]])
    return Box(cell @ rotation)


def sheared_by_whole_vectors(box, n):
    """The same lattice, described by another cell."""
    return Box(np.array([[1, 0], [n, 1]]) @ box.cell)


def images(box, count):
    return np.array(list(product(range(-count, count + 1), repeat=2))) @ box.cell


# The cell


@given(boxes(), seeds)
def test_minimum_image_is_the_shortest_of_many(box, seed):
    d = np.random.default_rng(seed).uniform(-1, 1, (5, 2)) @ box.cell
    shortest = [np.linalg.norm(v + images(box, 12), axis=1).min() for v in d]
    assert np.linalg.norm(box.minimum_image(d), axis=1) == pytest.approx(shortest, abs=1e-12)


@given(boxes(), seeds)
def test_minimum_image_differs_by_a_lattice_vector(box, seed):
    d = np.random.default_rng(seed).normal(size=(3, 4, 2))
    steps = box.fractional(box.minimum_image(d) - d)
    assert np.abs(steps - np.rint(steps)).max() < 1e-9


@given(boxes(), st.integers(-5, 5), seeds)
def test_minimum_image_does_not_see_a_tilt_by_whole_lattice_vectors(box, n, seed):
    d = np.random.default_rng(seed).normal(size=(5, 2))
    assert box.minimum_image(d) == pytest.approx(sheared_by_whole_vectors(box, n).minimum_image(d), abs=1e-9)


@given(boxes(tilts=50.0))
def test_reduced_cell_has_the_same_area_and_shortest_vectors(box):
    a, b = box.reduced
    assert abs(a[0] * b[1] - a[1] * b[0]) == pytest.approx(box.area, rel=1e-9)
    assert a @ a <= b @ b * (1 + 1e-9)
    assert abs(a @ b) <= a @ a * (0.5 + 1e-9)


@given(boxes(), seeds)
def test_wrapping_moves_into_the_cell_by_lattice_vectors(box, seed):
    positions = np.random.default_rng(seed).normal(scale=3, size=(5, 2))
    wrapped = box.wrap(positions)
    steps = box.fractional(wrapped - positions)
    assert np.abs(steps - np.rint(steps)).max() < 1e-9
    assert (np.abs(box.fractional(wrapped) - 0.5) <= 0.5 + 1e-9).all()


def test_deforming_a_box_deforms_its_vectors():
    sheared = Box.square(2.0).deformed([[1, 0.3], [0, 1]])
    assert sheared.cell == pytest.approx(np.array([[2, 0], [0.6, 2]]))


@pytest.mark.parametrize(
    ("cell", "message"), [([[1, 2], [2, 4]], "no area"), ([[1, np.inf], [0, 1]], "not finite"), (np.eye(3), "2x2")]
)
def test_bad_cells_are_refused(cell, message):
    with pytest.raises(InputError, match=message):
        Box(cell)


# The contact network


def square_lattice(n, overlap, hole=False):
    """Unit square lattice of n x n equal disks; ``hole`` leaves the site (1, 1) empty."""
    sites = [site for site in product(range(n), repeat=2) if not (hole and site == (1, 1))]
    return Packing(np.array(sites, float), np.full(len(sites), 0.5 + overlap / 2), Box.square(n))


def crowd(seed, n=30):
    """Disks dropped at random: overlapping, out of balance, with rattlers."""
    random = np.random.default_rng(seed)
    box = Box([[5.0, 0.3], [1.7, 4.0]])
    return Packing(random.uniform(size=(n, 2)) @ box.cell, random.uniform(0.4, 0.7, n), box)


def energy(packing):
    network = ContactNetwork.of(packing)
    sigma = packing.radii[network.i] + packing.radii[network.j]
    return packing.potential.energy(network.distance, sigma).sum()


@given(seeds)
def test_forces_balance_in_total(seed):
    assert np.abs(ContactNetwork.of(crowd(seed)).residual_force.sum(0)).max() < 1e-13


def test_residual_force_is_minus_the_gradient_of_the_energy():
    packing, h = crowd(1), 1e-6
    step = np.zeros_like(packing.positions)
    step[7, 1] = h
    up, down = (Packing(packing.positions + s, packing.radii, packing.box) for s in (step, -step))
    force = ContactNetwork.of(packing).residual_force[7, 1]
    assert force == pytest.approx(-(energy(up) - energy(down)) / (2 * h), rel=1e-7)


@pytest.mark.parametrize("x, y", [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_stress_is_minus_the_derivative_of_the_energy_by_the_strain(x, y):
    packing, h = crowd(2), 1e-6

    def strained(amount):
        gradient = np.eye(2)
        gradient[x, y] += amount
        return Packing(packing.positions @ gradient.T, packing.radii, packing.box.deformed(gradient))

    slope = (energy(strained(h)) - energy(strained(-h))) / (2 * h)
    assert ContactNetwork.of(packing).stress[x, y] == pytest.approx(-slope / packing.box.area, rel=1e-6)


def test_a_packing_in_equilibrium_has_no_residual_force():
    packing = import_packing(Path(__file__).parent / "data" / "jambashbulk-N16-P1e-3-0001.txt")
    assert np.abs(ContactNetwork.of(packing).residual_force).max() < 1e-14


def test_square_lattice():
    network = ContactNetwork.of(square_lattice(4, overlap=0.01))
    assert (len(network), network.Z, network.rattlers) == (32, 4.0, 0)
    assert network.stress == pytest.approx(0.01 * np.eye(2), abs=1e-12)
    assert network.force == pytest.approx(0.01, rel=1e-10)
    assert (network.stiffness == 1).all()


def test_one_disk_that_touches_its_own_images():
    network = ContactNetwork.of(Packing([[0.3, 0.2]], [0.5], Box.square(0.9)))
    assert (len(network), network.Z, network.rattlers) == (2, 4.0, 0)
    assert network.stress == pytest.approx(0.1 / 0.9 * np.eye(2))
    assert (network.residual_force == 0).all()


def test_a_packing_repeated_has_the_same_stress_and_coordination():
    packing = crowd(3)
    four = images(packing.box, 1)[[0, 1, 3, 4]]
    repeated = Packing(
        (packing.positions + four[:, None]).reshape(-1, 2), np.tile(packing.radii, 4), Box(2 * packing.box.cell)
    )
    once, often = ContactNetwork.of(packing), ContactNetwork.of(repeated)
    assert (len(often), often.rattlers) == (4 * len(once), 4 * once.rattlers)
    assert often.Z == once.Z
    assert often.stress == pytest.approx(once.stress, rel=1e-10)


def test_rattlers_are_peeled_one_after_the_other():
    """In a hole of the lattice: disk A leans on two neighbours and on B, which touches nothing but A.

    B goes first, which leaves A with two contacts. The lattice around the hole keeps three each.
    """
    lattice = square_lattice(4, overlap=1e-6, hole=True)
    a, b = np.hypot(0.8, 0.2) - 0.5, np.sqrt(2) * 0.4 - np.hypot(0.8, 0.2) + 0.5
    packing = Packing(
        np.vstack([lattice.positions, [[0.8, 0.8], [1.2, 1.2]]]), [*lattice.radii, a + 1e-6, b], lattice.box
    )
    network = ContactNetwork.of(packing)
    contacts = np.bincount(np.concatenate([network.i, network.j]))
    assert contacts[-2:].tolist() == [3, 1]
    assert network.backbone.tolist() == [True] * 15 + [False] * 2
    assert network.rattlers == 2
    assert abs(network.Z - 2 * 28 / 15) < 1e-14
    assert len(network.without_rattlers()) == 28


def test_without_rattlers_no_contacts_are_left():
    pair = Packing([[0, 0], [0.9, 0]], [0.5, 0.5], Box.square(5))
    network = ContactNetwork.of(pair)
    assert (len(network), network.rattlers, network.Z) == (1, 2, 0.0)
    with pytest.raises(InputError, match="no contacts"):
        network.without_rattlers()


def test_no_contacts_at_all():
    network = ContactNetwork.of(Packing([[0, 0], [2, 2]], [0.5, 0.5], Box.square(5)))
    assert (len(network), network.pressure) == (0, 0.0)
    with pytest.raises(InputError, match="no contacts"):
        network.without_rattlers()


def bands(count):
    """Zigzag bands of two rows across the cell, too far apart to touch."""
    rows = [[(k, 4 * band), (k + 0.5, 4 * band + np.sqrt(3) / 2)] for band in range(count) for k in range(4)]
    positions = np.array(rows).reshape(-1, 2)
    return ContactNetwork.of(Packing(positions, np.full(len(positions), 0.501), Box([[4, 0], [0, 4 * count]])))


def test_one_band_holds_together():
    assert len(bands(1).without_rattlers()) == 16


def test_two_bands_are_two_pieces():
    with pytest.raises(InputError, match="2 pieces"):
        bands(2).without_rattlers()


@pytest.mark.parametrize("other", [[1.0, 1.0], [4.0, 1.0], [-2.0, 7.0]])
def test_coinciding_disks_are_named(other):
    with pytest.raises(InputError, match="disks 0 and 2 lie on the same point"):
        ContactNetwork.of(Packing([[1.0, 1.0], [2, 2], other], [0.5, 0.5, 0.5], Box.square(3)))


@pytest.mark.parametrize("fraction", [(0.0, 0.1), (0.3, 0.7), (1 / 3, 0.9)])
def test_coinciding_images_in_a_tilted_cell_are_named(fraction):
    box = Box([[3.1, 0.2], [0.7, 2.9]])
    first = fraction @ box.cell
    with pytest.raises(InputError, match="disks 0 and 1 lie on the same point"):
        ContactNetwork.of(Packing([first, first + 2 * box.cell[0] - box.cell[1]], [0.5, 0.5], box))
