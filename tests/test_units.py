"""No result depends on the unit of length: public quantities of packings whose lengths are s times as large.

Lengths grow by s and stiffnesses by c = k(sd)(sd)^(α−2) / k(d)d^(α−2); the friction coefficient kτ1 is 1 in
any unit, so frequencies grow by c, too. Mass and time enter the linear response through c alone.
"""

from functools import cache

import numpy as np
import pytest
from helpers import any_law, any_prestress, jammed

import petscjam as pj
from petscjam.geometry.potential import POTENTIALS

FACTORS = [1e-9, 1e9]
TWO_POTENTIALS = ["harmonic", "hertzian-relative"]  # one length unit changes the forces, one does not
OMEGA = np.geomspace(1e-6, 1e1, 15)
CLOSE = {"rel": 1e-8}  # rounding of positions moves overlaps of 1e-2 d by 1e-14, and soft motions by more
DIRECT = 1e-10  # what rounding of direct solves moves G* by

any_factor = pytest.mark.parametrize("s", FACTORS)
any_potential = pytest.mark.parametrize("name", POTENTIALS)
two_potentials = pytest.mark.parametrize("name", TWO_POTENTIALS)


@cache
def packing(name, n=64, seed=3, pressure=1e-2):
    return jammed(pressure, n, seed, potential_name=name, shear_stabilised=True)


@cache
def scaled(name, s, **others):
    """Return the packing with lengths s times as large, uncertified, and c."""
    p = packing(name, **others)
    larger = pj.Packing(s * p.positions, s * p.radii, pj.Box(s * p.box.cell), name)
    return larger, p.potential.unit(s * p.mean_diameter) / p.potential.unit(p.mean_diameter)


def both(name, s):
    """Return the packing, the larger one, and c."""
    return packing(name), *scaled(name, s)


@any_factor
@any_potential
def test_network(name, s):
    p, q, c = both(name, s)
    small, large = pj.ContactNetwork.of(p), pj.ContactNetwork.of(q)
    assert len(large) == len(small)
    assert (large.backbone == small.backbone).all()
    assert large.Z == small.Z
    assert large.pressure == pytest.approx(c * small.pressure, rel=1e-10)
    assert q.phi == pytest.approx(p.phi, rel=1e-13)


@any_factor
@any_potential
def test_certificate(name, s):
    p, q, c = both(name, s)
    small, large = p.certificate, pj.certify(q, c * 1e-2).certificate
    assert small.proved
    assert large.proved
    assert (large.rattlers, large.contacts, large.negative_modes, large.zero_modes) == (
        small.rattlers,
        small.contacts,
        0,
        0,
    )
    assert large.pressure == pytest.approx(c * small.pressure, rel=1e-10)
    assert large.eigenvalues == pytest.approx(c * np.array(small.eigenvalues), **CLOSE)
    assert large.shear_modulus == pytest.approx(c * small.shear_modulus, **CLOSE)


@any_factor
@pytest.mark.parametrize("method", ["fire", "cg"])
@pytest.mark.parametrize("stabilised", [False, True])
@any_potential
def test_minimiser(name, stabilised, method, s):
    """From shaken disks it comes to the same packing, in about as many steps."""
    p, _, c = both(name, s)
    shaken = p.positions + 0.02 * np.random.default_rng(1).standard_normal(p.positions.shape)

    def relaxed(factor, unit):
        start = pj.Packing(factor * shaken, factor * p.radii, pj.Box(factor * p.box.cell), name)
        return pj.relax_packing(start, 1.2e-2 * unit, shear_stabilised=stabilised, method=method)

    small, large = relaxed(1.0, 1.0), relaxed(s, c)
    assert large.certificate.proved
    assert large.positions / s == pytest.approx(small.positions, abs=1e-6)
    assert large.provenance["evaluations"] < 1.3 * small.provenance["evaluations"]


@any_factor
@any_law
@two_potentials
def test_complex_modulus(name, law, s):
    p, q, c = both(name, s)
    small, large = (pj.complex_modulus(x, w, damping=law) for x, w in ((p, OMEGA), (q, c * OMEGA)))
    assert large.values == pytest.approx(c * small.values, **CLOSE)
    assert (large.G0, large.G_inf) == pytest.approx((c * small.G0, c * small.G_inf), **CLOSE)
    assert (large.eta0, large.eta_inf) == pytest.approx((small.eta0, small.eta_inf), **CLOSE)
    assert large.stable and small.stable


@any_factor
@pytest.mark.parametrize("rtol", [1e-2, 1e-6])
@any_law
@two_potentials
def test_the_bound_of_a_spectrum_is_never_below_its_error(name, law, rtol, s):
    q, c = scaled(name, s)
    direct = pj.complex_modulus(q, c * OMEGA, damping=law).values
    model = pj.spectrum(q, (c * 1e-7, c * 1e2), damping=law, rtol=rtol)
    error = abs(model(c * OMEGA) / direct - 1)
    assert (error <= model.error(c * OMEGA) + DIRECT).all()
    assert model.error(c * OMEGA).max() < 2 * rtol
    small = pj.spectrum(packing(name), (1e-7, 1e2), damping=law, rtol=rtol)
    assert model.factorisations == small.factorisations
    assert model.error(c * OMEGA) == pytest.approx(small.error(OMEGA), rel=0.01, abs=1e-11)


@any_factor
@two_potentials
def test_family(name, s):
    p, (q, c) = packing(name, n=16), scaled(name, s, n=16)
    small, large = (pj.beta_family(x, (0.01, 1.0), (w * 1e-5, w * 10.0), rtol=1e-4) for x, w in ((p, 1.0), (q, c)))
    assert large.factorisations == small.factorisations
    omega = OMEGA[2:-1]
    assert large(0.1)(c * omega) == pytest.approx(c * small(0.1)(omega), rel=1e-6)


@any_factor
@two_potentials
def test_relaxations_in_time(name, s):
    p, q, c = both(name, s)
    small, large = (pj.spectrum(x, (w * 1e-6, w * 10.0), rtol=1e-8) for x, w in ((p, 1.0), (q, c)))
    t = np.geomspace(1e-1, 1e5, 13)
    assert large.G(t / c) == pytest.approx(c * small.G(t), rel=1e-6)
    assert large.J(t / c) == pytest.approx(small.J(t) / c, rel=1e-6)
    assert large.displacement(c * 1e-3) == pytest.approx(s * small.displacement(1e-3), rel=1e-4, nan_ok=True)


@any_factor
@any_prestress
@any_potential
def test_quasistatic(name, prestress, s):
    p, q, c = both(name, s)
    small, large = (pj.quasistatic_response(x, prestress=prestress) for x in (p, q))
    assert large.shear_modulus == pytest.approx(c * small.shear_modulus, **CLOSE)
    for what in ("parallel", "transverse", "nonaffine"):
        ours = getattr(large, what)
        assert ours == pytest.approx(s * getattr(small, what), rel=1e-8, abs=1e-8 * s)
    assert pj.elastic_constants(q, prestress=prestress) == pytest.approx(
        c * pj.elastic_constants(p, prestress=prestress), rel=1e-8, abs=1e-10 * c
    )
    assert pj.viscosity(q, prestress=prestress).eta0 == pytest.approx(
        pj.viscosity(p, prestress=prestress).eta0, **CLOSE
    )


@any_factor
@any_potential
def test_modes(name, s):
    p, q, c = both(name, s)
    small, large = (pj.lowest_modes(x, count=8) for x in (p, q))
    assert large.complete and small.complete
    assert large.eigenvalues == pytest.approx(c * small.eigenvalues, **CLOSE)


@any_factor
@pytest.mark.parametrize("law", [pj.ContactDamping(), pj.StokesDrag()], ids=str)
@any_potential
def test_relaxation_modes(name, law, s):
    p, q, c = both(name, s)
    small, large = (pj.relaxation_modes(x, count=5, damping=law) for x in (p, q))
    assert large.times == pytest.approx(small.times / c, **CLOSE)
    assert large.weights == pytest.approx(c * small.weights, rel=1e-6)


@any_factor
@any_potential
def test_density_of_states(name, s):
    p, q, c = both(name, s)
    small, large = (pj.density_of_states(x, moments=64, vectors=4) for x in (p, q))
    assert large.omega == pytest.approx(c**0.5 * small.omega, rel=1e-10)
    assert large.density == pytest.approx(small.density / c**0.5, rel=1e-8)


@any_factor
@two_potentials
def test_correlations(name, s):
    p, q, c = both(name, s)
    small, large = (pj.correlations(x, [w * 1e-3]) for x, w in ((p, 1.0), (q, c)))
    assert large.delta == pytest.approx(s * small.delta)
    assert large.real == pytest.approx(small.real, abs=1e-4, nan_ok=True)


@any_factor
@pytest.mark.parametrize("drag", [pj.self_consistent_drag, pj.equivalent_drag, pj.nonlinear_drag])
@two_potentials
def test_nonlinear_drag(name, drag, s):
    """BT eq. 9: its velocity ρ0/τ1 is that of a diameter, in any unit."""
    p, q, c = both(name, s)
    small, large = drag(p, [1e-3], 0.01, 0.5), drag(q, [c * 1e-3], c * 0.01, 0.5)
    assert large.values == pytest.approx(c * small.values, rel=1e-5)
    assert large.tau == pytest.approx(small.tau, rel=1e-5)


def test_a_residual_that_is_rounding_has_a_bound():
    """β = 0 without pre-stress: the motion is the same at every frequency (Kelvin–Voigt)."""
    p = packing("harmonic")
    model = pj.spectrum(p, (1e-6, 1e2), damping=pj.ContactDamping(beta=0.0), prestress=False)
    exact = model.G0 * (1 + 1j * OMEGA)
    assert model.rounding_only
    assert (abs(model(OMEGA) / exact - 1) <= model.error(OMEGA)).all()
    assert (model.truncation(OMEGA) > 0).all()
    assert model.error(OMEGA).max() < 1e-9
    assert np.isinf(model.error([1e-8, 1e4])).all()


@pytest.mark.parametrize("law", [pj.ContactDamping(beta=b) for b in (1.0, 0.01, 0.0)], ids=str)
def test_the_bound_of_a_complete_model(law):
    """Eight disks: a few nodes span all motions, and the residual is rounding."""
    p = pj.prepare_packing(8, 1e-2, 5)
    model = pj.spectrum(p, (1e-6, 1e2), damping=law, rtol=1e-12)
    direct = pj.complex_modulus(p, OMEGA, damping=law).values
    assert model.rounding_only
    assert (abs(model(OMEGA) / direct - 1) <= model.error(OMEGA) + 1e-12).all()
    assert model.error(OMEGA).max() < 1e-11
