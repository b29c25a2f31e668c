"""Packing preparation: targets reached, forces right, unstable modes counted."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from helpers import jax_md, sixteen

from petscjam.base.errors import InputError, SolverError
from petscjam.geometry.box import Box
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.packing import Packing
from petscjam.geometry.potential import POTENTIALS
from petscjam.preparation.certify import certify, elastic_tensor, hessian, negative_modes
from petscjam.preparation.minimise import METHODS, Enthalpy
from petscjam.preparation.newton import newton
from petscjam.preparation.prepare import prepare_packing, relax_packing
from petscjam.preparation.records import Goal
from petscjam.response.moduli import complex_modulus

P = 1e-3
EPS = np.finfo(float).eps
CASES = [
    dict(n=64),
    dict(n=256, pressure=1e-4),
    dict(n=64, pressure=0.1),
    dict(n=64, potential_name="harmonic-relative"),
    dict(n=65),
    dict(n=8),
    dict(n=10),
    dict(n=64, method="cg"),
    dict(n=64, shear_stabilised=True),
    dict(n=64, potential_name="hertzian"),
    dict(n=64, potential_name="hertzian-relative", shear_stabilised=True),
    dict(n=64, ratio=1.0, polydispersity=0.1),
    dict(n=64, ratio=2.0, composition=0.7),
    dict(n=64, pressure=1e-6),
]


def random_disks(n: int, phi: float, seed: int = 5) -> Packing:
    """Disks at random, squeezed so hard that everybody touches: a configuration with many unstable modes."""
    radii = np.where(np.arange(n) < n // 2, 0.5 / 1.2, 0.7 / 1.2)
    box = Box.square(np.sqrt(np.pi * (radii**2).sum() / phi))
    return Packing(np.random.default_rng(seed).random((n, 2)) @ box.cell, radii, box)


def tilted(packing: Packing) -> Packing:
    """The same disks sheared along with their cell."""
    F = np.array([[1.0, 0.3], [0.1, 0.95]])
    return Packing(packing.positions @ F.T, packing.radii, packing.box.deformed(F), packing.potential_name)


def deformed(h: Enthalpy) -> np.ndarray:
    """A z of ``h`` with a cell that has grown by 3 % and, where it may, sheared."""
    z = h.start.copy()
    z[2 * len(h.radii) :] = 0.03 * h.weight
    return z


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
    assert (c.rattlers, c.Z, c.pressure) == (network.rattlers, network.Z, network.pressure)
    assert c.pressure_error == pytest.approx(abs(network.pressure / target - 1), abs=1e-15)
    assert c.contacts == len(network.without_rattlers())


def test_every_packing_is_proved(prepared):
    assert prepared[0].certificate.proved is True


def test_lowest_eigenvalues_are_those_of_the_dense_matrix(prepared):
    packing, network, _ = prepared
    dense = np.linalg.eigvalsh(hessian(network).toarray())
    c = packing.certificate
    assert abs(dense[:2]).max() < 1e-12  # translations
    assert np.allclose(c.eigenvalues, dense[2:6], rtol=0, atol=1e-12 + c.eigenvalue_error)


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


PACKED = [
    random_disks(8, 2.5),
    random_disks(3, 4.0),
    random_disks(64, 1.5),
    random_disks(64, 0.86),
    tilted(random_disks(64, 1.2)),
    random_disks(9000, 0.9),
]


@pytest.mark.parametrize("potential_name", ["harmonic", "hertzian-relative"])
@pytest.mark.parametrize("packing", PACKED)
def test_kernel_agrees_with_network(packing, potential_name):
    """In a deformed cell; ContactNetwork finds its pairs, and adds them up, by another program."""
    packing = replace(packing, potential_name=potential_name)
    h = Enthalpy(packing, 0.1, shape=True)
    z = deformed(h)
    g = h.gradient(z)
    _, F = h.unpack(z)
    network = ContactNetwork.of(h.at(z))
    sigma = network.radii[network.i] + network.radii[network.j]
    energy = packing.potential.energy(network.distance, sigma).sum()
    assert h.now.energy == pytest.approx(energy, rel=1e-12)
    assert np.allclose(h.now.stress, network.stress[[0, 0, 1], [0, 1, 1]], rtol=1e-12, atol=1e-13)
    forces = -g[: 2 * len(packing)].reshape(-1, 2) @ np.linalg.inv(F)
    assert np.allclose(forces, network.residual_force[h.order], atol=1e-12)
    assert h.now.force == pytest.approx(np.linalg.norm(network.residual_force, axis=1).max(), rel=1e-12)


def test_threads_change_nothing():
    one, two = (Enthalpy(random_disks(9000, 0.9), threads=threads) for threads in (1, 2))
    assert np.array_equal(one.gradient(one.start), two.gradient(two.start))
    assert one.now.energy == two.now.energy
    assert np.array_equal(*(METHODS["fire"](h, h.start, Goal(1e-3, 0.0, 0.0)) for h in (one, two)))


def test_two_images_of_a_disk_are_two_contacts():
    network = ContactNetwork.of(random_disks(8, 2.5))
    pairs = np.stack([network.i, network.j])
    assert np.unique(pairs, axis=1).shape[1] < len(network)


@pytest.mark.parametrize("shape", [False, True])
def test_gradient_is_the_derivative_to_second_order(shape):
    """The central difference of H, cell included, errs by h²."""
    packing = tilted(random_disks(16, 1.2))
    h = Enthalpy(packing, 0.1, shape=shape)
    z = deformed(h)
    direction = np.random.default_rng(0).normal(size=z.size)
    slope = h.gradient(z) @ direction

    def enthalpy(at):
        h.gradient(at)
        return h.now.energy + 0.1 * packing.box.area * np.linalg.det(h.unpack(at)[1])

    errors = [
        abs((enthalpy(z + step * direction) - enthalpy(z - step * direction)) / (2 * step) - slope)
        for step in (1e-3, 5e-4)
    ]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)


@pytest.mark.parametrize("growth", [-2e-3, 2e-3])
@pytest.mark.parametrize("n", [16, 400])
def test_neighbour_list_never_misses_a_contact(n, growth):
    """Disks that wander, in a cell that shrinks or grows and shears, have the energy of a fresh list."""
    packing = random_disks(n, 1.0)
    packing = replace(packing, radii=packing.radii * np.where(np.arange(n) % 2, 0.3, 1.3))
    h = Enthalpy(packing, 0.1, shape=True)
    z = h.start
    rng = np.random.default_rng(1)
    for _ in range(50):
        z = z + np.append(rng.normal(scale=0.02, size=2 * n), h.weight * np.array([growth, 4e-3, growth]))
        h.gradient(z)
        fresh = ContactNetwork.of(h.at(z))
        assert h.now.energy == pytest.approx(0.5 * (fresh.force**2 / fresh.stiffness).sum(), rel=1e-9)


def test_fire_and_conjugate_gradients_and_newton_end_in_one_minimum():
    """From nearby, all three do; Newton's method converges quadratically."""
    packing = prepare_packing(64, P, seed=2)
    shaken = replace(packing, positions=packing.positions + 1e-7 * np.random.default_rng(0).normal(size=(64, 2)))
    goal = Goal(1e-13, 0.0, 1e-13)
    ends = []
    for method in (*METHODS.values(), newton):
        h = Enthalpy(shaken, P)
        ends.append(ContactNetwork.of(h.at(method(h, h.start, goal))))
        assert h.reached(goal)
    assert h.evaluations <= 4
    for end in ends[1:]:
        assert np.allclose(end.force, ends[0].force, atol=1e-11)


def test_budget_spent_is_an_error_that_says_where_it_stands():
    h = Enthalpy(random_disks(16, 0.9), P, budget=10)
    with pytest.raises(SolverError, match=r"after 10 force evaluations; .* \(target 0.001"):
        METHODS["cg"](h, h.start, Goal(0.0, 0.0, 0.0))


def test_a_target_that_is_not_reached_within_the_budget_is_an_error():
    with pytest.raises(SolverError, match="not converged after 200 force evaluations"):
        prepare_packing(64, P, budget=200)


def square_lattice(m: int = 6) -> Packing:
    """Equal disks, squeezed, each with four contacts: forces balance, but rows slide over each other."""
    x = np.stack(np.meshgrid(np.arange(m), np.arange(m)), axis=-1).reshape(-1, 2) + 0.5
    return Packing(x * 0.98, np.full(m * m, 0.5), Box.square(0.98 * m))


def test_a_saddle_is_seen_and_not_proved():
    c = certify(square_lattice()).certificate
    dense = np.linalg.eigvalsh(hessian(ContactNetwork.of(square_lattice())).toarray())
    assert c.max_force < 1e-12 and c.proved is False
    assert c.negative_modes == (dense < -1e-9).sum() > 0


def test_a_balanced_packing_that_is_not_proved_within_the_budget_is_returned():
    """The square lattice balances its forces at once, and the budget does not allow to leave it."""
    packing = relax_packing(square_lattice(), budget=20)
    assert packing.certificate.proved is False and packing.certificate.negative_modes > 0


def test_the_deepest_mode_of_many_comes_first():
    """Shift and invert near zero misses it; the count shows that, and the shift is lowered."""
    packing = random_disks(64, 3.0)
    dense = np.linalg.eigvalsh(hessian(ContactNetwork.of(packing)).toarray())
    c = certify(packing).certificate
    assert c.lowest_eigenvalue == pytest.approx(dense[0], rel=1e-6) and dense[0] < -1e-3


def test_modes_that_cannot_be_computed_prove_nothing(monkeypatch):
    packing = prepare_packing(64, P)

    def fails(*arguments, **options):
        raise SolverError("no convergence")

    monkeypatch.setattr("petscjam.preparation.certify.lowest_eigenpairs", fails)
    c = certify(packing).certificate
    assert c.proved is False and c.negative_modes is None and c.max_force < 1e-9


def test_disks_that_touch_without_force_are_not_jammed():
    x = np.stack(np.meshgrid(np.arange(6.0), np.arange(6.0)), axis=-1).reshape(-1, 2)
    with pytest.raises(InputError, match="not jammed"):
        certify(Packing(x, np.full(36, 0.5), Box.square(6.0)))


def test_disks_without_contacts_are_compressed_to_the_pressure():
    x = np.stack(np.meshgrid(np.arange(8.0), np.arange(8.0)), axis=-1).reshape(-1, 2) * 1.2
    shaken = x + 0.05 * np.random.default_rng(0).normal(size=x.shape)
    packing = relax_packing(Packing(shaken, np.full(64, 0.5), Box.square(9.6)), 1e-4)
    assert packing.certificate.proved and packing.certificate.pressure_error < 1e-9


def test_units_of_other_programs():
    """Disks of diameter 100 with VOT's potential: k = 1e-4, and the pressure scales with it."""
    one = prepare_packing(64, 1e-2, potential_name="harmonic-relative")
    scaled = replace(one, positions=100 * one.positions, radii=100 * one.radii, box=Box(100 * one.box.cell))
    relaxed = relax_packing(scaled, 0.5e-2 * 1e-4)
    assert relaxed.certificate.proved
    assert relaxed.phi == pytest.approx(relax_packing(one, 0.5e-2).phi, rel=1e-6)
    with pytest.raises(InputError, match="below 5e-05"):
        relax_packing(scaled, 1e-3)


@pytest.mark.parametrize("shear_stabilised", [False, True])
def test_negative_modes_are_followed_downhill(shear_stabilised):
    packing = relax_packing(square_lattice(), 0.01, shear_stabilised=shear_stabilised)
    assert packing.certificate.proved and packing.certificate.negative_modes == 0


def test_a_cell_that_yields_to_shear_is_followed_downhill():
    """Stabilising a shear-unstable packing ends in another cell, at the same pressure."""
    unstable = next(p for seed in range(1, 20) if (p := prepare_packing(32, P, seed)).certificate.shear_modulus < 0)
    stable = relax_packing(unstable, P, shear_stabilised=True)
    assert stable.certificate.proved and stable.certificate.shear_modulus > 0
    assert stable.certificate.stress_error < 1e-9


def test_relaxing_what_is_relaxed_changes_little():
    packing = prepare_packing(64, P)
    again = relax_packing(packing, P)
    assert abs(again.positions - packing.positions).max() < 1e-9
    assert again.certificate.proved


def test_decompression_lowers_the_density():
    packing = prepare_packing(64, 1e-2)
    lower = relax_packing(packing, 1e-3)
    assert lower.phi < packing.phi and lower.certificate.pressure_error < 1e-9 and lower.certificate.proved


def test_constant_volume_keeps_the_cell():
    packing = random_disks(64, 0.9)
    relaxed = relax_packing(packing)
    assert np.array_equal(relaxed.box.cell, packing.box.cell) and relaxed.certificate.proved


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("pressure", [1e-2, 1e-3, 1e-4, 1e-5, 1e-6])
def test_proved_packings_have_no_negative_dense_eigenvalue(pressure, seed):
    """The count by pivots and the lowest modes by Lanczos, against all eigenvalues of the dense matrix."""
    packing = prepare_packing(128, pressure, seed)
    dense = np.linalg.eigvalsh(hessian(ContactNetwork.of(packing)).toarray())
    assert packing.certificate.proved
    assert abs(dense[:2]).max() < 1e-13 < dense[2]
    assert packing.certificate.lowest_eigenvalue == pytest.approx(dense[2], rel=1e-6)


def test_a_packing_of_jambashbulk_is_proved_and_stays():
    """Another program stabilised it against shear: relaxing size and shape of the cell moves nothing."""
    packing = sixteen()
    relaxed = relax_packing(packing, 1e-3, shear_stabilised=True)
    assert certify(packing).certificate.proved and relaxed.certificate.proved
    assert abs(relaxed.box.cell - packing.box.cell).max() < 1e-9
    assert abs(packing.box.minimum_image(relaxed.positions - packing.positions)).max() < 1e-9


@pytest.mark.parametrize("index", range(0, 10, 3))
def test_packings_of_jaxmd_are_minima_at_their_volume(index):
    packing = jax_md(index)
    relaxed = relax_packing(packing)
    assert relaxed.certificate.proved
    assert abs(packing.box.minimum_image(relaxed.positions - packing.positions)).max() < 1e-6


def test_softest_shear_bounds_the_modulus_of_every_direction():
    """Of the packing, turned, as complex_modulus finds it for simple shear along x."""
    packing = prepare_packing(64, 1e-2, seed=2)
    moduli = []
    for angle in np.linspace(0, np.pi, 60, endpoint=False):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        turned = Packing(packing.positions @ turn.T, packing.radii, packing.box.deformed(turn))
        C, _ = elastic_tensor(ContactNetwork.of(turned))
        moduli.append(C[1, 1])
        if len(moduli) % 20 == 1:
            assert C[1, 1] == pytest.approx(complex_modulus(turned, [1.0]).G0, rel=1e-8)
    softest = packing.certificate.shear_modulus
    assert softest <= min(moduli) + 1e-12 and min(moduli) - softest < 0.01 * np.ptp(moduli)


def test_history_tells_the_preparation():
    history = prepare_packing(256, P).provenance["history"]
    assert len({len(values) for values in history.values()}) == 1 and len(history["phi"]) > 3
    assert np.all(np.diff(history["evaluations"]) > 0)
    assert history["force"][-1] < 1e-3 * history["force"][0]


@pytest.mark.parametrize("options", [dict(ratio=1.4), dict(ratio=2.0, composition=0.25), dict(polydispersity=0.1)])
def test_radii_are_as_asked(options):
    radii = prepare_packing(64, 1e-2, **options).radii
    small = int(64 * options.get("composition", 0.5))
    assert 2 * radii.mean() == pytest.approx(1, abs=0.03 if "polydispersity" in options else 1e-12)
    assert radii[small:].mean() / radii[:small].mean() == pytest.approx(options.get("ratio", 1.4), rel=0.05)
    assert radii[:small].std() / radii[:small].mean() == pytest.approx(options.get("polydispersity", 0), abs=0.03)


@pytest.mark.parametrize("prestress", [True, False])
@pytest.mark.parametrize("packing", [random_disks(64, 3.0), random_disks(64, 2.0, 7), None])
def test_negative_modes_are_those_of_the_dense_matrix(packing, prestress):
    packing = packing or prepare_packing(64, P)
    K = hessian(ContactNetwork.of(packing), prestress).toarray()
    assert negative_modes(packing, prestress) == (np.linalg.eigvalsh(K) < -1e-10).sum()


def test_squeezed_disks_have_many_negative_modes():
    assert certify(random_disks(64, 3.0)).certificate.negative_modes > 20


@pytest.mark.parametrize("potential_name", POTENTIALS)
def test_hessian_is_the_derivative_of_the_force_to_second_order(potential_name):
    packing = prepare_packing(64, 0.1, potential_name=potential_name)
    network = ContactNetwork.of(packing)
    assert network.rattlers == 0
    u = np.random.default_rng(0).normal(size=(64, 2))

    def force(step):
        moved = replace(packing, positions=packing.positions + step * u)
        return ContactNetwork.of(moved).residual_force

    Ku = (hessian(network) @ u.ravel()).reshape(-1, 2)
    errors = [abs((force(-s) - force(s)) / (2 * s) - Ku).max() for s in (2e-4, 1e-4)]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (dict(n=7), "7"),
        (dict(n=64.5), "64.5"),
        (dict(pressure=0), "not 0"),
        (dict(pressure=-1e-3), "-0.001"),
        (dict(pressure=0.7), "0.7"),
        (dict(pressure=np.nan), "nan"),
        (dict(pressure=np.inf), "inf"),
        (dict(pressure=1e-12), "1e-12"),
        (dict(pressure="1e-3"), "'1e-3'"),
        (dict(seed=-1), "-1"),
        (dict(seed=1.5), "1.5"),
        (dict(method="newton"), "'newton'"),
        (dict(potential_name="lj"), "'lj'"),
        (dict(ratio=0), "ratio .* not 0"),
        (dict(ratio=-1.4), "-1.4"),
        (dict(composition=1.2), "1.2"),
        (dict(polydispersity=-0.1), "-0.1"),
        (dict(budget=0), "not 0"),
        (dict(n=1), "not 1"),
    ],
)
def test_bad_input_is_named(arguments, named):
    with pytest.raises(InputError, match=named):
        prepare_packing(**arguments)


def test_unjammed_is_refused():
    with pytest.raises(InputError, match="not jammed"):
        certify(random_disks(64, 0.2))


def test_numba_waits_until_used():
    code = "import sys, petscjam.preparation.prepare; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
