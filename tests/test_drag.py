"""Facts of nonlinear drag: limits, energy over a cycle, an exact symmetry, dense twins, motion in time."""

from functools import cache

import numpy as np
import pytest
from helpers import any_prestress, any_strain, sixteen, twin_contacts
from scipy.integrate import solve_ivp

import petscjam as pj
from petscjam.analysis.contact_drag import contact_times, self_consistent_drag
from petscjam.analysis.drag import equivalent_drag, equivalent_time, line_factor
from petscjam.plots import plot_results
from petscjam.reference import linear as reference

OMEGA = np.array([1e-3, 1e-1, 10.0])
EXPONENTS = [2 / 3, 1 / 2]
CYCLE = np.arange(4096) * 2 * np.pi / 4096

any_exponent = pytest.mark.parametrize("alpha", EXPONENTS)


@cache
def per_contact(alpha, stress=0.1, strain="simple-shear", rtol=1e-9, floor=1e-6):
    return self_consistent_drag(sixteen(), OMEGA, stress, alpha, strain=strain, rtol=rtol, floor=floor)


# ---- one spring, one dashpot


@pytest.mark.parametrize(("alpha", "C"), [(1, 1.0), (2 / 3, 1.0711882), (1 / 2, 1.1128358)])
def test_factor_of_motion_along_a_line(alpha, C):
    assert line_factor(alpha) == pytest.approx(C, abs=5e-8)


@any_exponent
def test_time_at_low_frequency(alpha):
    omega, force = 1e-12, 0.1
    assert equivalent_time(omega, force, alpha) == pytest.approx(
        line_factor(alpha) * (force * omega) ** (alpha - 1), rel=1e-6
    )


@any_exponent
def test_time_at_high_frequency(alpha):
    omega, force = 1e6, 0.1
    assert equivalent_time(omega, force, alpha) == pytest.approx(
        line_factor(alpha) ** (1 / alpha) * force ** (-(1 - alpha) / alpha), rel=1e-6
    )


@pytest.mark.parametrize("alpha", [0.05, 0.5, 1.0, 1.5, 3.0])
def test_time_solves_its_equation_which_no_other_does(alpha):
    """The time less what its own motion calls for changes sign once, at every amplitude and frequency."""
    for omega, force in [(1e-6, 1e-3), (1.0, 1.0), (1e4, 1e-4), (0.3, 50.0)]:
        tau = equivalent_time(omega, force, alpha)
        tried = tau * np.geomspace(1e-30, 1e30, 4001)
        amplitude = force / np.hypot(1, omega * tried)
        left = np.log(tried) - np.log(line_factor(alpha) * (omega * amplitude) ** (alpha - 1))
        assert abs(left[2000]) < 1e-12 * max(1, abs(np.log(tau[0])))
        assert (np.sign(left[:2000]) == -1).all()
        assert (np.sign(left[2001:]) == 1).all()


def oscillator(alpha, force, omega=1.0):
    """Fundamental u(ω) and loss per cycle of u + |u̇|^(α−1)u̇ = F cos ωt, integrated in time."""

    def rate(t, u):
        pull = force * np.cos(omega * t) - u
        return np.sign(pull) * np.abs(pull) ** (1 / alpha)

    times = (60 * np.pi + CYCLE) / omega
    u = solve_ivp(rate, (0, times[-1]), [0.0], method="LSODA", t_eval=times, rtol=1e-9, atol=1e-12).y[0]
    loss = np.mean(np.abs(rate(times, u)) ** (alpha + 1)) * 2 * np.pi / omega
    return 2 * np.mean(u * np.exp(-1j * omega * times)), loss


@any_exponent
@pytest.mark.parametrize("force", [0.1, 1.0, 10.0])
def test_equivalent_damping_of_an_oscillator_in_time(alpha, force):
    """From ωτ = 10 to 0.1 the compliance is off by at most 6 %, the loss by at most 7 %."""
    u, loss = oscillator(alpha, force)
    x = equivalent_time(1.0, force, alpha)[0]
    equivalent = force / (1 + 1j * x)
    assert abs(equivalent / u - 1) < 0.06
    assert np.pi * x * abs(equivalent) ** 2 == pytest.approx(loss, rel=0.07)


@any_exponent
def test_uniform_time_dissipates_as_much_as_the_nonlinear_law(alpha):
    """Of one spring and dashpot, along the same path."""
    omega, force = 0.4, 0.3
    tau = equivalent_time(omega, force, alpha)[0]
    v = omega * force / np.hypot(1, omega * tau) * np.sin(CYCLE)
    assert tau * np.mean(v**2) == pytest.approx(np.mean(np.abs(v) ** (alpha + 1)), rel=1e-6)


# ---- times of contacts


@pytest.mark.parametrize("alpha", [0.2, 0.5, 2 / 3, 1.5])
def test_contact_times_by_quadrature(alpha):
    rng = np.random.default_rng(0)
    a = rng.standard_normal((50, 2)) + 1j * rng.standard_normal((50, 2))
    speed = np.linalg.norm((a[..., None] * np.exp(1j * CYCLE)).real, axis=1)
    expected = np.mean(speed ** (alpha + 1), axis=1) / np.mean(speed**2, axis=1)
    assert contact_times(a, alpha) == pytest.approx(expected, rel=1e-5)


@any_exponent
def test_contact_times_along_a_line(alpha):
    a = np.array([[3 + 4j, 0], [0.6 + 0.8j, 0], [3 + 0j, 4 + 0j]])
    size = np.array([5.0, 1.0, 5.0])
    assert contact_times(a, alpha) == pytest.approx(line_factor(alpha) * size ** (alpha - 1), rel=1e-12)


@any_exponent
def test_contact_times_on_a_circle(alpha):
    assert contact_times(np.array([[2.0, 2.0j]]), alpha) == pytest.approx(2.0 ** (alpha - 1), rel=1e-14)


# ---- the packing


@any_strain
def test_linear_drag_is_the_linear_modulus(strain):
    linear = pj.complex_modulus(sixteen(), OMEGA, strain=strain).values
    for stress in (1e-3, 10.0):
        uniform = equivalent_drag(sixteen(), OMEGA, stress, 1.0, strain=strain, rtol=1e-12)
        contact = self_consistent_drag(sixteen(), OMEGA, stress, 1.0, strain=strain)
        assert uniform.values == pytest.approx(linear, rel=1e-11)
        assert contact.values == pytest.approx(linear, rel=1e-11)


@any_exponent
def test_uniform_drag_is_the_linear_modulus_at_another_frequency(alpha):
    found = equivalent_drag(sixteen(), OMEGA, 0.1, alpha, rtol=1e-10)
    shifted = pj.complex_modulus(sixteen(), OMEGA * equivalent_time(OMEGA, 0.1, alpha)).values
    assert found.values == pytest.approx(shifted, rel=1e-9)


def test_uniform_drag_of_a_model_that_is_made_already():
    model = pj.spectrum(sixteen(), (1e-4, 1e3))
    expected = equivalent_drag(sixteen(), OMEGA, 0.1, 0.5)
    assert equivalent_drag(model, OMEGA, 0.1, 0.5).values == pytest.approx(expected.values, rel=1e-6)


def dense_twin(alpha, omega, stress, steps, strain="simple-shear", prestress=True):
    """The iteration with plain loops, dense algebra, and averages over a sampled cycle."""
    packing = sixteen()
    found = twin_contacts(packing)
    K = reference.hessian(found, packing.radii, strain, prestress)
    rows = [reference.rows(c, packing.radii, strain, arms=1) for c in found]
    tau = np.ones(len(found))
    for _ in range(steps):
        B = sum(t * (np.outer(n, n) + np.outer(s, s)) for t, (n, s) in zip(tau, rows, strict=True))
        A = K + 1j * omega * B
        # hold the first disk
        free = [k for k in range(len(A) - 1) if k not in (0, 1)]
        Q = np.zeros(len(A), complex)
        Q[-1] = 1
        Q[free] = -np.linalg.solve(A[np.ix_(free, free)], A[free, -1])
        G = Q @ A @ Q / packing.box.area
        for c, (n, s) in enumerate(rows):
            v = np.array([n @ Q, s @ Q])[:, None] * stress / G * 1j * omega * np.exp(1j * CYCLE)
            speed = np.hypot(*v.real) / packing.mean_diameter
            tau[c] = np.mean(speed ** (alpha + 1)) / np.mean(speed**2)
    return G, tau


@any_exponent
@any_prestress
def test_slow_twin(alpha, prestress):
    slow, _ = dense_twin(alpha, 0.3, 0.1, 40, prestress=prestress)
    fast = self_consistent_drag(sixteen(), [0.3], 0.1, alpha, prestress=prestress, rtol=1e-10)
    assert fast.values[0] == pytest.approx(slow, rel=1e-6)


def test_slow_twin_in_pure_shear():
    slow, _ = dense_twin(0.5, 0.3, 0.1, 40, strain="pure-shear")
    fast = self_consistent_drag(sixteen(), [0.3], 0.1, 0.5, strain="pure-shear", rtol=1e-10)
    assert fast.values[0] == pytest.approx(slow, rel=1e-6)


@any_strain
@any_exponent
def test_every_contact_dissipates_what_the_nonlinear_law_would(strain, alpha):
    """Along the path that the effective law makes, over a cycle, wherever the floor plays no part."""
    result = per_contact(alpha, strain=strain)
    found = twin_contacts(sixteen())
    network = pj.ContactNetwork.of(sixteen())
    rows = {(c.i, c.j, round(c.rx, 6), round(c.ry, 6)): reference.rows(c, sixteen().radii, strain, 1) for c in found}
    rows |= {(j, i, -x, -y): pair for (i, j, x, y), pair in rows.items()}
    ordered = [
        rows[i, j, round(x, 6), round(y, 6)]
        for i, j, (x, y) in zip(network.i.tolist(), network.j.tolist(), network.r.tolist(), strict=True)
    ]
    K = reference.hessian(found, sixteen().radii, strain)
    for omega, G, tau in zip(result.omega, result.values, result.contact_tau, strict=True):
        B = sum(t * (np.outer(n, n) + np.outer(s, s)) for t, (n, s) in zip(tau, ordered, strict=True))
        A = (K + 1j * omega * B)[2:, 2:]
        Q = np.append([0, 0], np.append(-np.linalg.solve(A[:-1, :-1], A[:-1, -1]), 1))
        per_strain = 0.1 / G / (2 if strain == "compression" else 1)  # ΔV/V is twice the strain there
        a = 1j * omega * per_strain * np.array([[n @ Q, s @ Q] for n, s in ordered])
        speed = np.linalg.norm((a[..., None] * np.exp(1j * CYCLE)).real, axis=1)
        linear = tau * np.mean(speed**2, axis=1)
        nonlinear = np.mean(speed ** (alpha + 1), axis=1) * sixteen().mean_diameter ** (1 - alpha)
        assert linear == pytest.approx(nonlinear, rel=1e-5, abs=1e-9 * linear.max())


def modulus_in_time(alpha, omega, stress, steps=64, cycles=2):
    """Stress over the fundamental of the strain, of Ku + Σ Aᵀ|Au̇/ρ0|^(α−1)Au̇ = f cos ωt, integrated.

    Dense, by the implicit midpoint rule: each step minimises a convex function of u̇, by Newton's method.
    """
    packing = sixteen()
    scale = packing.mean_diameter ** (1 - alpha)
    found = twin_contacts(packing)
    A = np.array([reference.rows(c, packing.radii, "simple-shear", 1) for c in found])[:, :, 2:]
    K = reference.hessian(found, packing.radii)[2:, 2:]  # the first disk is held
    both, dt = A.reshape(-1, len(K)), 2 * np.pi / omega / steps
    f = np.zeros(len(K))
    f[-1] = stress * packing.box.area
    tau = dense_twin(alpha, omega, stress, 10)[1]  # a start near the cycle
    first = np.linalg.solve(K + 1j * omega * np.einsum("c,ckd,cke->de", tau, A, A), f)
    u, v = first.real, (1j * omega * first).real
    tiny = 1e-10 * omega**2 * np.mean(abs(both @ first) ** 2)

    def cost(v, rest):
        speed = ((both @ v).reshape(-1, 2) ** 2).sum(1) + tiny
        return scale * (speed ** ((alpha + 1) / 2)).sum() / (alpha + 1) + v @ rest + v @ K @ v * dt / 4

    strain, times = [], dt * np.arange(steps * cycles)
    for t in times:
        rest = K @ u - f * np.cos(omega * (t + dt / 2))
        for _ in range(100):
            w = (both @ v).reshape(-1, 2)
            square = (w**2).sum(1) + tiny
            rub = scale * square ** ((alpha - 1) / 2)
            force = both.T @ (rub[:, None] * w).ravel() + rest + K @ v * dt / 2
            if abs(force).max() < 1e-9 * f[-1]:
                break
            along = np.eye(2) + (alpha - 1) * w[:, :, None] * w[:, None, :] / square[:, None, None]
            rubbed = np.einsum("c,ckl,cld->ckd", rub, along, A).reshape(both.shape)
            move, before = -np.linalg.solve(both.T @ rubbed + K * dt / 2, force), cost(v, rest)
            while cost(v + move, rest) > before + 1e-13 * abs(before):
                move = move / 2
            v = v + move
        else:
            raise AssertionError("a step did not converge")
        u = u + dt * v
        strain.append(u[-1])
    last = slice(-steps, None)
    return stress / (2 * np.mean(np.array(strain)[last] * np.exp(-1j * omega * (times[last] + dt))))


@any_exponent
@pytest.mark.parametrize("omega", [1e-3, 1e-2])
def test_true_motion_in_time(alpha, omega):
    """G* per contact is within 5 % of the motion in time; with one time for all it is ten times as far."""
    true = modulus_in_time(alpha, omega, 0.1)
    contact = self_consistent_drag(sixteen(), [omega], 0.1, alpha).values[0]
    uniform = equivalent_drag(sixteen(), [omega], 0.1, alpha).values[0]
    assert abs(contact / true - 1) < 0.05
    assert abs(uniform / true - 1) > 10 * abs(contact / true - 1)


@any_exponent
def test_all_amplitudes_follow_from_one(alpha):
    """G* depends on ω^α δσ^(α−1) alone: at another amplitude it is the same, at other frequencies."""
    contact = per_contact(alpha)
    uniform = equivalent_drag(sixteen(), OMEGA, 0.1, alpha, rtol=1e-11)
    for stress in (1e-3, 3.0):
        moved = contact.at(stress)
        solved = self_consistent_drag(sixteen(), moved.omega, stress, alpha, rtol=1e-9)
        assert moved.values == pytest.approx(solved.values, rel=1e-8)
        assert moved.tau == pytest.approx(solved.tau, rel=1e-7)
        solved = equivalent_drag(sixteen(), moved.omega, stress, alpha, rtol=1e-11)
        assert uniform.at(stress).values == pytest.approx(solved.values, rel=1e-9)


@any_exponent
def test_quasistatic_loss_is_a_power_of_frequency_and_stress(alpha):
    """G″ ~ ω^α δσ^(α−1) (BT eq. 27)."""
    make = [
        lambda omega, stress: equivalent_drag(sixteen(), [omega], stress, alpha, rtol=1e-10),
        lambda omega, stress: self_consistent_drag(sixteen(), [omega], stress, alpha, rtol=1e-9),
    ]
    for drag in make:
        loss = drag(1e-10, 1.0).values[0].imag
        assert drag(1e-11, 1.0).values[0].imag == pytest.approx(loss * 0.1**alpha, rel=1e-4)
        assert drag(1e-10, 10.0).values[0].imag == pytest.approx(loss * 10 ** (alpha - 1), rel=1e-4)


@any_exponent
def test_the_floor_does_not_matter(alpha):
    """Here: a floor a thousand times as high moves G* by less than 1e-5."""
    low, high = per_contact(alpha), per_contact(alpha, floor=1e-3)
    assert (abs(high.values / low.values - 1) < 1e-5).all()


def test_the_start_does_not_matter():
    """Each frequency starts from its neighbour; alone it comes to the same."""
    alone = [self_consistent_drag(sixteen(), [w], 0.1, 0.5, rtol=1e-9).values[0] for w in OMEGA]
    assert per_contact(0.5).values == pytest.approx(np.array(alone), rel=1e-8)


def test_shear_thickening_drag_converges():
    slow, _ = dense_twin(1.5, 0.3, 0.1, 60)
    fast = self_consistent_drag(sixteen(), [0.3], 0.1, 1.5, rtol=1e-10)
    assert fast.values[0] == pytest.approx(slow, rel=1e-6)


def test_remaining_change_is_the_distance_to_the_end():
    """To first order, where little is left: α = 2/3 leaves about a third of it to the iterations after."""
    few = self_consistent_drag(sixteen(), [0.3], 0.1, 2 / 3, most_iterations=4)
    end = self_consistent_drag(sixteen(), [0.3], 0.1, 2 / 3, rtol=1e-11)
    assert 0.3 < abs(few.values[0] / end.values[0] - 1) / few.changes[0] < 3


def test_what_did_not_converge_is_marked():
    found = self_consistent_drag(sixteen(), [1e-3, 1.0], 0.1, 0.5, most_iterations=2)
    assert not found.converged.any()
    assert "not converged in 2 iterations at ω = 0.001, 1" in found.notes[-1]


def test_frequencies_come_back_in_their_order():
    upside_down = self_consistent_drag(sixteen(), OMEGA[::-1], 0.1, 0.5, rtol=1e-9)
    assert (upside_down.omega == OMEGA[::-1]).all()
    assert upside_down.values[::-1] == pytest.approx(per_contact(0.5).values, rel=1e-8)


@pytest.mark.parallel(nprocs=[1, 2, 3])
def test_ranks_agree(comm):
    omega = [1e-3, 1.0]
    alone = self_consistent_drag(sixteen(), omega, 0.1, 0.5, rtol=1e-10, comm=comm.Split(comm.rank))
    found = self_consistent_drag(sixteen(), omega, 0.1, 0.5, rtol=1e-10, comm=comm)
    assert found.values == pytest.approx(alone.values, rel=1e-9)
    assert found.contact_tau == pytest.approx(alone.contact_tau, rel=1e-7)
    everywhere = comm.allgather((found.values.tobytes(), found.contact_tau.tobytes(), found.iterations.tobytes()))
    assert len(set(everywhere)) == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"alpha": 0.0}, "alpha: must be from 0.01 to 100, not 0.0"),
        ({"alpha": np.nan}, "alpha: must be from 0.01 to 100, not nan"),
        ({"alpha": 100.0, "stress": 1e-3, "omegas": [1e-2]}, "equivalent time at omega = 0.01 is 10"),
        ({"stress": -1.0}, "stress: must be from .*, not -1.0"),
        ({"stress": "1"}, "stress: must be from .*, not '1'"),
        ({"omegas": [1.0, 0.0]}, "omega: frequencies must be from .*, not 0"),
        ({"omegas": []}, "omega: the range is empty"),
        ({"strain": "twist"}, "strain: 'twist' is unknown"),
    ],
)
@pytest.mark.parametrize("drag", [equivalent_drag, self_consistent_drag])
def test_bad_input(drag, change, message):
    with pytest.raises(pj.InputError, match=message):
        drag(sixteen(), **{"omegas": [1.0], "stress": 0.1, "alpha": 0.5, **change})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"floor": 0.0}, "floor: must be > 0 and at most 0.1, not 0.0"),
        ({"rtol": 1.0}, "rtol: must be > 0 and at most 0.1, not 1.0"),
        ({"most_iterations": 0}, "most_iterations: must be at least 1, not 0"),
    ],
)
def test_bad_settings(change, message):
    with pytest.raises(pj.InputError, match=message):
        self_consistent_drag(sixteen(), [1.0], 0.1, 0.5, **change)


def test_a_model_that_does_not_reach():
    model = pj.spectrum(sixteen(), (1e-2, 1.0))
    with pytest.raises(pj.InputError, match=r"the span of the model from 0\.01 to 1"):
        equivalent_drag(model, [1.0], 0.1, 0.5)


def test_a_model_of_another_law():
    model = pj.spectrum(sixteen(), (1e-2, 1e2), damping=pj.StokesDrag())
    with pytest.raises(pj.InputError, match="does not act on contacts"):
        equivalent_drag(model, [1.0], 0.1, 0.5)


def test_options_of_a_model_that_is_made_already():
    model = pj.spectrum(sixteen(), (1e-2, 1e2))
    with pytest.raises(pj.InputError, match="prestress: the reduced model is made already"):
        equivalent_drag(model, [1.0], 0.1, 0.5, prestress=False)


def test_figure(tmp_path):
    results = {
        f"{drag.__name__} {stress}": drag(sixteen(), OMEGA, stress, 0.5)
        for drag in (equivalent_drag, self_consistent_drag)
        for stress in (0.01, 0.1)
    }
    plot_results(results, tmp_path / "drag.png")
    assert (tmp_path / "drag.png").stat().st_size > 20_000
