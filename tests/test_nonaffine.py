"""Facts that the quasi-static response obeys: published numbers, the dense twin, identities, storage."""

import numpy as np
import pytest
from helpers import any_prestress, any_strain, jammed, sixteen, twin_contacts

import petscjam as pj
from petscjam.reference import linear as reference
from petscjam.rows.damping import LAWS


@pytest.mark.parametrize(("prestress", "G0"), [(True, 0.1088011), (False, 0.1105622390)])
def test_published_modulus(prestress, G0):
    r = pj.quasistatic_response(sixteen(), prestress=prestress)
    assert r.shear_modulus == pytest.approx(G0, abs=6e-8)


def test_median_of_the_non_affine_motion_is_the_one_with_zero_mean():
    assert np.median(pj.quasistatic_response(sixteen()).sizes("nonaffine")) == pytest.approx(1.52, abs=5e-3)


def dense(packing, prestress, strain):
    """Relax K by least squares, and take Δu from the rows: loops only."""
    found, radii = twin_contacts(packing), packing.radii
    K, n = reference.hessian(found, radii, strain, prestress), len(radii)
    Q = np.zeros(3 * n + 1)
    Q[-1] = 1
    Q[: 2 * n] = np.linalg.lstsq(K[: 2 * n, : 2 * n], -K[: 2 * n, -1], rcond=1e-11)[0]
    rows = np.array([reference.rows(c, radii, strain, arms=0) for c in found])
    backbone = sorted({disk for c in found for disk in (c.i, c.j)})
    u = Q[: 2 * n].reshape(n, 2)[backbone]
    keys = [(c.i, c.j, round(c.rx, 9), round(c.ry, 9)) for c in found]
    return np.sort(abs(rows @ Q), axis=0), u - u.mean(0), keys


@any_prestress
@any_strain
def test_motion_equals_the_slow_twin(prestress, strain):
    packing = jammed(1e-3, seed=3)
    r = pj.quasistatic_response(packing, prestress=prestress, strain=strain)
    sizes, u, _ = dense(packing, prestress, strain)
    np.testing.assert_allclose(r.nonaffine, u, atol=1e-9 * abs(u).max())
    np.testing.assert_allclose(np.sort(r.sizes("parallel")), sizes[:, 0], atol=1e-9)
    np.testing.assert_allclose(np.sort(r.sizes("transverse")), sizes[:, 1], atol=1e-9 * sizes.max())


@any_prestress
@any_strain
def test_modulus_is_that_of_the_spectrum(prestress, strain):
    r = pj.quasistatic_response(jammed(1e-3, seed=3), prestress=prestress, strain=strain)
    s = pj.spectrum(jammed(1e-3, seed=3), (1e-3, 1.0), prestress=prestress, strain=strain)
    assert r.shear_modulus == pytest.approx(s.G0, rel=1e-8)


@any_prestress
def test_two_terms_of_the_energy_add_up_in_simple_shear(prestress):
    r = pj.quasistatic_response(jammed(1e-3, seed=3), prestress=prestress)
    assert r.stretching + r.pre_stress == pytest.approx(r.shear_modulus, rel=1e-12)


def test_pre_stress_term_is_not_positive():
    assert pj.quasistatic_response(jammed(1e-3, seed=3)).pre_stress < 0


def test_without_pre_stress_there_is_no_such_term():
    assert pj.quasistatic_response(jammed(1e-3, seed=3), prestress=False).pre_stress == 0


@pytest.mark.parametrize("pressure", [1e-2, 1e-4])
def test_rattlers_are_left_out(pressure):
    packing = jammed(pressure, 128, 1)
    assert packing.certificate.rattlers > 0
    r = pj.quasistatic_response(packing)
    assert len(r.nonaffine) == len(packing) - packing.certificate.rattlers == len(r.disks)
    assert set(np.unique(r.contacts)) == set(r.disks)


def test_relative_motion_is_that_of_the_disks():
    packing = jammed(1e-3, 128, 1)
    r = pj.quasistatic_response(packing)
    u = np.zeros((len(packing), 2))
    u[r.disks] = r.nonaffine
    network = pj.ContactNetwork.of(packing).without_rattlers()
    delta = u[network.j] - u[network.i] + network.r[:, 1:] * [1, 0]
    np.testing.assert_allclose((delta * network.normal).sum(1), r.parallel, atol=1e-12 * abs(u).max())


@pytest.mark.parallel(nprocs=[1, 2, 3])
def test_it_does_not_depend_on_the_ranks(comm):
    packing = comm.bcast(jammed(1e-3, 128, 1) if comm.rank == 0 else None)
    r, alone = pj.quasistatic_response(packing, comm=comm), pj.quasistatic_response(packing)
    np.testing.assert_allclose(r.nonaffine, alone.nonaffine, atol=1e-11 * abs(alone.nonaffine).max())
    np.testing.assert_allclose(r.transverse, alone.transverse, atol=1e-10)


def test_unknown_strain_is_named():
    with pytest.raises(pj.InputError, match="'twist'"):
        pj.quasistatic_response(sixteen(), strain="twist")


@any_prestress
@pytest.mark.parametrize("law", [law() for law in LAWS.values()], ids=str)
def test_viscosity_is_that_of_the_spectrum(law, prestress):
    v = pj.viscosity(jammed(1e-3, seed=3), damping=law, prestress=prestress)
    s = pj.spectrum(jammed(1e-3, seed=3), damping=law, prestress=prestress)
    assert v.eta0 == pytest.approx(s.eta0, rel=1e-6)
    assert v.G0 == pytest.approx(s.G0, rel=1e-6)


@pytest.mark.parametrize(
    ("law", "prestress", "eta0"),
    [
        (pj.ContactDamping(), True, 1.509883234),
        (pj.ContactDamping(), False, 1.489362890),
        (pj.ContactDamping(rotations=False), True, 2.500404524),
        (pj.ContactDamping(beta=0.1), True, 0.250502940),
        (pj.StokesDrag(), True, 1.470206985),
    ],
)
def test_published_viscosities(law, prestress, eta0):
    assert pj.viscosity(sixteen(), damping=law, prestress=prestress).eta0 == pytest.approx(eta0, abs=6e-10)


def results():
    return {
        "nonaffine": pj.quasistatic_response(jammed(1e-3, seed=3)),
        "viscosity": pj.viscosity(jammed(1e-3, seed=3), damping=pj.StokesDrag(2.0)),
    }


@pytest.mark.parametrize("kind", ["nonaffine", "viscosity"])
def test_what_is_stored_is_read_back(kind, tmp_path):
    from dataclasses import fields

    from petscjam.io.results import append_result

    result = results()[kind]
    append_result(result, tmp_path / "r.h5", "one")
    again = pj.read_results(tmp_path / "r.h5")["one"]
    for item in fields(result):
        if item.name == "geometry":
            assert again.geometry.checksum == result.geometry.checksum
        else:
            np.testing.assert_equal(getattr(again, item.name), getattr(result, item.name))


def test_a_file_holds_one_kind_of_results(tmp_path):
    from petscjam.io.results import append_result

    append_result(results()["nonaffine"], tmp_path / "r.h5", "one")
    with pytest.raises(pj.InputError, match="holds 'petscjam nonaffine'"):
        append_result(results()["viscosity"], tmp_path / "r.h5", "two")
    with pytest.raises(pj.InputError, match="another kind"):
        pj.read_moduli(tmp_path / "r.h5")
