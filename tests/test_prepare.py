"""Packing preparation: targets reached, forces right, unstable modes counted."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from petscjam.box import Box
from petscjam.errors import InputError, SolverError
from petscjam.network import ContactNetwork
from petscjam.packing.certify import certify, hessian, negative_modes
from petscjam.packing.minimise import METHODS, Enthalpy
from petscjam.packing.packing import Packing
from petscjam.packing.prepare import prepare_packing

P = 1e-3
EPS = np.finfo(float).eps
CASES = [
    dict(n=64), dict(n=64, method="fire"), dict(n=256, pressure=1e-4), dict(n=64, pressure=0.1),
    dict(n=64, potential_name="harmonic-relative"), dict(n=65), dict(n=8), dict(n=10),
]  # fmt: skip


def random_disks(n: int, phi: float, seed: int = 5) -> Packing:
    """Disks at random, squeezed so hard that everybody touches: a configuration with many unstable modes."""
    radii = np.where(np.arange(n) < n // 2, 0.5 / 1.2, 0.7 / 1.2)
    box = Box.square(np.sqrt(np.pi * (radii**2).sum() / phi))
    return Packing(np.random.default_rng(seed).random((n, 2)) @ box.cell, radii, box)


def state(packing: Packing, pressure: float | None = None) -> tuple[Enthalpy, np.ndarray]:
    """The enthalpy of a packing and its z, in a reference cell 3 % smaller than the true one."""
    scale = 1.03
    h = Enthalpy(packing.radii, packing.box.cell[0, 0] / scale, pressure)
    return h, np.append(packing.positions / scale, h.weight * np.log(scale))


@pytest.fixture(scope="module", params=CASES, ids=lambda case: " ".join(f"{v}" for v in case.values()))
def prepared(request):
    """A packing, its contact network and the pressure it was asked for."""
    packing = prepare_packing(**{"pressure": P, **request.param})
    return packing, ContactNetwork.of(packing), request.param.get("pressure", P)


def test_pressure_is_the_target(prepared):
    _, network, target = prepared
    assert abs(network.pressure / target - 1) <= 1e-9


def test_forces_balance(prepared):
    packing, network, target = prepared
    residual = np.linalg.norm(network.residual_force, axis=1).max()
    k = network.stiffness.max()
    assert residual <= max(1e-10 * target * packing.mean_diameter, 4 * EPS * k * packing.box.cell[0, 0])


def test_minimum_has_no_negative_modes(prepared):
    packing, _, _ = prepared
    assert packing.certificate.negative_modes == 0


def test_contacts_suffice_for_rigidity(prepared):
    """2n − 2 degrees of freedom and the box need 2n − 1 contacts (Maxwell; Goodrich et al. 2012)."""
    _, network, _ = prepared
    n = network.backbone.sum()
    assert network.Z * n / 2 >= 2 * n - 1


def test_certificate_repeats_the_network(prepared):
    packing, network, target = prepared
    c = packing.certificate
    expected = network.rattlers, network.Z, network.pressure, abs(network.pressure / target - 1), None
    assert (c.rattlers, c.Z, c.pressure, c.pressure_error, c.proved) == expected


def test_sizes_are_bidisperse():
    packing = prepare_packing(9, P)
    assert np.array_equal(packing.radii, [0.5 / 1.2] * 5 + [0.7 / 1.2] * 4)


def test_same_seed_same_packing():
    a, b = (prepare_packing(64, P, seed=3) for _ in range(2))
    assert (a.checksum, a.provenance, a.certificate) == (b.checksum, b.provenance, b.certificate)


def test_other_seed_other_packing():
    assert prepare_packing(64, P, seed=3).checksum != prepare_packing(64, P, seed=4).checksum


def test_methods_differ_only_in_the_minimum_they_find():
    a, b = (prepare_packing(64, P, method=method) for method in METHODS)
    assert abs(a.phi - b.phi) < 0.02


def test_progress_grows_to_one():
    seen = []
    prepare_packing(256, P, progress=lambda fraction, text: seen.append(fraction))
    assert len(seen) > 3 and 0 <= min(seen) < 0.7 and seen[-1] == 1 == max(seen)


@pytest.mark.parametrize("packing", [random_disks(8, 2.5), random_disks(64, 1.5), random_disks(64, 0.86)])
def test_kernel_agrees_with_network(packing):
    network = ContactNetwork.of(packing)
    h, z = state(packing)
    g = h.gradient(z)
    energy = 0.5 * (network.force**2 / network.stiffness).sum()
    assert h.energy == pytest.approx(energy, rel=1e-12)
    assert h.pressure == pytest.approx(network.pressure, rel=1e-12)
    assert np.allclose(-g[:-1].reshape(-1, 2) / 1.03, network.residual_force, atol=1e-12)


def test_two_images_of_a_disk_are_two_contacts():
    network = ContactNetwork.of(random_disks(8, 2.5))
    pairs = np.stack([network.i, network.j])
    assert np.unique(pairs, axis=1).shape[1] < len(network)


def test_gradient_is_the_derivative_to_second_order():
    """The central difference of H, box included, errs by h²."""
    packing = random_disks(16, 1.2)
    h, z = state(packing, pressure=0.1)
    direction = np.random.default_rng(0).normal(size=z.size)
    slope = h.gradient(z) @ direction

    def enthalpy(at):
        h.gradient(at)
        return h.energy + 0.1 * (h.length * h.unpack(at)[1]) ** 2

    errors = [
        abs((enthalpy(z + step * direction) - enthalpy(z - step * direction)) / (2 * step) - slope)
        for step in (1e-3, 5e-4)
    ]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)


def test_neighbour_list_never_misses_a_contact():
    """Disks that wander, in a box that shrinks, have the energy of a fresh list."""
    packing = random_disks(64, 1.0)
    h, z = state(packing)
    rng = np.random.default_rng(1)
    for _ in range(50):
        z = z + np.append(rng.normal(scale=0.02, size=z.size - 1), -0.03)
        h.gradient(z)
        fresh = Enthalpy(packing.radii, h.length)
        fresh.gradient(z)
        assert h.energy == pytest.approx(fresh.energy, rel=1e-12)


def test_budget_spent_is_an_error_that_says_where_it_stands():
    packing = random_disks(16, 0.9)
    h = Enthalpy(packing.radii, packing.box.cell[0, 0], P, budget=10)
    with pytest.raises(SolverError, match=r"after 10 force evaluations; .* \(target 0.001"):
        METHODS["cg"](h, np.append(packing.positions, 0.0), lambda h: False)


@pytest.mark.parametrize("prestress", [True, False])
@pytest.mark.parametrize("packing", [random_disks(64, 3.0), random_disks(64, 2.0, 7), None])
def test_negative_modes_are_those_of_the_dense_matrix(packing, prestress):
    packing = packing or prepare_packing(64, P)
    K = hessian(ContactNetwork.of(packing), prestress).toarray()
    assert negative_modes(packing, prestress) == (np.linalg.eigvalsh(K) < -1e-10).sum()


def test_squeezed_disks_have_many_negative_modes():
    assert certify(random_disks(64, 3.0)).certificate.negative_modes > 20


def test_hessian_is_the_derivative_of_the_force_to_second_order():
    packing = prepare_packing(64, 0.1)
    network = ContactNetwork.of(packing)
    assert network.rattlers == 0
    u = np.random.default_rng(0).normal(size=(64, 2))

    def force(step):
        moved = Packing(packing.positions + step * u, packing.radii, packing.box)
        return ContactNetwork.of(moved).residual_force

    Ku = (hessian(network) @ u.ravel()).reshape(-1, 2)
    errors = [abs((force(-s) - force(s)) / (2 * s) - Ku).max() for s in (2e-4, 1e-4)]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (dict(n=7), "7"), (dict(n=64.5), "64.5"), (dict(pressure=0), "not 0"),
        (dict(pressure=-1e-3), "-0.001"), (dict(pressure=0.7), "0.7"), (dict(pressure=np.nan), "nan"),
        (dict(pressure=np.inf), "inf"),
        (dict(pressure=1e-12), "1e-12"), (dict(pressure="1e-3"), "'1e-3'"), (dict(seed=-1), "-1"),
        (dict(seed=1.5), "1.5"), (dict(method="newton"), "'newton'"), (dict(potential_name="lj"), "'lj'"),
        (dict(shear_stabilised=True), "shear_stabilised"),
    ],
)  # fmt: skip
def test_bad_input_is_named(arguments, named):
    with pytest.raises(InputError, match=named):
        prepare_packing(**arguments)


def test_unjammed_is_refused():
    with pytest.raises(InputError, match="not jammed"):
        certify(random_disks(64, 0.2))


def test_numba_waits_until_used():
    code = "import sys, petscjam.packing.prepare; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
