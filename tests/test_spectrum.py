"""Facts that a reduced model and its certificate obey: direct solves, dense algebra, integration in time."""

from dataclasses import fields, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.linalg import expm

import petscjam as pj
from petscjam import reference
from petscjam.damping import LAWS
from petscjam.kinematics import STRAINS
from petscjam.storage import open_h5
from test_published import OMEGA, PRINTED, TABLE

DATA = Path(__file__).parent / "data"
SPAN = (1e-8, 1e2)
NARROW = (1e-3, 1e-1)
EVERY_LAW = [
    pj.ContactDamping(), pj.ContactDamping(beta=0.01), pj.ContactDamping(beta=0.0),
    pj.ContactDamping(rotations=False), pj.StokesDrag(eta_fluid=1.0), pj.StokesDrag(eta_fluid=0.0),
]  # fmt: skip
TWO_LAWS = [pj.ContactDamping(), pj.StokesDrag(eta_fluid=1.0)]
PRESSURES = [1e-2, 1e-5]
LOOSE = [1e-2, 1e-4]  # the errors are large enough to be seen
DIRECT = 1e-11  # allowed for the direct solve: at p = 1e-5 rounding alone moves G* by up to 5e-12

any_law = pytest.mark.parametrize("law", EVERY_LAW, ids=str)
two_laws = pytest.mark.parametrize("law", TWO_LAWS, ids=str)
any_strain = pytest.mark.parametrize("strain", STRAINS)
any_prestress = pytest.mark.parametrize("prestress", [True, False])
any_pressure = pytest.mark.parametrize("pressure", PRESSURES)


@cache
def sixteen():
    return pj.import_packing(DATA / "jambashbulk-N16-P1e-3-0001.txt")


@cache
def jax_md(index=0):
    return pj.import_packing(DATA / "jaxmd-2d-polyuniform-N64-Lp-1.nc", index)


@cache
def jammed(pressure, n=64, seed=1):
    return pj.prepare_packing(n, pressure, seed)


@cache
def model(packing, rtol=1e-6, span=SPAN, law=None, strain="simple-shear", prestress=True):
    """Packings hash by identity: those above are made once."""
    return pj.spectrum(packing, span, damping=law, strain=strain, prestress=prestress, rtol=rtol)


def random_frequencies(span, count=12, seed=0):
    low, high = np.log(span)
    return np.exp(np.sort(np.random.default_rng(seed).uniform(low, high, count)))


@cache
def direct(packing, law=None, strain="simple-shear", prestress=True, span=SPAN):
    """G* by one factorisation a frequency, at random ones."""
    omega = random_frequencies(span)
    return pj.complex_modulus(packing, omega, damping=law, strain=strain, prestress=prestress)


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


# ---- the certificate against direct solves


def test_every_law_is_tested():
    assert {type(law) for law in EVERY_LAW} == set(LAWS.values())


@any_pressure
@any_prestress
@any_strain
@any_law
def test_direct_solves_are_within_the_bound(law, strain, prestress, pressure):
    g = direct(jammed(pressure), law, strain, prestress)
    for rtol in (*LOOSE, 1e-6):
        s = model(jammed(pressure), rtol, SPAN, law, strain, prestress)
        assert s.definite
        assert (np.abs(s(g.omega) / g.values - 1) <= s.error(g.omega) + DIRECT).all()


@any_pressure
@any_prestress
@any_strain
@any_law
def test_storage_and_loss_of_direct_solves_are_within_their_bounds(law, strain, prestress, pressure):
    g = direct(jammed(pressure), law, strain, prestress)
    for rtol in (*LOOSE, 1e-6):
        s = model(jammed(pressure), rtol, SPAN, law, strain, prestress)
        values, (storage, loss) = s(g.omega), s.part_errors(g.omega)
        rounding = DIRECT * np.abs(g.values)
        for ours, exact, bound in (
            (values.real, g.values.real, storage), (values.imag, g.values.imag, loss)
        ):  # fmt: skip
            assert (np.abs(ours - exact) <= bound * np.abs(exact) + rounding).all()


@any_pressure
@any_prestress
@any_strain
@any_law
def test_the_bound_is_within_a_factor_of_a_hundred(law, strain, prestress, pressure):
    g = direct(jammed(pressure), law, strain, prestress)
    for rtol in (*LOOSE, 1e-6):
        s = model(jammed(pressure), rtol, SPAN, law, strain, prestress)
        error = np.abs(s(g.omega) / g.values - 1)
        seen = error > 1e-10
        assert (s.error(g.omega)[seen] <= 100 * error[seen]).all()


@any_pressure
@any_law
def test_the_tolerance_is_met_on_a_finer_grid_than_it_was_asked_on(law, pressure):
    omega = np.geomspace(*SPAN, 2000)
    for rtol in (*LOOSE, 1e-6):
        assert model(jammed(pressure), rtol, SPAN, law).error(omega).max() <= 1.01 * rtol


@pytest.mark.parametrize("span", [NARROW, (0.5, 1.0), (10.0, 100.0), (1e-8, 1e-6)], ids=str)
@two_laws
def test_outside_its_span_a_model_is_within_the_bound(law, span):
    g = direct(jammed(1e-2), law, span=(1e-10, 1e5))
    s = model(jammed(1e-2), 1e-4, span, law)
    assert (np.abs(s(g.omega) - g.values) <= s.error(g.omega) * np.abs(s(g.omega)) + DIRECT * np.abs(g.values)).all()


@pytest.mark.parametrize("rtol", [1e-6, 1e-12])
@pytest.mark.parametrize("width", [1.0, 1.01, 1.05, 1.2, 2.0])
@two_laws
def test_a_model_of_a_narrow_span_is_within_the_bound_everywhere(law, width, rtol):
    """A span of a few grid points or none between its ends; far away the errors are of order one."""
    g = direct(jammed(1e-2), law, span=(1e-10, 1e5))
    s = model(jammed(1e-2), rtol, (1.0, width), law)
    error = np.abs(s(g.omega) - g.values) / np.abs(s(g.omega))
    assert (error <= s.error(g.omega) + DIRECT).all()


@pytest.mark.parametrize("width", [1.01, 1.05, 1.2, 2.0])
@two_laws
def test_between_the_ends_of_a_narrow_span_a_model_is_within_the_bound(law, width):
    omega = np.geomspace(1.0, width, 9)
    g = pj.complex_modulus(jammed(1e-5), omega, damping=law)
    s = model(jammed(1e-5), 1e-12, (1.0, width), law)
    assert (np.abs(s(omega) / g.values - 1) <= s.error(omega) + 1e-13).all()  # rounds below 1e-14 here


@pytest.mark.parametrize("rtol", [0.1, 1e-2])
def test_the_bound_is_of_the_error_relative_to_the_true_modulus(rtol):
    """Not to that of the model, which is larger: it counts where the error is of order one."""
    g = direct(jammed(1e-2), pj.StokesDrag(0.0), span=(1e-10, 1e5))
    s = model(jammed(1e-2), rtol, NARROW, pj.StokesDrag(0.0))
    storage, loss = s.part_errors(g.omega)
    for ours, exact, bound in (
        (s(g.omega), g.values, s.error(g.omega)),
        (s(g.omega).real, g.values.real, storage),
        (s(g.omega).imag, g.values.imag, loss),
    ):
        assert (np.abs(ours - exact) <= (bound + DIRECT) * np.abs(exact)).all()


def with_a_rattler():
    """The sixteen disks and, in the middle of three of them, a small one that touches nobody."""
    packing = sixteen()
    grid = np.mgrid[0:1:60j, 0:1:60j].reshape(2, -1).T @ packing.box.cell
    gaps = [
        (np.hypot(*packing.box.minimum_image(packing.positions - x).T) - packing.radii).min() for x in grid
    ]
    radii = [*packing.radii, 0.9 * max(gaps)]
    return replace(packing, positions=[*packing.positions, grid[np.argmax(gaps)]], radii=radii, provenance={})


@pytest.mark.parametrize("rtol", [0.1, *LOOSE])
@two_laws
def test_a_rattler_does_not_spoil_the_bound(law, rtol):
    packing = with_a_rattler()
    g = pj.complex_modulus(packing, random_frequencies(SPAN, 40), damping=law)
    s = pj.spectrum(packing, SPAN, damping=law, rtol=rtol)
    error = np.abs(s(g.omega) / g.values - 1)
    bound, seen = s.error(g.omega), error > 1e-10
    assert (error <= bound + DIRECT).all()
    assert (bound[seen] <= 100 * error[seen]).all()


def test_a_tolerance_below_rounding_is_met_or_called_so():
    """Rounding is of order 1e-14 here; a certificate of a thousand times as much is no news."""
    s = pj.spectrum(jammed(1e-3, 24, 23), (1e-5, 1.0), damping=pj.ContactDamping(beta=0.01),
                    strain="compression", prestress=False, rtol=1e-12)  # fmt: skip
    assert s.error(np.geomspace(1e-5, 1.0, 50)).max() <= 1e-10
    assert s.factorisations <= 12


@pytest.mark.parametrize("span", [SPAN, NARROW, (0.5, 1.0)], ids=str)
@pytest.mark.parametrize("law", TWO_LAWS, ids=str)
def test_a_crystal_moves_as_the_cell_does(law, span):
    """A triangular lattice: no motion beyond the affine one but rounding, so nothing to learn."""
    a, b = 0.99 * np.array([[1.0, 0.0], [0.5, 0.75**0.5]])
    i, j = np.mgrid[0:6, 0:6].reshape(2, -1, 1)
    crystal = pj.Packing(i * a + j * b, np.full(36, 0.5), pj.Box([6 * a, 6 * b]))
    s = pj.spectrum(crystal, span, damping=law, prestress=False)
    assert s.error(np.geomspace(*span, 30)).max() <= 1e-12
    assert s.factorisations <= 3


# ---- the certificate against dense algebra


def dense(packing, law, strain="simple-shear", prestress=True):
    """K and B of the slow twin over the unknowns, γ last; where the law sees no translation one disk is held."""
    relative = packing.potential_name == "harmonic-relative"
    found = reference.contacts(packing.positions, packing.radii, packing.box.cell, relative, images=1)
    held = []
    if law.body:
        B = reference.stokes_drag(len(packing), packing.box.area, law.fluid, strain)
    else:
        found = reference.without_rattlers(found, len(packing))
        B = reference.contact_damping(found, packing.radii, law.beta, law.rotations, strain)
        first = min(min(c.i, c.j) for c in found)
        held = [2 * first, 2 * first + 1]
    K = reference.hessian(found, packing.radii, strain, prestress)
    free = (np.diag(K) != 0) | (np.diag(B) != 0)
    free[-1] = True
    free[held] = False
    pressure = prestress * sum(c.force * np.hypot(c.rx, c.ry) for c in found) / (2 * packing.box.area)
    return K[np.ix_(free, free)], B[np.ix_(free, free)], pressure


def galerkin(K, B, nodes):
    """What the theory says a model of these nodes is: the residual r(ω), by dense algebra.

    Motions: q at the first two nodes, the ends of the span; q and dq/dω at the others.
    """
    k, b = K[:-1, -1], B[:-1, -1]
    motions = []
    for index, omega in enumerate(nodes):
        A = K[:-1, :-1] + 1j * omega * B[:-1, :-1]
        q = -np.linalg.solve(A, k + 1j * omega * b)
        motions += [q.real, q.imag]
        if index > 1:
            slope = np.linalg.solve(A, b + B[:-1, :-1] @ q)
            motions += [slope.real, slope.imag]
    start, *others = motions
    others = [v - start if v is motions[2] or False else v for v in others]
    V = []
    for index, v in enumerate(others):
        V.append(v)
    return start, V


def projected(K, B, nodes):
    k, b = K[:-1, -1], B[:-1, -1]
    start, columns = None, []
    for index, omega in enumerate(nodes):
        A = K[:-1, :-1] + 1j * omega * B[:-1, :-1]
        q = -np.linalg.solve(A, k + 1j * omega * b)
        start = q.real if start is None else start
        columns += [q.real - start, q.imag]
        if index > 1:
            slope = np.linalg.solve(A, b + B[:-1, :-1] @ q)
            columns += [slope.real, slope.imag]
    V = np.empty((len(k), 0))
    for v in columns:
        w = v
        for _ in range(3):
            w = w - V @ (V.T @ w)
        if np.linalg.norm(w) > 1e-10 * np.linalg.norm(v):
            V = np.column_stack([V, w / np.linalg.norm(w)])
    return start, V
