"""Facts of the nonlinear equations of motion: a lattice as one oscillator, the linear law, motion in time, symmetry."""

import numpy as np
import pytest
from helpers import any_prestress, any_strain, sixteen, triangular_lattice
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar
from test_drag import any_exponent, modulus_in_time

import petscjam as pj
from petscjam.analysis.nonlinear_drag import resolvent
from petscjam.io.results import append_result, read_results
from petscjam.plots import plot_results

OMEGA = np.array([1e-3, 1e-1, 10.0])


@pytest.mark.parametrize("alpha", [0.05, 0.5, 1.0, 3.0])
def test_resolvent_solves_its_equation(alpha):
    rng = np.random.default_rng(0)
    x, R = 10 ** rng.uniform(-12, 6, (40, 30)), 10 ** rng.uniform(-6, 6, (40, 1))
    assert resolvent(0.3 * x**alpha + R * x, R, 0.3, alpha) == pytest.approx(x, rel=1e-9)
    assert (resolvent(np.zeros((1, 1)), R[:1], 0.3, alpha) < 1e-15).all()


def lattice_oscillator(packing, alpha):
    """K and C of Kγ + C|γ̇|^(α−1)γ̇ = σ: a triangular lattice without pre-stress, sheared along a row.

    All disks move affinely and rotate at the same rate κγ̇, κ such that the dissipation is least; one contact of
    three for each disk moves along the row.
    """
    r, d = 0.99, packing.mean_diameter
    density = len(packing) / packing.box.area
    K = density * 2 * (3**0.5 / 4 * r) ** 2

    def loss(kappa):
        speeds = np.abs(kappa) * d, np.hypot(3**0.5 / 4 * r, 3 / 4 * r + kappa * d)
        return speeds[0] ** (alpha + 1) + 2 * speeds[1] ** (alpha + 1)

    best = minimize_scalar(loss, bounds=(-1, 0), method="bounded", options={"xatol": 1e-12})
    return K, density * d ** (1 - alpha) * best.fun


def strain_in_time(K, C, alpha, stress, omega):
    """Return the first and the third harmonic of γ under stress cos ωt."""

    def rate(t, y):
        pull = stress * np.cos(omega * t) - K * y
        return np.sign(pull) * (np.abs(pull) / C) ** (1 / alpha)

    times = (40 * np.pi + 2 * np.pi / 4096 * np.arange(4096)) / omega
    y = solve_ivp(rate, (0, times[-1]), [0.0], method="LSODA", t_eval=times, rtol=1e-10, atol=1e-14 * stress).y[0]
    return [2 * np.mean(y * np.exp(-1j * n * omega * times)) for n in (1, 3)]


@any_exponent
@pytest.mark.parametrize("omega", [0.03, 0.3, 3.0])
def test_lattice_is_one_oscillator(alpha, omega):
    """Its equation of motion is scalar, and integrated in time by SciPy."""
    packing, stress = triangular_lattice(4), 0.1
    first, third = strain_in_time(*lattice_oscillator(packing, alpha), alpha, stress, omega)
    g = pj.nonlinear_drag(packing, [omega], stress, alpha, prestress=False, points=256, rtol=1e-7)
    assert g.values[0] == pytest.approx(stress / first, rel=2e-4)
    assert g.third[0] == pytest.approx(third / first, abs=2e-4)


@any_strain
@any_prestress
def test_alpha_of_one_is_linear(strain, prestress):
    linear = pj.complex_modulus(sixteen(), OMEGA, strain=strain, prestress=prestress).values
    g = pj.nonlinear_drag(sixteen(), OMEGA, 0.1, 1.0, strain=strain, prestress=prestress, points=16)
    assert g.values == pytest.approx(linear, rel=1e-10)
    assert abs(g.third).max() < 1e-10
    assert g.tau == pytest.approx(np.ones(3))


@any_exponent
@pytest.mark.parametrize("omega", [1e-3, 1e-2])
def test_motion_in_time(alpha, omega):
    """Of the dense twin, by time steps: these approach it, in second order."""
    g = pj.nonlinear_drag(sixteen(), [omega], 0.1, alpha, points=128)
    coarse, fine = (abs(modulus_in_time(alpha, omega, 0.1, steps, 3) / g.values[0] - 1) for steps in (64, 128))
    assert fine < 4e-4
    assert fine < coarse / 3


@any_exponent
def test_more_times_change_nothing(alpha):
    """Up to ωτ = 40, where harmonics fall off most slowly."""
    few, many = (pj.nonlinear_drag(sixteen(), OMEGA, 0.1, alpha, points=points).values for points in (64, 256))
    assert abs(few / many - 1).max() < 1e-4


@any_exponent
def test_all_amplitudes_follow_from_one(alpha):
    g = pj.nonlinear_drag(sixteen(), OMEGA, 0.1, alpha, points=16, rtol=1e-8)
    for stress in (1e-3, 3.0):
        moved = g.at(stress)
        solved = pj.nonlinear_drag(sixteen(), moved.omega, stress, alpha, points=16, rtol=1e-8)
        assert moved.values == pytest.approx(solved.values, rel=1e-7)
        assert moved.contact_tau == pytest.approx(solved.contact_tau, rel=1e-5)


@pytest.mark.parallel(nprocs=[1, 2])
def test_ranks_agree(comm):
    alone, found = (
        pj.nonlinear_drag(sixteen(), OMEGA, 0.1, 0.5, points=16, rtol=1e-8, comm=c)
        for c in (comm.Split(comm.rank), comm)
    )
    assert found.values == pytest.approx(alone.values, rel=1e-8)
    assert found.third == pytest.approx(alone.third, rel=1e-6)
    assert len(set(comm.allgather(found.values.tobytes() + found.contact_tau.tobytes()))) == 1


def test_what_did_not_converge_is_marked():
    g = pj.nonlinear_drag(sixteen(), [1e-3, 1.0], 0.1, 0.5, points=16, most_iterations=2)
    assert not g.converged.any()
    assert "not converged in 2 iterations at ω = 0.001, 1" in g.notes[-1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"alpha": 0.0}, "alpha: must be from 0.01 to 100, not 0.0"),
        ({"stress": np.nan}, "stress: must be from .*, not nan"),
        ({"omegas": [0.0]}, "omega: frequencies must be from .*, not 0"),
        ({"points": 30}, "points: must be a multiple of 4 from 8 to 1024, not 30"),
        ({"rtol": 1.0}, "rtol: must be > 0 and at most 0.1, not 1.0"),
        ({"rtol": -1.0}, "rtol: must be > 0 and at most 0.1, not -1.0"),
    ],
)
def test_bad_input(change, message):
    with pytest.raises(pj.InputError, match=message):
        pj.nonlinear_drag(sixteen(), **{"omegas": [1.0], "stress": 0.1, "alpha": 0.5, **change})


def test_file_and_figure(tmp_path):
    g = pj.nonlinear_drag(sixteen(), OMEGA, 0.1, 0.5, points=16)
    append_result(g, tmp_path / "g.h5", "sixteen")
    (back,) = read_results(tmp_path / "g.h5").values()
    assert (back.third == g.third).all()
    assert back.form == "direct"
    plot_results({"direct": g}, tmp_path / "drag.png")
    assert (tmp_path / "drag.png").stat().st_size > 20_000
