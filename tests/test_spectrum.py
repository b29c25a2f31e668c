"""Facts that a reduced model and its error bound obey: direct solves, dense algebra, integration in time."""

from dataclasses import dataclass, fields, replace
from functools import cache
from typing import ClassVar

import helpers
import numpy as np
import pytest
from helpers import (
    any_prestress,
    any_strain,
    jammed,
    jax_md,
    sixteen,
    triangular_lattice,
    twin_contacts,
    twin_matrices,
    with_a_rattler,
)
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.linalg import expm
from test_published import OMEGA, PRINTED, TABLE

import petscjam as pj
from petscjam.reference import linear as reference
from petscjam.rows.damping import LAWS, DampingLaw

SPAN = (1e-8, 1e2)
NARROW = (1e-3, 1e-1)
EVERY_LAW = [*helpers.EVERY_LAW, pj.StokesDrag(eta_fluid=0.0)]
TWO_LAWS = [pj.ContactDamping(), pj.StokesDrag(eta_fluid=1.0)]
PRESSURES = [1e-2, 1e-5]
TOLERANCES = [1e-2, 1e-5]  # loose: the errors are large enough to be seen
DIRECT = 1e-11  # allowed for the direct solve: at p = 1e-5 rounding alone moves G* by up to 5e-12

any_law = pytest.mark.parametrize("law", EVERY_LAW, ids=str)
two_laws = pytest.mark.parametrize("law", TWO_LAWS, ids=str)
any_pressure = pytest.mark.parametrize("pressure", PRESSURES)


@cache
def _model(packing, rtol, span, law, strain, prestress):
    return pj.spectrum(packing, span, damping=law, strain=strain, prestress=prestress, rtol=rtol)


def model(packing, rtol=1e-6, span=SPAN, law=None, strain="simple-shear", prestress=True):
    """Made once for each packing above: packings hash by identity."""
    return _model(packing, rtol, span, law, strain, prestress)


def random_frequencies(span, count=12, seed=0):
    low, high = np.log(span)
    return np.exp(np.sort(np.random.default_rng(seed).uniform(low, high, count)))


@cache
def _direct(packing, law, strain, prestress, span):
    omega = random_frequencies(span)
    return pj.complex_modulus(packing, omega, damping=law, strain=strain, prestress=prestress)


def direct(packing, law=None, strain="simple-shear", prestress=True, span=SPAN):
    """G* by one factorisation a frequency, at random ones."""
    return _direct(packing, law, strain, prestress, span)


# ---- the lemma


def semi_definite(rng, n, rank):
    X = rng.standard_normal((n, rank)) * 10.0 ** rng.uniform(-2, 2, rank)
    return X @ X.T


@st.composite
def pairs(draw):
    """K and B ⪰ 0, singular or not, that no motion escapes both; ω and ω_k."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, 6))
    stiff = draw(st.integers(0, n))
    rubbed = draw(st.integers(n - stiff, n))
    K, B = semi_definite(rng, n, stiff), semi_definite(rng, n, rubbed)
    omega, node = (10.0 ** draw(st.floats(-4, 4)) for _ in range(2))
    for w in (omega, node):
        size = np.sqrt(np.diag(K + w * B))
        assume(np.all(size > 0) and np.linalg.cond((K + w * B) / np.outer(size, size)) < 1e8)
    return K, B, omega, node, rng


def gain(K, B, omega, r):
    """r†(K + iωB)⁻¹r, and rᵀ(K + iωB)⁻¹r."""
    x = np.linalg.solve(K + 1j * omega * B, r)
    return np.vdot(r, x), r @ x


ROOM = 1 + 1e-6  # of the dense solves, with condition numbers up to 1e8


@given(pairs())
def test_what_a_residual_does_is_bounded_by_its_gain_at_a_node(pair):
    K, B, omega, node, rng = pair
    r = rng.standard_normal(len(K)) + 1j * rng.standard_normal(len(K))
    known = gain(K, B, node, r)[0]
    assert abs(gain(K, B, omega, r)[1]) <= ROOM * max(1, node / omega) * (known.real - known.imag)


@given(pairs())
def test_the_real_part_of_a_gain_is_bounded_by_that_at_a_node(pair):
    K, B, omega, node, rng = pair
    R = rng.standard_normal(len(K))
    F, known = gain(K, B, omega, R)[1], gain(K, B, node, R)[1]
    assert F.real <= ROOM * max(1, (node / omega) ** 2) * known.real + 1e-9 * abs(F)


@given(pairs())
def test_the_imaginary_part_of_a_gain_is_bounded_by_that_at_a_node(pair):
    K, B, omega, node, rng = pair
    R = rng.standard_normal(len(K))
    F, known = gain(K, B, omega, R)[1], gain(K, B, node, R)[1]
    assert -F.imag <= ROOM * max(node / omega, omega / node) * -known.imag + 1e-9 * abs(F)


@given(pairs(), st.floats(0, 1))
def test_between_two_nodes_the_bound_is_tight(pair, share):
    """By the factor √2 √(ω_b/ω_a) of docs/theory.md at most."""
    K, B, low, high, rng = pair
    low, high = sorted([low, high])
    omega = low * (high / low) ** share
    R = rng.standard_normal(len(K))
    known = [(node, gain(K, B, node, R)[1]) for node in (low, high)]
    bound = min(max(1, node / omega) * (F.real - F.imag) for node, F in known)
    assert bound <= ROOM * np.sqrt(2 * high / low) * abs(gain(K, B, omega, R)[1])


# ---- published numbers


@pytest.mark.parallel(nprocs=[1, 2, 3])
@pytest.mark.parametrize("case", TABLE)
def test_modulus_of_sixteen_disks_is_the_published_one(comm, case):
    law, prestress, expected, _ = TABLE[case]
    s = pj.spectrum(sixteen(), damping=law, prestress=prestress, comm=comm)
    allowed = s.error(OMEGA) * np.abs(expected) + 2 * PRINTED  # both parts are rounded
    assert (np.abs(s(OMEGA) - expected) <= allowed).all()


@pytest.mark.parametrize("case", TABLE)
def test_a_tight_model_of_sixteen_disks_is_the_published_one_to_every_digit(case):
    law, prestress, expected, _ = TABLE[case]
    values = model(sixteen(), 1e-10, law=law, prestress=prestress)(OMEGA)
    assert np.abs(values.real - np.real(expected)).max() <= PRINTED
    assert np.abs(values.imag - np.imag(expected)).max() <= PRINTED


@pytest.mark.parametrize("case", TABLE)
def test_the_tolerance_is_met_for_sixteen_disks(case):
    law, prestress, *_ = TABLE[case]
    s = model(sixteen(), law=law, prestress=prestress)
    assert s.error(np.geomspace(*SPAN, 300)).max() <= 1e-6
    assert s.notes == ()


@pytest.mark.parametrize("case", TABLE)
def test_low_frequency_viscosity_of_sixteen_disks_is_the_published_one(case):
    law, prestress, _, expected = TABLE[case]
    s = model(sixteen(), law=law, prestress=prestress)
    assert abs(s.eta0 - expected) <= s.limit_errors[0, 1] * expected + 10 * PRINTED


def test_shear_modulus_of_sixteen_disks_is_that_of_its_own_shear_log():
    s = model(sixteen())
    assert abs(s.G0 - 0.1088011) <= s.limit_errors[0, 0] * 0.1088011 + 5e-8


# ---- the error bound against direct solves


def test_every_law_is_tested():
    assert {type(law) for law in EVERY_LAW} == set(LAWS.values())


@any_pressure
@any_prestress
@any_strain
@any_law
def test_direct_solves_are_within_the_bound(law, strain, prestress, pressure):
    g = direct(jammed(pressure), law, strain, prestress)
    for rtol in TOLERANCES:
        s = model(jammed(pressure), rtol, SPAN, law, strain, prestress)
        assert s.definite
        assert (np.abs(s(g.omega) / g.values - 1) <= s.error(g.omega) + DIRECT).all()


@any_pressure
@any_prestress
@any_strain
@any_law
def test_storage_and_loss_of_direct_solves_are_within_their_bounds(law, strain, prestress, pressure):
    g = direct(jammed(pressure), law, strain, prestress)
    for rtol in TOLERANCES:
        s = model(jammed(pressure), rtol, SPAN, law, strain, prestress)
        values, (storage, loss) = s(g.omega), s.part_errors(g.omega)
        rounding = DIRECT * np.abs(g.values)
        for ours, exact, bound in ((values.real, g.values.real, storage), (values.imag, g.values.imag, loss)):
            assert (np.abs(ours - exact) <= bound * np.abs(exact) + rounding).all()


@any_pressure
@any_prestress
@any_strain
@any_law
def test_the_bound_is_within_a_factor_of_a_hundred(law, strain, prestress, pressure):
    g = direct(jammed(pressure), law, strain, prestress)
    for rtol in TOLERANCES:
        s = model(jammed(pressure), rtol, SPAN, law, strain, prestress)
        error, bound = np.abs(s(g.omega) / g.values - 1), s.error(g.omega)
        seen = error > 1e-10
        assert (bound[seen] <= 100 * error[seen]).all()
        # a model that is exact but for rounding after two or three nodes: nothing is left to be seen
        assert seen.any() or (s.factorisations <= 3 and bound.max() < 1e-7)


@any_pressure
@any_law
def test_the_tolerance_is_met_on_a_finer_grid_than_it_was_asked_on(law, pressure):
    omega = np.geomspace(*SPAN, 2000)
    for rtol in TOLERANCES:
        assert model(jammed(pressure), rtol, SPAN, law).error(omega).max() <= 1.01 * rtol


@pytest.mark.parametrize("span", [NARROW, (0.5, 1.0), (10.0, 100.0)], ids=str)
@two_laws
def test_outside_its_span_a_model_is_within_the_bound(law, span):
    g = direct(jammed(1e-2), law, span=(1e-10, 1e5))
    s = model(jammed(1e-2), 1e-4, span, law)
    error, bound = np.abs(s(g.omega) - g.values), s.error(g.omega)
    assert (np.isfinite(bound) & (error > 1e-10 * np.abs(g.values))).sum() >= 2  # farther off it is infinite
    assert (error <= bound * np.abs(s(g.omega)) + DIRECT * np.abs(g.values)).all()


@pytest.mark.parametrize("rtol", [1e-6, 1e-12])
@pytest.mark.parametrize("width", [1.01, 1.05, 1.2, 2.0])
@two_laws
def test_a_model_of_a_narrow_span_is_within_the_bound_everywhere(law, width, rtol):
    """A span of a few grid points or none between its ends; far away the errors are of order one."""
    g = direct(jammed(1e-2), law, span=(1e-10, 1e5))
    s = model(jammed(1e-2), rtol, (1.0, width), law)
    error = np.abs(s(g.omega) - g.values) / np.abs(s(g.omega))
    assert (np.isfinite(s.error(g.omega)) & (error > 1e-10)).sum() >= 3
    assert (error <= s.error(g.omega) + DIRECT).all()


@pytest.mark.parametrize("width", [1.01, 1.05, 1.2, 2.0])
@two_laws
def test_between_the_ends_of_a_narrow_span_a_model_is_within_the_bound(law, width):
    omega = np.geomspace(1.0, width, 9)
    g = pj.complex_modulus(jammed(1e-2), omega, damping=law)
    s = model(jammed(1e-2), 1e-12, (1.0, width), law)
    rounding = 1e-13  # of a direct solve at ω ≈ 1 and this pressure
    assert (np.abs(s(omega) / g.values - 1) <= s.error(omega) + rounding).all()


@two_laws
def test_the_bounds_on_the_parts_are_relative_to_the_true_ones(law):
    """Not to those of the model, which far outside the span can be larger by orders of magnitude."""
    g = direct(jammed(1e-2), law, strain="compression", span=(1e-2, 1e5))
    s = model(jammed(1e-2), 1e-3, NARROW, law, "compression")
    for part, bound in zip(("real", "imag"), s.part_errors(g.omega), strict=True):
        ours, exact = getattr(s(g.omega), part), getattr(g.values, part)
        assert np.isfinite(bound).sum() >= 3
        assert (np.abs(ours - exact) <= bound * np.abs(exact) + DIRECT * np.abs(g.values)).all()


@pytest.mark.parametrize("rtol", [0.1, *TOLERANCES])
@two_laws
def test_a_rattler_does_not_spoil_the_bound(law, rtol):
    packing = with_a_rattler()
    g = pj.complex_modulus(packing, random_frequencies(SPAN, 40), damping=law)
    s = pj.spectrum(packing, SPAN, damping=law, rtol=rtol)
    assert (np.abs(s(g.omega) / g.values - 1) <= s.error(g.omega) + DIRECT).all()


@two_laws
def test_a_rattler_does_not_loosen_the_bound(law):
    """At the loosest tolerance and with ten decades between the nodes, where rounding shows first."""
    packing = with_a_rattler()
    g = pj.complex_modulus(packing, np.geomspace(1e-4, 1e-2, 40), damping=law)
    s = pj.spectrum(packing, SPAN, damping=law, rtol=0.1)
    error = np.abs(s(g.omega) / g.values - 1)
    seen = error > 1e-10
    assert seen.sum() >= 20
    assert (s.error(g.omega)[seen] <= 100 * error[seen]).all()


@two_laws
def test_a_rattler_that_touches_nobody_changes_no_gain(law):
    without, s = model(sixteen(), 0.1, SPAN, law), pj.spectrum(with_a_rattler(), SPAN, damping=law, rtol=0.1)
    assert np.array_equal(s.nodes, without.nodes)
    assert s.gains == pytest.approx(without.gains, rel=1e-3)


def test_a_rattler_that_touches_nobody_moves_with_the_fluid():
    """Exactly, at any frequency: its non-affine displacement is zero, and so is the mean of the others."""
    s = pj.spectrum(with_a_rattler(), SPAN, damping=pj.StokesDrag(1.0))
    field = s.displacement(1e-8)
    assert abs(field[16]).max() <= 1e-14
    assert abs(field[:16].mean(0)).max() <= 1e-14


def test_a_tolerance_below_rounding_is_met_or_called_so():
    """Rounding is of order 1e-14 here; so a bound of a thousand times as much says nothing."""
    s = pj.spectrum(
        jammed(1e-3, 24, 23),
        (1e-5, 1.0),
        damping=pj.ContactDamping(beta=0.01),
        strain="compression",
        prestress=False,
        rtol=1e-12,
    )
    assert s.error(np.geomspace(1e-5, 1.0, 50)).max() <= 1e-10
    assert s.factorisations <= 12


@pytest.mark.parametrize("span", [SPAN, NARROW, (0.5, 1.0)], ids=str)
@pytest.mark.parametrize("law", TWO_LAWS, ids=str)
def test_a_crystal_moves_as_the_cell_does(law, span):
    """A triangular lattice: no motion beyond the affine one but rounding, so nothing to learn."""
    s = pj.spectrum(triangular_lattice(6), span, damping=law, prestress=False)
    assert s.error(np.geomspace(*span, 30)).max() <= 1e-12
    assert s.factorisations <= 3


# ---- the error bound against dense algebra


def dense(packing, law, strain="simple-shear", prestress=True):
    """K and B of the slow twin on the unknowns, γ last, and p; where B sees no translation a disk is held."""
    K, B, pressure = twin_matrices(packing, law, strain, prestress)
    first = min(min(c.i, c.j) for c in twin_contacts(packing))
    held = [] if law.body else [2 * first, 2 * first + 1]
    free = (np.diag(K) != 0) | (np.diag(B) != 0)
    free[-1], free[held] = True, False
    return K[np.ix_(free, free)], B[np.ix_(free, free)], pressure


def galerkin_residual(K, B, nodes):
    """Return ω ↦ the residual of the model of these nodes: q at the two ends, q and dq/dω at the others."""
    (k, K), (b, B) = ((form[:-1, -1], form[:-1, :-1]) for form in (K, B))
    start, columns = np.zeros(len(k)), []
    for index, omega in enumerate(nodes):
        A = K + 1j * omega * B
        q = -np.linalg.solve(A, k + 1j * omega * b)
        start = q.real if index == 0 else start
        columns += [q.real - start] * (index > 0) + [q.imag]
        if index > 1:
            slope = np.linalg.solve(A, b + B @ q)
            columns += [slope.real, slope.imag]
    V = np.empty((len(k), 0))
    for column in columns:
        v = column
        for _ in range(2):
            v = v - V @ (V.T @ v)
        V = np.column_stack([V, v / np.linalg.norm(v)])

    def residual(omega):
        A, f = K + 1j * omega * B, k + 1j * omega * b
        force = A @ start + f
        return force - A @ (V @ np.linalg.solve(V.T @ A @ V, V.T @ force))

    return residual


def direction(r):
    """The real direction of a complex vector that is a number times a real one, and how far it is not."""
    R = (r * np.exp(-0.5j * np.angle(r @ r))).real
    R /= np.linalg.norm(R)
    return R, np.linalg.norm(r - R * (R @ r)) / np.linalg.norm(r)


def modelled(law):
    """A model that leaves residuals far above rounding, and the dense pair."""
    s = model(sixteen(), 1e-2, (1e-2, 1e1), law)
    return s, *dense(sixteen(), law)[:2]


LEARNING_LAWS = [law for law in EVERY_LAW if law != pj.ContactDamping(beta=0.0)]  # that one is soon exact


@pytest.mark.parametrize("law", LEARNING_LAWS, ids=str)
def test_the_residual_has_one_direction_at_all_frequencies(law):
    s, K, B = modelled(law)
    residual = galerkin_residual(K, B, s.nodes)
    R, _ = direction(residual(0.3))
    for omega in (1e-4, 0.03, 2.0, 1e3):
        r = residual(omega)
        assert np.linalg.norm(r - R * (R @ r)) <= 1e-6 * np.linalg.norm(r)


@pytest.mark.parametrize("law", LEARNING_LAWS, ids=str)
def test_the_residuals_are_those_of_dense_algebra(law):
    s, K, B = modelled(law)
    residual = galerkin_residual(K, B, s.nodes)
    omega = np.array([1e-4, 0.03, 0.3, 2.0, 1e3])
    forcing = [np.linalg.norm(s.forcing * np.array([1, w])) for w in omega]
    expected = [np.linalg.norm(residual(w)) / f for w, f in zip(omega, forcing, strict=True)]
    assert s.residuals(omega) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("law", LEARNING_LAWS, ids=str)
def test_the_gains_are_those_of_the_dense_inverse(law):
    """Rᵀ(K + iω_kB)⁻¹R at every node, though the solver never saw R."""
    s, K, B = modelled(law)
    R, _ = direction(galerkin_residual(K, B, s.nodes)(0.3))
    expected = [R @ np.linalg.solve((K + 1j * w * B)[:-1, :-1], R) for w in s.nodes]
    assert len(s.gains) == s.factorisations > 1
    assert s.gains == pytest.approx(np.array(expected), rel=1e-6)


# ---- what the model is


@any_pressure
@any_strain
@any_law
def test_the_reduced_pair_is_semi_definite(law, strain, pressure):
    s = model(jammed(pressure), 1e-6, SPAN, law, strain, prestress=False)
    for form in (s.K, s.B):
        values = np.linalg.eigvalsh(form)
        assert values[0] >= -1e-13 * values[-1]


@any_pressure
@any_prestress
@any_strain
@any_law
def test_relaxations_have_positive_times_and_weights(law, strain, prestress, pressure):
    times, weights = model(jammed(pressure), 1e-6, SPAN, law, strain, prestress).relaxation()
    assert len(times) == len(weights) > 0
    assert (np.diff(times) >= 0).all()
    assert (times > 0).all()
    assert (weights >= 0).all()


@any_pressure
@any_law
def test_the_loss_is_never_negative(law, pressure):
    omega = np.geomspace(1e-14, 1e10, 200)
    for rtol in TOLERANCES:
        assert (model(jammed(pressure), rtol, SPAN, law)(omega).imag >= 0).all()


@any_pressure
@any_law
def test_storage_never_falls_with_frequency(law, pressure):
    values = model(jammed(pressure), 1e-2, SPAN, law)(np.geomspace(1e-12, 1e6, 200)).real
    assert (np.diff(values) >= -1e-11 * values[-1]).all()


@any_pressure
@any_prestress
@any_strain
@any_law
def test_the_modulus_is_the_sum_of_its_relaxations(law, strain, prestress, pressure):
    """Up to rounding, of G* and of the friction of the quasi-static motion, most of which relaxations cancel."""
    s = model(jammed(pressure), 1e-6, SPAN, law, strain, prestress)
    omega = np.geomspace(*SPAN, 60)
    rounding = np.finfo(float).eps * (1 + omega * abs(s.eta0) / abs(s(omega)))
    assert (s.kramers_kronig(omega) < 1000 * rounding).all()


@pytest.mark.parametrize("law", [pj.ContactDamping(), pj.StokesDrag(1.0)], ids=str)
@pytest.mark.parametrize("omega", [1e-3, 0.03, 1.0])
def test_kramers_kronig_integral(law, omega):
    """G′(ω) − G0 = (2ω²/π) ⨍ (G″(x)/x)/(ω² − x²) dx, the viscosity η∞ adding nothing.

    The grid is even in log x and meets ω half-way between two points, where the principal value of the
    subtracted pole vanishes by symmetry.
    """
    step = 0.02
    x = omega * np.exp(step * (np.arange(-1000, 1000) + 0.5))
    s = model(jammed(1e-2), 1e-6, SPAN, law)
    integrand = (s(x).imag / x - s(omega).imag / omega) / (omega**2 - x**2) * x
    shift = 2 * omega**2 / np.pi * step * integrand.sum()
    assert s(omega).real - s.G0 == pytest.approx(shift, rel=1e-3)


@two_laws
def test_the_power_balance_closes(law):
    assert model(jammed(1e-2), law=law).power_balance(np.geomspace(1e-10, 1e4, 60)).max() < 1e-12


@pytest.mark.parametrize("seed", range(3))
def test_stokes_drag_is_its_modal_sum(seed):
    packing = jammed(1e-2, 32, seed)
    K = reference.hessian(twin_contacts(packing, rattlers=True), packing.radii)
    omega = random_frequencies(SPAN, 20, seed)
    by_hand = np.array([reference.stokes_modal_sum(K, w, packing.box.area, 0.7) for w in omega])
    for rtol in TOLERANCES:
        s = model(packing, rtol, SPAN, pj.StokesDrag(0.7))
        assert (np.abs(s(omega) / by_hand - 1) <= s.error(omega) + 1e-13).all()


@any_pressure
@any_strain
def test_without_tangential_damping_and_prestress_it_is_a_kelvin_voigt_solid(strain, pressure):
    s = model(jammed(pressure), 1e-6, SPAN, pj.ContactDamping(beta=0.0), strain, prestress=False)
    omega = np.geomspace(1e-12, 1e6, 40)
    assert s(omega) == pytest.approx(s.G0 * (1 + 1j * omega), rel=1e-10)
    assert s.eta0 == pytest.approx(s.G0, rel=1e-10)


@any_pressure
@any_strain
def test_a_kelvin_voigt_solid_takes_two_factorisations(strain, pressure):
    s = model(jammed(pressure), 1e-6, SPAN, pj.ContactDamping(beta=0.0), strain, prestress=False)
    assert s.factorisations <= 2


@any_pressure
@any_strain
def test_a_kelvin_voigt_solid_has_finite_numbers_only(strain, pressure):
    s = model(jammed(pressure), 1e-6, SPAN, pj.ContactDamping(beta=0.0), strain, prestress=False)
    omega, wide = np.geomspace(*SPAN, 40), np.geomspace(1e-12, 1e6, 40)
    for array in (
        s(wide),
        s.error(omega),
        *s.part_errors(omega),
        s.residuals(wide),
        s.kramers_kronig(wide),
        *s.relaxation(),
        s.G(wide),
        s.J(wide),
        s.limits,
        s.limit_errors,
    ):
        assert np.isfinite(array).all()


def test_where_the_residual_is_all_rounding_nothing_is_promised_beyond_the_span():
    s = model(jammed(1e-2), 1e-6, (1.0, 1.0))
    assert s.error(1.0) < 1e-9
    assert s.error(1e-3) == np.inf


@two_laws
def test_a_span_on_a_plateau_is_bounded(law):
    s = model(jammed(1e-2), 1e-6, (1e-8, 1e-6), law)
    assert s.error(np.geomspace(1e-8, 1e-6, 50)).max() < 1e-9
    assert s.factorisations <= 3


# ---- limits


@any_pressure
@any_prestress
@any_law
def test_limits_are_within_their_errors_of_the_exact_ones(law, prestress, pressure):
    g = direct(jammed(pressure), law, prestress=prestress)
    exact = np.array([[g.G0, g.eta0], [g.G_inf, g.eta_inf]])
    for rtol in TOLERANCES:
        s = model(jammed(pressure), rtol, SPAN, law, prestress=prestress)
        size = np.maximum(np.abs(exact), np.abs(s.limits))  # η∞ is zero without the fluid
        assert (np.abs(s.limits - exact) <= (s.limit_errors + 1e-9) * size + 1e-15).all()


@any_law
def test_limits_far_from_a_narrow_span_are_solved_for(law):
    g = direct(jammed(1e-2), law)
    s = model(jammed(1e-2), 1e-6, NARROW, law)
    expected = [g.G0, g.eta0, g.G_inf, g.eta_inf]
    assert [s.G0, s.eta0, s.G_inf, s.eta_inf] == pytest.approx(expected, rel=1e-8, abs=1e-15)


# ---- in time


def strain_step(K, B, times):
    """V·stress after a unit step of strain at t = 0, less its δ: B_uu dq/dt + K_uu q + K_uγ = 0."""
    B_uu, n = B[:-1, :-1], len(K) - 1
    flow = np.zeros((n + 1, n + 1))
    flow[:n] = -np.linalg.solve(B_uu, K[:-1])  # the constant 1 stands last
    start = np.append(-np.linalg.solve(B_uu, B[:-1, -1]), 1.0)
    stress = []
    for t in times:
        q = expm(flow * t) @ start
        stress.append(K[-1] @ q + B[-1, :-1] @ (flow[:n] @ q))
    return np.array(stress)


def stress_step(K, B, times, force):
    """Strain after a step to V·stress = ``force``: B dQ/dt + KQ = force e_γ; where B_γγ = 0, γ follows q."""
    if B[-1, -1] == 0:
        K_gg, k = K[-1, -1], K[:-1, -1]
        K, drive = K[:-1, :-1] - np.outer(k, k) / K_gg, -k * force / K_gg
        Q = _driven(K, B[:-1, :-1], drive, times)
        return (force - Q @ k) / K_gg
    return _driven(K, B, np.append(np.zeros(len(K) - 1), force), times)[:, -1]


def _driven(K, B, drive, times):
    n = len(K)
    flow = np.zeros((n + 1, n + 1))
    flow[:n] = np.linalg.solve(B, np.column_stack([-K, drive]))
    return np.array([(expm(flow * t)[:n, n]) for t in times])


TIMES = np.array([0.0, 1e-4, 1e-2, 0.3, 1.0, 7.0, 30.0, 200.0, 1e3])
SCALE = {"simple-shear": 1.0, "pure-shear": 1.0, "compression": 0.25}


@any_strain
@any_law
def test_stress_after_a_step_of_strain_is_that_of_direct_integration(law, strain):
    K, B, pressure = dense(sixteen(), law, strain)
    s = model(sixteen(), 1e-10, (1e-8, 1e4), law, strain)
    V = sixteen().box.area
    expected = SCALE[strain] * strain_step(K, B, TIMES) / V + (strain == "compression") * pressure / 2
    assert s.G(TIMES) == pytest.approx(expected, rel=1e-8)


@any_strain
@any_law
def test_strain_after_a_step_of_stress_is_that_of_direct_integration(law, strain):
    K, B, pressure = dense(sixteen(), law, strain)
    s = model(sixteen(), 1e-10, (1e-8, 1e4), law, strain)
    V = sixteen().box.area
    if strain == "compression":  # the bulk modulus is A_eff/4V + p/2
        K[-1, -1] += 2 * pressure * V
    assert s.J(TIMES) == pytest.approx(stress_step(K, B, TIMES, V / SCALE[strain]), rel=1e-8, abs=1e-14)


@any_law
def test_creep_starts_with_the_compliance_of_high_frequency(law):
    s, g = model(jammed(1e-2), law=law), direct(jammed(1e-2), law)
    assert s.J(0.0) == pytest.approx(0.0 if g.eta_inf > 0 else 1 / g.G_inf, rel=1e-5, abs=1e-12)


@any_law
def test_creep_ends_at_the_compliance_of_low_frequency(law):
    s, g = model(jammed(1e-2), law=law), direct(jammed(1e-2), law)
    assert s.J(1e9) == pytest.approx(1 / g.G0, rel=1e-6)


@any_law
def test_relaxation_ends_at_the_modulus_of_low_frequency(law):
    s, g = model(jammed(1e-2), law=law), direct(jammed(1e-2), law)
    assert s.G(1e9) == pytest.approx(g.G0, rel=1e-6)


@pytest.mark.parametrize("t", [0.1, 3.0, 40.0])
@any_law
def test_creep_and_relaxation_undo_each_other(law, t):
    """∫ G(t − x) J(x) dx + η∞ J(t) = t: the strain J makes a stress of one."""
    s = model(sixteen(), 1e-8, (1e-8, 1e4), law)
    whole = quad(lambda x: s.G(t - x) * s.J(x), 0, t, limit=300, epsrel=1e-9)[0]
    assert whole + s.own_limits()[0][1, 1] * s.J(t) == pytest.approx(t, rel=1e-7)


def test_times_keep_their_shape():
    s = model(sixteen())
    t = np.array([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]])
    for function in (s.G, s.J):
        assert function(t).shape == (2, 3)
        assert np.shape(function(1.0)) == ()
        assert function(t)[1, 0] == pytest.approx(function(3.0), rel=1e-14)


# ---- the viscosity of the fluid


@pytest.mark.parametrize("eta", [0.0, 0.3, 40.0])
def test_another_fluid_needs_no_other_model(eta):
    law = pj.StokesDrag(eta)
    g = direct(jammed(1e-2), law)
    s = model(jammed(1e-2), 1e-6, SPAN, pj.StokesDrag(1.0)).with_fluid(eta)
    assert s.damping == law
    assert (np.abs(s(g.omega) / g.values - 1) <= s.error(g.omega) + DIRECT).all()


@pytest.mark.parametrize("eta", [0.0, 0.3, 40.0])
def test_limits_with_another_fluid_are_within_their_errors(eta):
    g = direct(jammed(1e-2), pj.StokesDrag(eta))
    s = model(jammed(1e-2), 1e-4, SPAN, pj.StokesDrag(1.0)).with_fluid(eta)
    exact = np.array([[g.G0, g.eta0], [g.G_inf, g.eta_inf]])
    size = np.maximum(np.abs(exact), np.abs(s.limits))  # η∞ is zero without the fluid
    assert (np.abs(s.limits - exact) <= (s.limit_errors + 1e-9) * size + 1e-15).all()


def test_a_fluid_that_drowned_the_disks_leaves_its_rounding():
    """ηF = 1e9 taken away again costs nine digits, and the bound has to know."""
    law = pj.StokesDrag(0.0)
    g = direct(jammed(1e-2), law)
    s = model(jammed(1e-2), 1e-6, SPAN, pj.StokesDrag(1e9)).with_fluid(0.0)
    assert (np.abs(s(g.omega) / g.values - 1) <= s.error(g.omega) + DIRECT).all()


@pytest.mark.parametrize(
    ("law", "strain"), [(pj.ContactDamping(), "simple-shear"), (pj.StokesDrag(1.0), "compression")], ids=str
)
def test_a_fluid_without_effect_is_refused(law, strain):
    with pytest.raises(pj.InputError, match="has no effect"):
        model(sixteen(), law=law, strain=strain).with_fluid(2.0)


def test_a_fluid_of_negative_viscosity_is_refused():
    with pytest.raises(pj.InputError, match=r"must be from 0 to 1e\+09"):
        model(sixteen(), law=pj.StokesDrag(1.0)).with_fluid(-2.0)


# ---- displacements


@pytest.mark.parametrize("rtol", [1e-2, 1e-6])
@two_laws
def test_displacements_are_as_good_as_the_root_of_the_error(law, rtol):
    """δq†(K + ωB)δq ≤ √2 |r†A⁻¹r| ≤ √2 × bound × |G*|V: divided by the softest mode, a bound on |δu|²."""
    omega = np.array([1e-4, 1e-2, 0.3, 20.0])
    s = model(sixteen(), rtol, SPAN, law)
    fields = pj.complex_modulus(sixteen(), omega, damping=law, fields_at=omega).fields
    K, B, _ = dense(sixteen(), law)
    for w, exact in zip(omega, fields, strict=True):
        softest = np.linalg.eigvalsh((K + w * B)[:-1, :-1])[0]
        energy = 2**0.5 * s.error(w) * abs(s(w)) * sixteen().box.area
        assert np.linalg.norm(s.displacement(w) - exact) <= np.sqrt(energy / softest) + 1e-9


@two_laws
def test_displacements_of_a_tight_model_are_the_exact_ones(law):
    omega = np.array([1e-4, 1e-2, 0.3, 20.0])
    s = model(jammed(1e-2), 1e-12, SPAN, law)
    fields = pj.complex_modulus(jammed(1e-2), omega, damping=law, fields_at=omega).fields
    for w, exact in zip(omega, fields, strict=True):
        assert s.displacement(w) == pytest.approx(exact, rel=1e-5, abs=1e-5, nan_ok=True)


@two_laws
def test_displacements_at_a_node_are_the_exact_ones(law):
    s = model(sixteen(), 1e-2, SPAN, law)
    fields = pj.complex_modulus(sixteen(), s.nodes, damping=law, fields_at=s.nodes).fields
    for w, exact in zip(s.nodes, fields, strict=True):
        assert s.displacement(w) == pytest.approx(exact, rel=1e-7, abs=1e-8)


@two_laws
def test_displacements_of_rattlers(law):
    """Taken out they have none; dragged along without contacts they move with the fluid."""
    packing = with_a_rattler()
    s = pj.spectrum(packing, damping=law)
    field, exact = (s.displacement(0.1), pj.complex_modulus(packing, [0.1], damping=law, fields_at=[0.1]).fields[0])
    assert np.array_equal(np.isnan(field), np.isnan(exact))
    assert np.isnan(field[16]).all() != bool(law.body)


def test_a_sample_holds_what_the_model_says():
    s, omega = model(sixteen()), np.geomspace(1e-3, 1.0, 5)
    g = pj.ComplexModulus.sampled(s, omega, omega[1:3])
    assert np.array_equal(g.values, s(omega))
    assert np.array_equal(g.errors, s.error(omega))
    assert np.array_equal(g.fields[1], s.displacement(omega[2]))


def test_a_sample_may_have_displacements_at_other_frequencies():
    g = pj.ComplexModulus.sampled(model(sixteen(), 1e-12), [1.0], fields_at=[0.5])
    exact = pj.complex_modulus(sixteen(), [0.5], fields_at=[0.5]).fields
    assert g.fields == pytest.approx(exact, rel=1e-5, abs=1e-5)


# ---- ranks


def contents(s):
    """The arrays of a model, as bytes."""
    return {
        item.name: getattr(s, item.name).tobytes()
        for item in fields(s)
        if isinstance(getattr(s, item.name), np.ndarray)
    }


@pytest.mark.parallel(nprocs=[1, 2, 3])
@any_law
def test_the_model_does_not_depend_on_the_number_of_ranks(comm, law):
    from mpi4py import MPI

    omega = np.geomspace(1e-8, 1e2, 40)
    together = pj.spectrum(jax_md(), damping=law, comm=comm)
    alone = pj.spectrum(jax_md(), damping=law, comm=MPI.COMM_SELF)
    assert np.array_equal(together.nodes, alone.nodes)
    assert together(omega) == pytest.approx(alone(omega), rel=1e-10)
    assert together.limits == pytest.approx(alone.limits, rel=1e-10, abs=1e-15)


@pytest.mark.parallel(nprocs=[1, 2, 3])
@two_laws
def test_the_bound_does_not_depend_on_the_number_of_ranks(comm, law):
    from mpi4py import MPI

    omega = np.geomspace(1e-8, 1e2, 40)
    together = pj.spectrum(jax_md(), damping=law, comm=comm, rtol=1e-3)
    alone = pj.spectrum(jax_md(), damping=law, comm=MPI.COMM_SELF, rtol=1e-3)
    # what it allows for rounding is rounding itself: up to a tenth of the bound where that is all there is
    assert together.error(omega) == pytest.approx(alone.error(omega), rel=0.01, abs=1e-13)


@pytest.mark.parallel(nprocs=[2, 3])
@two_laws
def test_every_rank_has_the_same_arrays(comm, law):
    models = comm.allgather(contents(pj.spectrum(sixteen(), damping=law, comm=comm)))
    assert {"K", "B", "gains", "limits", "motions"} <= set(models[0])
    assert all(other == models[0] for other in models)


@pytest.mark.parallel(nprocs=[2, 3])
def test_displacements_do_not_depend_on_the_number_of_ranks(comm):
    from mpi4py import MPI

    together, alone = (pj.spectrum(jax_md(), comm=c) for c in (comm, MPI.COMM_SELF))
    assert together.displacement(0.3) == pytest.approx(alone.displacement(0.3), rel=1e-7, abs=1e-7, nan_ok=True)


@pytest.mark.parallel(nprocs=3)
def test_a_split_communicator(comm):
    """Two teams, each with a packing of its own."""
    team = comm.Split(comm.rank // 2, comm.rank)
    s = pj.spectrum(jax_md(comm.rank // 2), comm=team)
    alone = pj.spectrum(jax_md(comm.rank // 2), comm=comm.Split(comm.rank))
    assert np.array_equal(s.nodes, alone.nodes)
    assert s(OMEGA) == pytest.approx(alone(OMEGA), rel=1e-10)


@pytest.mark.parallel(nprocs=3)
def test_a_rank_that_owns_nothing(comm):
    """Two disks with their own images, three ranks."""
    two = pj.Packing([[0, 0], [0, 0.99]], [0.5, 0.5], pj.Box(0.99 * np.array([[1.0, 0.0], [1.0, 2.0]])))
    s = pj.spectrum(two, comm=comm, prestress=False)
    g = pj.complex_modulus(two, OMEGA, comm=comm, prestress=False)
    assert s(OMEGA) == pytest.approx(g.values, rel=1e-10)


@pytest.mark.parallel(nprocs=2)
@pytest.mark.parametrize("what", ["packing", "span", "rtol", "damping"])
def test_different_arguments_on_different_ranks_are_refused(comm, what):
    arguments = {"packing": jax_md(0), "span": SPAN, "rtol": 1e-6, "damping": pj.ContactDamping()}
    other = {"packing": jax_md(1), "span": NARROW, "rtol": 1e-5, "damping": pj.StokesDrag()}
    if comm.rank:
        arguments[what] = other[what]
    with pytest.raises(pj.InputError, match="differ between the ranks"):
        pj.spectrum(**arguments, comm=comm)


# ---- bad input


@pytest.mark.parametrize(
    ("span", "named"),
    [
        ((1.0, 0.5), "1 and 0.5"),
        ((0.0, 1.0), "not 0 "),
        ((-1e-3, 1.0), "-0.001"),
        ((1.0, -1.0), "-1"),
        ((np.nan, 1.0), "nan"),
        ((1.0, np.nan), "nan"),
        ((1.0, np.inf), "inf"),
        ((np.inf, np.inf), "inf"),
    ],
    ids=str,
)
def test_bad_spans_are_refused(span, named):
    with pytest.raises(pj.InputError, match=f"^span: .*{named}"):
        pj.spectrum(sixteen(), span)


@pytest.mark.parametrize("rtol", [0.0, 1.0, np.nan, -1e-6, np.inf])
def test_bad_tolerances_are_refused(rtol):
    with pytest.raises(pj.InputError, match=f"^rtol: .*{rtol:g}"):
        pj.spectrum(sixteen(), rtol=rtol)


@pytest.mark.parametrize("damping", ["drag", 1.0, pj.ContactDamping], ids=str)
def test_what_is_not_a_law_is_refused(damping):
    with pytest.raises(pj.InputError, match="is not a law"):
        pj.spectrum(sixteen(), damping=damping)


def test_an_unknown_strain_is_refused():
    with pytest.raises(pj.InputError, match="torsion"):
        pj.spectrum(sixteen(), strain="torsion")


@pytest.mark.parametrize(("t", "named"), [(-1.0, "-1"), ([0.0, -2.5], "-2.5"), (np.nan, "nan")], ids=str)
@pytest.mark.parametrize("function", ["G", "J"])
def test_times_before_the_step_are_refused(function, t, named):
    with pytest.raises(pj.InputError, match=f"^t: .*{named}"):
        getattr(model(sixteen()), function)(t)


def test_displacements_of_a_model_without_motions_are_refused():
    s = pj.spectrum(sixteen(), displacements=False)
    with pytest.raises(pj.InputError, match="without its motions"):
        s.displacement(1.0)


@pytest.mark.parametrize("omega", [1e-7, 1e-3, 0.1])
def test_a_negative_frequency_is_refused(omega):
    s = model(sixteen(), 1e-2)
    for ask in (s, s.error, s.part_errors, s.residuals):
        with pytest.raises(pj.InputError, match="omega"):
            ask(-omega)


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_bad_frequencies_of_a_sample_are_refused(bad):
    with pytest.raises(pj.InputError, match=f"omega: .*{bad:g}"):
        pj.ComplexModulus.sampled(model(sixteen()), [1.0, bad])


# ---- spans of one frequency, packings that are no minimum


@any_law
def test_a_span_of_one_frequency_takes_one_factorisation(law):
    s = pj.spectrum(sixteen(), (0.3, 0.3), damping=law)
    assert s.factorisations == 1


@any_law
def test_a_span_of_one_frequency_is_the_direct_solve(law):
    s = pj.spectrum(sixteen(), (0.3, 0.3), damping=law)
    assert s(0.3) == pytest.approx(pj.complex_modulus(sixteen(), [0.3], damping=law).values[0], rel=1e-10)


@cache
def shaken():
    """A packing off its minimum: forces do not balance, and K has a negative mode with pre-stress."""
    packing = jammed(1e-2)
    noise = np.random.default_rng(1).standard_normal(packing.positions.shape)
    return replace(packing, positions=packing.positions + 1e-3 * noise, provenance={})


@any_law
def test_a_packing_that_is_no_minimum_gets_an_estimate(law):
    s = model(shaken(), law=law)
    assert not s.definite
    assert s.negative_modes > 0
    assert not np.isinf(s.error(np.geomspace(*SPAN, 50))).any()


@any_law
def test_the_estimate_for_a_packing_that_is_no_minimum_is_of_the_right_size(law):
    g = direct(shaken(), law)
    s = model(shaken(), law=law)
    assert (np.abs(s(g.omega) / g.values - 1) <= 10 * s.error(g.omega) + DIRECT).all()


@any_law
def test_without_prestress_a_packing_that_is_no_minimum_is_bounded(law):
    g = direct(shaken(), law, prestress=False)
    s = model(shaken(), law=law, prestress=False)
    assert s.definite
    assert (np.abs(s(g.omega) / g.values - 1) <= s.error(g.omega) + DIRECT).all()


def square_lattice(columns, rows):
    """Disks of radius ½ that overlap by 1 %: rows slide over each other."""
    grid = 0.99 * np.mgrid[0:columns, 0:rows].reshape(2, -1).T
    return pj.Packing(grid, np.full(columns * rows, 0.5), pj.Box(0.99 * np.diag([columns, rows])))


@any_law
def test_a_lattice_that_slides_downhill_has_a_modulus(law):
    """Pressure drives every row; at β = 0 no friction holds it, and neither limit exists. G* does."""
    g = pj.complex_modulus(square_lattice(4, 4), [0.1, 1.0], damping=law)
    s = pj.spectrum(square_lattice(4, 4), damping=law)
    assert not s.definite
    assert s(g.omega) == pytest.approx(g.values, rel=1e-6)


def test_motions_that_nothing_resists_are_held():
    """Rows slide for nothing, without pre-stress and without friction: the others press as the cell does."""
    s = pj.spectrum(square_lattice(3, 4), damping=pj.ContactDamping(beta=0.0), strain="compression", prestress=False)
    assert s(OMEGA) == pytest.approx(0.5 * (1 + 1j * np.array(OMEGA)), rel=1e-12)


@two_laws
def test_a_minimum_that_yields_to_shear_is_bounded(law):
    packing = jammed(1e-3, 24, 6)
    g = direct(packing, law)
    assert g.G0 < 0
    s = model(packing, 1e-4, SPAN, law)
    assert s.definite
    assert s.negative_modes == 0
    assert (np.abs(s(g.omega) / g.values - 1) <= s.error(g.omega) + DIRECT).all()


def test_creep_of_a_minimum_that_yields_to_shear_grows():
    s = model(jammed(1e-3, 24, 6))
    assert s.J(1e3) > s.J(1e2) > 0


# ---- files


def same(a, b):
    """Bit for bit."""
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        a, b = np.asarray(a), np.asarray(b)
        return (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())
    if isinstance(a, pj.Packing):
        return a.checksum == b.checksum and same(a.positions, b.positions) and same(a.radii, b.radii)
    if isinstance(a, dict):
        return set(a) == set(b) and all(same(a[key], b[key]) for key in a)
    return type(a) is type(b) and a == b


@pytest.mark.parametrize("displacements", [True, False])
@any_law
def test_a_model_comes_back_from_its_file_bit_for_bit(tmp_path, law, displacements):
    s = pj.spectrum(sixteen(), damping=law, displacements=displacements, name="16 disks, µ")
    pj.write_spectrum(s, tmp_path / "model.h5")
    back = pj.read_spectrum(tmp_path / "model.h5")
    for item in fields(s):
        assert same(getattr(s, item.name), getattr(back, item.name)), item.name


def test_a_model_from_a_file_answers_as_before(tmp_path):
    s, omega = model(sixteen(), law=pj.StokesDrag(1.0)), np.geomspace(1e-9, 1e3, 20)
    pj.write_spectrum(s, tmp_path / "model.h5")
    back = pj.read_spectrum(tmp_path / "model.h5")
    for what in (
        lambda m: m(omega),
        lambda m: m.error(omega),
        lambda m: m.G(omega),
        lambda m: m.J(omega),
        lambda m: m.displacement(0.2),
        lambda m: m.with_fluid(2.0)(omega),
    ):
        assert same(what(s), what(back))


def test_unknown_negative_modes_and_notes_come_back(tmp_path):
    s = replace(model(sixteen()), negative_modes=None, zero_modes=None, notes=("one", "two: ω"))
    pj.write_spectrum(s, tmp_path / "model.h5")
    back = pj.read_spectrum(tmp_path / "model.h5")
    assert back.negative_modes is back.zero_modes is None
    assert back.notes == ("one", "two: ω")


def test_a_model_comes_out_of_a_file_of_moduli(tmp_path):
    from petscjam.io.results import append_result

    s = model(sixteen())
    append_result(pj.ComplexModulus.sampled(s, [0.1, 1.0]), tmp_path / "moduli.h5", "sixteen")
    back = pj.read_spectrum(tmp_path / "moduli.h5")
    for item in fields(s):
        if item.name not in ("motions", "geometry"):
            assert same(getattr(s, item.name), getattr(back, item.name)), item.name


def test_moduli_of_direct_solves_hold_no_model(tmp_path):
    from petscjam.io.results import append_result

    append_result(pj.complex_modulus(sixteen(), [1.0]), tmp_path / "moduli.h5", "sixteen")
    with pytest.raises(pj.InputError, match=r"moduli\.h5: .*no reduced model"):
        pj.read_spectrum(tmp_path / "moduli.h5")


@pytest.mark.parametrize("part", [0.0, 0.1, 0.5, 0.9, 0.99])
def test_a_truncated_file_is_refused(tmp_path, part):
    file = tmp_path / "model.h5"
    pj.write_spectrum(model(sixteen()), file)
    data = file.read_bytes()
    file.write_bytes(data[: int(part * len(data))])
    with pytest.raises(pj.InputError, match=r"model\.h5"):
        pj.read_spectrum(file)


def test_a_file_that_lacks_an_array_is_refused(tmp_path):
    import h5py

    file = tmp_path / "model.h5"
    pj.write_spectrum(model(sixteen()), file)
    with h5py.File(file, "a") as h5:
        del h5["gains"]
    with pytest.raises(pj.InputError, match=r"model\.h5: .*gains"):
        pj.read_spectrum(file)


def packing_file(file):
    sixteen().write(file)


def text_file(file):
    file.write_text("omega G\n")


def other_schema(file):
    import h5py

    pj.write_spectrum(model(sixteen()), file)
    with h5py.File(file, "a") as h5:
        h5.attrs["schema"] = 99


@pytest.mark.parametrize("make", [packing_file, text_file, other_schema, lambda file: None])
def test_a_file_of_another_kind_is_refused(tmp_path, make):
    file = tmp_path / "other.h5"
    make(file)
    with pytest.raises(pj.InputError, match=r"other\.h5"):
        pj.read_spectrum(file)


def test_a_file_of_a_model_reads_as_moduli_at_ten_frequencies_a_decade(tmp_path):
    s = model(sixteen())
    pj.write_spectrum(s, tmp_path / "model.h5")
    (g,) = pj.read_moduli(tmp_path / "model.h5").values()
    assert np.allclose(np.diff(np.log10(g.omega)), 0.1)
    assert (g.omega[0], g.omega[-1]) == pytest.approx(s.span, rel=1e-12)
    assert (g.values == s(g.omega)).all()


def test_a_model_that_is_there_is_not_overwritten_unasked(tmp_path):
    pj.write_spectrum(model(sixteen()), tmp_path / "model.h5")
    with pytest.raises(pj.InputError, match="exists already"):
        pj.write_spectrum(model(sixteen()), tmp_path / "model.h5")
    pj.write_spectrum(model(sixteen()), tmp_path / "model.h5", overwrite=True)


@dataclass(frozen=True)
class Suspension(DampingLaw):
    """Contacts in a viscous fluid: a law that says no more than it must."""

    eta: float = 0.7
    name: ClassVar[str] = "suspension"
    normal: ClassVar[float] = 1.0

    @property
    def tangential(self):
        return 0.5

    @property
    def fluid(self):
        return self.eta


@pytest.mark.parametrize("strain", ["simple-shear", "compression"])
def test_a_new_law_with_a_fluid_counts_it_once(strain):
    """The model adds it to what has none; solves at each frequency have it in B. Limits and times, too."""
    packing, omegas, options = sixteen(), [1e-3, 1.0, 1e2], {"strain": strain, "damping": Suspension()}
    direct = pj.complex_modulus(packing, omegas, **options)
    model = pj.spectrum(packing, (1e-3, 1e2), rtol=1e-8, **options)
    assert model(omegas) == pytest.approx(direct.values, rel=1e-7)
    assert (model.eta0, model.eta_inf) == pytest.approx((direct.eta0, direct.eta_inf), rel=1e-6)
    dry = pj.complex_modulus(packing, omegas, strain=strain, damping=Suspension(0.0))
    added = 0.7j * np.array(omegas) * (strain == "simple-shear")
    assert direct.values - dry.values == pytest.approx(added, abs=1e-9 * abs(direct.values).max())
