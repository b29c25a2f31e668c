"""Numbers that other programs published, on one rank and on several."""

import numpy as np
import pytest
from helpers import JAXMD, jax_md, sixteen, twin_contacts

import petscjam as pj
from petscjam.base.files import open_h5
from petscjam.reference import linear as reference

OMEGA = [1e-3, 1e-1, 1.0, 10.0]

# two programs written apart agree on every digit: G*(ω) and η0
TABLE = {
    "rolling, pre-stress": (
        pj.ContactDamping(beta=1.0),
        True,
        [
            0.1088139865 + 0.0015096036j,
            0.1474873690 + 0.1058807984j,
            0.2885410783 + 0.4858531157j,
            0.3095637561 + 4.3293316120j,
        ],
        1.509883234,
    ),
    "rolling, no pre-stress": (
        pj.ContactDamping(beta=1.0),
        False,
        [
            0.1105744810 + 0.0014891067j,
            0.1486147875 + 0.1054458118j,
            0.2893223161 + 0.4858396591j,
            0.3103885654 + 4.3293335547j,
        ],
        1.489362890,
    ),
    "no rotations, pre-stress": (
        pj.ContactDamping(beta=1.0, rotations=False),
        True,
        [
            0.1088374897 + 0.0024989942j,
            0.1593993639 + 0.1545023520j,
            0.2725592144 + 1.0137247201j,
            0.2940048117 + 9.6786909301j,
        ],
        2.500404524,
    ),
    "weak tangential damping, pre-stress": (
        pj.ContactDamping(beta=0.1),
        True,
        [
            0.1088012355 + 0.0002505025j,
            0.1099858746 + 0.0246920420j,
            0.1272929369 + 0.2095027629j,
            0.1336367156 + 1.9948209443j,
        ],
        0.250502940,
    ),
    "Stokes, pre-stress": (
        pj.StokesDrag(eta_fluid=1.0),
        True,
        [
            0.1088051959 + 0.0014701476j,
            0.1238076308 + 0.1299828620j,
            0.2163179197 + 1.0655907726j,
            0.2782613749 + 10.0153896336j,
        ],
        1.470206985,
    ),
}
PRINTED = 0.6e-10  # the table gives ten decimals, η0 nine


@pytest.mark.parallel(nprocs=[1, 2, 3])
@pytest.mark.parametrize("case", TABLE)
def test_modulus_of_sixteen_disks_to_every_digit(comm, case):
    law, prestress, expected, _ = TABLE[case]
    g = pj.complex_modulus(sixteen(), OMEGA, damping=law, prestress=prestress, comm=comm)
    assert np.abs(g.values.real - np.real(expected)).max() <= PRINTED
    assert np.abs(g.values.imag - np.imag(expected)).max() <= PRINTED


@pytest.mark.parallel(nprocs=[1, 2, 3])
@pytest.mark.parametrize("case", TABLE)
def test_viscosity_of_sixteen_disks_to_every_digit(comm, case):
    law, prestress, _, expected = TABLE[case]
    g = pj.complex_modulus(sixteen(), OMEGA, damping=law, prestress=prestress, comm=comm)
    assert abs(g.eta0 - expected) <= 10 * PRINTED


def test_shear_modulus_is_that_of_its_own_shear_log():
    assert pj.complex_modulus(sixteen(), [1.0]).G0 == pytest.approx(0.1088011, abs=5e-8)


@pytest.mark.parametrize("omega", [1e-6, *OMEGA, 1e4])
def test_without_tangential_damping_and_prestress_it_is_a_kelvin_voigt_solid(omega):
    g = pj.complex_modulus(sixteen(), [omega], damping=pj.ContactDamping(beta=0.0), prestress=False)
    assert g.G0 == pytest.approx(0.1105622390, abs=PRINTED)
    assert g.values[0] == pytest.approx(g.G0 * (1 + 1j * omega), rel=1e-12)


@pytest.mark.parametrize(
    ("prestress", "expected"),
    [(True, [0.0595119881, 0.1284532830, 0.1912115675]), (False, [0.0612012380, 0.1307559102, 0.1938721026])],
)
def test_lowest_eigenvalues_of_the_slow_twin(prestress, expected):
    found = twin_contacts(sixteen())
    K = reference.hessian(found, sixteen().radii, prestress=prestress)
    assert np.linalg.eigvalsh(K[:32, :32])[2:5] == pytest.approx(expected, abs=PRINTED)


@pytest.mark.parallel(nprocs=[1, 2])
@pytest.mark.parametrize("index", range(10))
def test_elastic_constants_of_jax_md(comm, index):
    packing = jax_md(index)
    with open_h5(JAXMD) as h5:
        stored = h5["Cijkl"][index]
    C = pj.elastic_constants(packing, comm=comm)
    ours = [C[0, 0], C[1, 1], C[2, 2], C[0, 1], C[0, 2], C[1, 2]]
    assert ours == pytest.approx(stored, rel=1e-9, abs=1e-12)


def test_symmetric_and_simple_shear_differ_by_the_pressure():
    packing = jax_md()
    p = pj.ContactNetwork.of(packing).stress
    simple = pj.complex_modulus(packing, [1.0]).G0
    assert simple == pytest.approx(0.2071122, abs=5e-8)
    assert pj.elastic_constants(packing)[2, 2] - simple == pytest.approx((3 * p[1, 1] - p[0, 0]) / 4, rel=1e-10)
