"""G* with inertia: the slow twin, closed forms, limits, and the disk engine at small amplitude."""

import numpy as np
import pytest
from helpers import (
    EVERY_LAW,
    any_law,
    any_prestress,
    any_strain,
    jammed,
    lattice,
    refused,
    triangular_lattice,
    twin_contacts,
    twin_matrices,
)

import petscjam as pj
from petscjam.base.errors import InputError
from petscjam.cli import main
from petscjam.io.results import read_moduli
from petscjam.md.oscillations import harmonics
from petscjam.md.protocols import oscillation
from petscjam.md.runs import run
from petscjam.reference import linear as reference
from petscjam.rows.kinematics import STRAINS

OMEGA = np.array([1e-4, 1e-2, 0.3, 1.0, 5.0, 1e2])
MASSES = np.random.default_rng(1).uniform(0.5, 4.0, 64)  # by disk
EVENTS = ("made", "broken")
alone = pytest.mark.parallel(nprocs=1)


def twin_modulus(packing, law, omega, mass, strain="simple-shear", prestress=True):
    K, B, pressure = twin_matrices(packing, law, strain, prestress)
    M, mode = reference.inertia(np.full(len(packing), mass), packing.radii), STRAINS[strain]
    G = np.array([reference.modulus(K, B, w, packing.box.area, M) for w in omega])
    return mode.scale * G + mode.pressure_term * pressure


@alone
@any_law
@any_prestress
def test_moduli_are_those_of_the_slow_twin(law, prestress):
    packing = jammed(2e-2, 64, 3)
    g = pj.complex_modulus(packing, OMEGA, damping=law, mass=MASSES, prestress=prestress)
    slow = twin_modulus(packing, law, OMEGA, MASSES, prestress=prestress)
    assert abs(g.values / slow - 1).max() < 1e-11
    assert g.residuals.max() < 1e-12
    assert g.power_balance.max() < 1e-12


@pytest.mark.parallel(nprocs=2)
def test_two_ranks_have_the_same_inertia(comm):
    packing, law = jammed(2e-2, 64, 3), pj.ContactDamping(0.3)
    g = pj.complex_modulus(packing, OMEGA, damping=law, mass=MASSES, comm=comm)
    assert abs(g.values / twin_modulus(packing, law, OMEGA, MASSES) - 1).max() < 1e-11


@alone
@any_strain
def test_every_strain_mode_has_inertia(strain):
    packing, law = jammed(2e-2, 64, 3), pj.ContactDamping(0.3)
    g = pj.complex_modulus(packing, OMEGA, damping=law, mass=2.0, strain=strain)
    assert abs(g.values / twin_modulus(packing, law, OMEGA, 2.0, strain) - 1).max() < 1e-11


@alone
@pytest.mark.parametrize("rotations", [True, False])
@any_prestress
def test_a_honeycomb_resonates_as_its_two_sublattices(rotations, prestress):
    """Closed form: the sublattices move against each other by w along y, all disks turn, with θA + θB = Θ.

    Three contacts of a disk at 0°, 120°, 240°. Relative coordinates have the reduced mass and moment of inertia;
    the mean translation and the counter-rotation of gears are not driven. The resonance is at ω² = 3k/(2μ).
    """
    r, rho, beta, light, heavy = 0.99, 0.5, 0.3, 40.0, 100.0
    packing = lattice((1.5, 0.75**0.5), (1.5, -(0.75**0.5)), 4, 4, basis=((0, 0), (1, 0)))
    mass, mu = np.tile([light, heavy], 16), light * heavy / (light + heavy)
    omega = np.sqrt(1.5 / mu) * np.array([0.1, 0.9, 1.0, 1.1, 10.0])
    law = pj.ContactDamping(beta, rotations=rotations)
    g = pj.complex_modulus(packing, omega, damping=law, mass=mass, prestress=prestress)
    s = 1j * omega
    normal, transverse = 1 + s, beta * s - prestress * (1 - r) / r
    ww = 1.5 * (normal + transverse) - omega**2 * mu
    ws, ss = 0.75 * r * (transverse - normal), r**2 * (3 * normal + 9 * transverse) / 8
    cell = ss - ws**2 / ww
    if rotations:
        turning = 3 * beta * s * rho**2 - omega**2 * mu * rho**2 / 2
        cell -= (1.5 * beta * s * rho * r) ** 2 / turning
    expected = cell / (1.5 * 3**0.5 * r**2)
    assert abs(g.values / expected - 1).max() < 1e-10
    assert g.values.imag[:4].argmax() == 2


@alone
@pytest.mark.parametrize("rotations", [True, False])
def test_a_triangular_lattice_moves_affinely_and_its_disks_turn(rotations):
    """Closed form: the affine motion has no inertia; all disks turn by the same θ, which is absolute."""
    packing, r, rho, mass, s = triangular_lattice(6), 0.99, 0.5, 5.0, 1j * OMEGA
    g = pj.complex_modulus(packing, OMEGA, damping=pj.ContactDamping(rotations=rotations), mass=mass)
    cell = r**2 * (3 * (1 + s) + 9 * (s - (1 - r) / r)) / 8
    if rotations:
        cell -= (3 * s * rho * r) ** 2 / (12 * s * rho**2 - OMEGA**2 * mass * rho**2 / 2)
    assert abs(g.values / (cell / (0.75**0.5 * r**2)) - 1).max() < 1e-12


@alone
def test_stokes_drag_by_hand():
    """With one mass K, B and M have the same modes: λ + iω − ω²m."""
    packing, law = jammed(2e-2, 64, 3), pj.StokesDrag(0.5)
    K, _, _ = twin_matrices(packing, law)
    g = pj.complex_modulus(packing, OMEGA, damping=law, mass=50.0)
    hand = [reference.stokes_modal_sum(K, w, packing.box.area, 0.5, 50.0) for w in OMEGA]
    assert abs(g.values / hand - 1).max() < 1e-11


@alone
@any_law
def test_limits(law):
    """ω → 0 as without inertia; ω → ∞ affine, at ω = 1e5 within 1/ω²; small masses change nothing."""
    packing = jammed(2e-2, 64, 3)
    none = pj.complex_modulus(packing, OMEGA, damping=law)
    light = pj.complex_modulus(packing, OMEGA, damping=law, mass=1e-14)
    assert abs(light.values / none.values - 1).max() < 1e-10
    heavy = pj.complex_modulus(packing, [1e-7, 1e5], damping=law, mass=MASSES)
    assert (heavy.G0, heavy.eta0) == (none.G0, none.eta0)
    assert heavy.values[0].real == pytest.approx(none.G0, rel=1e-10)
    assert heavy.values[0].imag / 1e-7 == pytest.approx(none.eta0, rel=1e-9)
    assert heavy.values[1].real == pytest.approx(heavy.G_inf, rel=1e-6)
    assert heavy.values[1].imag / 1e5 == pytest.approx(heavy.eta_inf, rel=1e-8)


@alone
@pytest.mark.parametrize(
    ("law", "mass"), [(law, MASSES) for law in EVERY_LAW] + [(pj.StokesDrag(0.0), 30.0)], ids=lambda x: str(x)[:25]
)
def test_the_error_of_the_reduced_model_is_below_its_bound(law, mass):
    """At every frequency, also between the nodes and outside the span; at sharp resonances, too."""
    packing = jammed(2e-2, 64, 3)
    s = pj.spectrum(packing, (1e-3, 10.0), damping=law, mass=mass, rtol=1e-4)
    omega = np.geomspace(1e-4, 1e2, 61)
    g = pj.complex_modulus(packing, omega, damping=law, mass=mass)
    off, storage, loss = g.values - s(omega), *s.part_errors(omega)
    floor = 1e-12 * abs(g.values)
    assert (abs(off) <= s.error(omega) * abs(g.values) + floor).all()
    assert (abs(off.real) <= storage * abs(g.values.real) + floor).all()
    assert (abs(off.imag) <= loss * abs(g.values.imag) + floor).all()
    inside = omega[(omega >= 1e-3) & (omega <= 10)]
    assert s.error(inside).max() < 2e-4
    assert s.power_balance(omega).max() < 1e-9
    assert (s.G0, s.eta0, s.G_inf, s.eta_inf) == pytest.approx((g.G0, g.eta0, g.G_inf, g.eta_inf), rel=1e-10)


@alone
def test_the_bound_needs_no_positive_stiffness():
    """The bound is from friction alone: it holds for a compressed honeycomb, which has negative modes."""
    packing = lattice((1.5, 0.75**0.5), (1.5, -(0.75**0.5)), 4, 4, basis=((0, 0), (1, 0)))
    law, omega = pj.ContactDamping(0.3, rotations=False), np.geomspace(1e-2, 10, 31)
    s, g = (
        pj.spectrum(packing, (1e-2, 10.0), damping=law, mass=20.0),
        pj.complex_modulus(packing, omega, damping=law, mass=20.0),
    )
    assert s.negative_modes > 0
    assert (abs(s(omega) - g.values) <= (s.error(omega) + 1e-12) * abs(g.values)).all()


@pytest.mark.parallel(nprocs=[1, 2])
def test_the_reduced_model_does_not_depend_on_ranks(comm):
    packing, omega = jammed(2e-2, 64, 3), np.geomspace(1e-2, 10, 7)
    s = pj.spectrum(packing, (1e-2, 10.0), mass=MASSES, comm=comm)
    g = pj.complex_modulus(packing, omega, mass=MASSES)
    assert (abs(s(omega) / g.values - 1) <= s.error(omega)).all()
    assert s.error(omega).max() < 1e-6


@alone
def test_a_reduced_model_in_a_file(tmp_path):
    packing = jammed(2e-2, 64, 3)
    s = pj.spectrum(packing, (1e-2, 10.0), mass=MASSES, displacements=True)
    pj.write_spectrum(s, tmp_path / "model.h5")
    again, omega = pj.read_spectrum(tmp_path / "model.h5"), np.geomspace(1e-2, 10, 7)
    assert type(again) is type(s)
    assert np.array_equal(again(omega), s(omega))
    assert np.array_equal(again.error(omega), s.error(omega))
    assert np.array_equal(again.mass, MASSES)
    direct = pj.complex_modulus(packing, [0.3], mass=MASSES, fields_at=[0.3]).fields[0]
    assert np.nanmax(abs(s.displacement(0.3) - direct)) < 1e-3 * np.nanmax(abs(direct))
    for ask in (s.relaxation, lambda: s.G(1.0), lambda: s.J(1.0), lambda: s.kramers_kronig(omega)):
        with pytest.raises(InputError, match="with inertia the response is no sum of relaxations"):
            ask()


def engine_modulus(packing, law, omega, mass, dt):
    """Return G* of the disk engine at an amplitude of 1e-6, after 300 τe, and the contacts made and broken."""
    period = 2 * np.pi / omega
    dt, cycles = period / round(period / dt), int(np.ceil(300 / period))
    # one row for the first cycles, because rows take time
    options = {"Q": 1.0, "mass": mass, "dt": dt}
    first = run(oscillation(1e-6, omega, cycles), law, start=packing, row_time=cycles * period, **options)
    last = run(oscillation(1e-6, omega, 2), law, start=first, **options)
    return harmonics(last, skip=0).modulus, sum(part.rows[name].sum() for part in (first, last) for name in EVENTS)


@alone
@pytest.mark.parametrize(
    ("law", "omega", "mass", "shear_stabilised"),
    [
        (pj.ContactDamping(0.0), 0.3, 1.0, True),
        (pj.ContactDamping(0.3, rotations=False), 0.2, 2.5, False),
        (pj.ContactDamping(1.0), 0.3, 1.0, True),
        (pj.StokesDrag(1.0), 0.5, 1.0, False),
    ],
    ids=str,
)
def test_the_engine_at_small_amplitude_has_this_modulus(law, omega, mass, shear_stabilised):
    """From a certified packing, within 1e-4. With rotations, for the lever arms of the engine (VOT eq. 6).

    Errors of the engine are of second order in dt, which is extrapolated to 0. Without inertia it is
    off by what the mass term gives.
    """
    start = jammed(2e-2, 64, 3, shear_stabilised=shear_stabilised)
    ds = 2 * start.radii.min()
    packing = pj.Packing(start.positions / ds, start.radii / ds, pj.Box(start.box.cell / ds), start.potential_name)
    (coarse, first), (fine, second) = (engine_modulus(start, law, omega, mass, dt) for dt in (0.02, 0.01))
    engine = fine + (fine - coarse) / 3
    assert start.certificate.proved
    assert first == second == 0
    heavy, none = (pj.complex_modulus(packing, [omega], damping=law, mass=m).values[0] for m in (mass, None))
    if law.at_contact_point and law.tangential:
        K, _, _ = twin_matrices(packing, law)
        B = reference.contact_damping(twin_contacts(packing), packing.radii, law.beta, midway=True)
        M = reference.inertia(np.full(64, mass), packing.radii)
        expected = reference.modulus(K, B, omega, packing.box.area, M)
        assert 2e-4 < abs(heavy / expected - 1) < 1e-2  # of the order of the relative overlap
        heavy = expected
    assert abs(engine / heavy - 1) < 1e-4
    assert abs(none / heavy - 1) > 1e-2
    assert (engine - none) / none == pytest.approx((heavy - none) / none, rel=1e-2)


@alone
def test_displacements_have_no_momentum():
    packing, law = jammed(2e-2, 64, 3), pj.ContactDamping(0.3)
    g = pj.complex_modulus(packing, OMEGA, damping=law, mass=MASSES, fields_at=OMEGA)
    there = np.isfinite(g.fields[0, :, 0])
    momentum = np.einsum("i,fix->fx", MASSES[there], g.fields[:, there])
    assert abs(momentum).max() < 1e-10 * MASSES.sum() * abs(g.fields[:, there]).max()


@alone
def test_the_unit_of_length_does_not_matter():
    packing, law, omega = jammed(2e-2, 64, 3), pj.ContactDamping(0.3), np.geomspace(1e-2, 10, 7)
    large = pj.Packing(1e3 * packing.positions, 1e3 * packing.radii, pj.Box(1e3 * packing.box.cell))
    one, other = (pj.spectrum(some, (1e-2, 10.0), damping=law, mass=2.0) for some in (packing, large))
    assert other.nodes == pytest.approx(one.nodes, rel=1e-6)
    assert other(omega) == pytest.approx(one(omega), rel=1e-9)
    assert other.error(omega) == pytest.approx(one.error(omega), rel=1e-2, abs=1e-13)


@alone
@pytest.mark.parametrize("mass", [0.0, -1.0, np.nan, np.inf, "x", [1.0, 2.0], np.full((16, 1), 1.0)], ids=str)
def test_a_wrong_mass_is_refused(mass):
    with pytest.raises(InputError, match=r"^mass: "):
        pj.complex_modulus(jammed(2e-2, 64, 3), [1.0], mass=mass)


@alone
def test_the_command_stores_and_shows_the_mass(tmp_path, capfd):
    packing, file, light = jammed(2e-2, 64, 3), tmp_path / "g.h5", tmp_path / "light.h5"
    packing.write(tmp_path / "p.h5")
    sweep = ["moduli", str(tmp_path / "p.h5"), "--omega", "0.1:10:3", "--eta-fluid", "0,1", "--damping", "stokes"]
    assert main([*sweep, "--mass", "2.5", "-o", str(tmp_path / "model.h5")]) == 0
    assert "mass 2.5 k tau1²" in capfd.readouterr().out
    for g in read_moduli(tmp_path / "model.h5").values():
        exact = pj.complex_modulus(packing, g.omega, damping=g.damping, mass=2.5)
        assert (abs(g.values / exact.values - 1) <= g.errors).all()
    assert main(["plot", str(tmp_path / "model.h5"), "-o", str(tmp_path / "g.png")]) == 0
    assert "--beta-family" in refused(capfd, *sweep[:4], "--mass", "2", "--beta-family", "-o", tmp_path / "no.h5")
    words = ["moduli", str(tmp_path / "p.h5"), "--omega", "0.1:10:3", "--direct"]
    assert main([*words, "--mass", "2.5", "-o", str(file)]) == 0
    assert "pre-stress, mass 2.5 k tau1²; 3 frequencies" in capfd.readouterr().out
    (g,) = read_moduli(file).values()
    assert g.mass.tolist() == [2.5] * 64
    assert np.array_equal(g.values, pj.complex_modulus(packing, g.omega, mass=2.5).values)
    assert "mass 2.5, not none" in refused(capfd, *words, "-o", file, "--resume")
    assert "mass 2.5, not 3" in refused(capfd, *words, "-o", file, "--resume", "--mass", "3")
    assert main([*words, "-o", str(light)]) == 0
    (none,) = read_moduli(light).values()
    assert none.mass is None
    assert "no mass, not 3" in refused(capfd, *words, "-o", light, "--resume", "--mass", "3")
    for wrong in ("0", "-1", "nan"):
        assert "--mass" in refused(capfd, *words, f"--mass={wrong}", "-o", tmp_path / "none.h5")
    with pytest.raises(InputError, match="masses"):
        pj.average({"g": g, "none": none})
