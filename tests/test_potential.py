"""Potentials that are no powers of the overlap: in the loops, in files, and where only powers will do."""

import pickle

import numpy as np
import pytest
from helpers import twin_matrices
from test_lammps_shear import some_state, write
from test_md_physics import EACH, advance, apart, linearised, slow
from test_md_twin import disks
from test_plots import row

import petscjam as pj
from petscjam.base.errors import InputError
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.potential import POTENTIALS, Potential, power_law
from petscjam.md.model import MODELS, Model
from petscjam.md.simulation import Simulation
from petscjam.plots.library import plot_library
from petscjam.preparation.minimise import Enthalpy

pytestmark = pytest.mark.parallel(nprocs=1)


def cosh(relative):
    """Harmonic at small overlaps, exponential at large ones."""
    width, kind = 0.3, "-relative" * relative
    return Potential(
        f"cosh{kind}",
        relative,
        "a test",
        U=lambda x: width**2 * (np.cosh(x / width) - 1),
        dU=lambda x: width * np.sinh(x / width),
        d2U=lambda x: np.cosh(x / width),
    )


def capped(relative):
    """Hertzian up to an overlap, harmonic beyond: U″ is continuous."""
    c, kind = 0.05, "-relative" * relative
    k, f, u = 1.5 * c**0.5, c**1.5, c**2.5 / 2.5
    return Potential(
        f"capped{kind}",
        relative,
        "a test",
        U=lambda x: np.where(x < c, x**2.5 / 2.5, u + f * (x - c) + k * (x - c) ** 2 / 2),
        dU=lambda x: np.where(x < c, x**1.5, f + k * (x - c)),
        d2U=lambda x: 1.5 * np.minimum(x, c) ** 0.5,
    )


def same_as(power):
    """A power law as any other function."""
    a = power.exponent
    name = f"same as {power.name}"
    return Potential(
        name,
        power.relative,
        "a test",
        U=lambda x: x**a / a,
        dU=lambda x: x ** (a - 1),
        d2U=lambda x: (a - 1) * x ** (a - 2),
    )


POWERS = [power_law(alpha, relative) for alpha in (2.0, 2.5, 3.0) for relative in (False, True)]
GENERAL = [make(relative) for make in (cosh, capped) for relative in (False, True)]


@pytest.fixture(autouse=True)
def known(monkeypatch):
    for law in (*GENERAL, *map(same_as, POWERS)):
        monkeypatch.setitem(POTENTIALS, law.name, law)


@pytest.mark.parametrize("law", [*GENERAL, *POWERS], ids=lambda law: law.name)
def test_forces_and_stiffnesses_are_derivatives(law):
    sigma, h = np.array([0.6, 1.0, 1.7])[:, None], 1e-6
    r = sigma * np.linspace(0.5, 0.999, 40)
    force = (law.energy(r - h, sigma) - law.energy(r + h, sigma)) / (2 * h)
    stiffness = (law.force(r - h, sigma) - law.force(r + h, sigma)) / (2 * h)
    assert law.force(r, sigma) == pytest.approx(force, rel=1e-6, abs=1e-9)
    assert law.stiffness(r, sigma) == pytest.approx(stiffness, rel=1e-6, abs=1e-9)
    assert not law.energy(sigma + h, sigma).any()
    assert not law.force(sigma, sigma).any()
    assert not law.stiffness(sigma + h, sigma).any()


@EACH
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("law", GENERAL, ids=lambda law: law.name)
def test_steps_are_those_of_the_slow_twin(law, threads, integrator):
    model, masses, dt = Model(MODELS["CD_rot"], 2.0, law), np.linspace(0.5, 2.0, 24), 0.01
    state = disks(3, 24)
    simulation = Simulation(state, model, dt, integrator, threads, masses=masses)
    exact = slow(state, model, dt / simulation.parts, integrator, masses, anew=True)
    assert apart(simulation.state, next(exact)) < 1e-12
    assert simulation.parts == 1
    for _ in range(10):
        advance(simulation, 1)
        assert apart(simulation.state, next(exact)) < 1e-12


@pytest.mark.parametrize("law", GENERAL, ids=lambda law: law.name)
def test_the_bound_of_the_frequency_is_above_the_largest(law):
    state, model = disks(11, 20), Model(MODELS["CD"], 2.0, law)
    exact = np.abs(np.linalg.eigvals(linearised(state, model, np.ones(20))[1])).max()
    bound = Simulation(state, model, 1e-6).fastest()[1]
    assert exact * (1 - 1e-12) <= bound <= 2 * exact


@pytest.mark.parametrize("power", POWERS, ids=lambda law: law.name)
def test_a_power_by_its_functions_is_the_power(power):
    law = same_as(power)
    state = disks(5, 24)
    one, other = (Simulation(state, Model(MODELS["CD"], 2.0, some), 0.01) for some in (power, law))
    assert one.fastest() == pytest.approx(other.fastest(), rel=1e-12)
    advance(one, 10), advance(other, 10)
    assert apart(one.state, other.state) < 1e-12
    for threads in (1, 2):
        rng = np.random.default_rng(1)
        box = pj.Box(70 * np.eye(2))
        x, radii = 70 * rng.random((5000, 2)), rng.uniform(0.4, 0.6, 5000)
        found = [Enthalpy(pj.Packing(x, radii, box, some.name), threads=threads) for some in (power, law)]
        gradients = [h.gradient(h.start) for h in found]
        assert gradients[1] == pytest.approx(gradients[0], rel=1e-10, abs=1e-12)
        assert found[1].now.energy == pytest.approx(found[0].now.energy, rel=1e-12)
        assert found[1].now.stress == pytest.approx(found[0].now.stress, rel=1e-10)


@pytest.mark.parametrize("method", ["fire", "cg"])
@pytest.mark.parametrize("law", GENERAL, ids=lambda law: law.name)
def test_packings_are_minima_and_come_back(law, method, tmp_path, monkeypatch):
    packing = pj.prepare_packing(48, 1e-2, potential_name=law.name, method=method, shear_stabilised=method == "cg")
    network = ContactNetwork.of(packing)
    assert packing.certificate.proved
    assert network.pressure == pytest.approx(1e-2, rel=1e-8)
    K, _, p = twin_matrices(packing, pj.ContactDamping())
    assert p == pytest.approx(1e-2, rel=1e-8)
    assert np.linalg.eigvalsh(K[:96, :96])[0] > -1e-12
    packing.write(tmp_path / "p.h5")
    again = pj.Packing.read(tmp_path / "p.h5")
    assert again.potential is law
    assert again.checksum == packing.checksum
    monkeypatch.delitem(POTENTIALS, law.name)
    with pytest.raises(InputError, match=f"'{law.name}' is unknown"):
        pj.Packing.read(tmp_path / "p.h5")


def test_runs_come_back(tmp_path, monkeypatch):
    packing = pj.prepare_packing(32, 1e-2, potential_name="capped-relative")
    file = tmp_path / "run.h5"
    run = pj.md.shear("CD", start=packing, rate=1e-3, strain=0.02, output=file)
    assert run.missed < 0.01
    more = pj.md.shear("CD", start=packing, rate=1e-3, strain=0.04, output=file, resume=True)
    whole = pj.md.shear("CD", start=packing, rate=1e-3, strain=0.04)
    assert (more.state.positions == whole.state.positions).all()
    assert pj.md.read(file).settings.model.potential is POTENTIALS["capped-relative"]
    monkeypatch.delitem(POTENTIALS, "capped-relative")
    with pytest.raises(InputError, match="'capped-relative' is unknown"):
        pj.md.read(file)


@pytest.mark.parametrize("law", [*GENERAL, *POWERS], ids=lambda law: law.name)
def test_other_processes_get_it_by_name(law):
    assert pickle.loads(pickle.dumps(law)) == law


def test_what_takes_powers_alone_refuses_others(tmp_path):
    with pytest.raises(InputError, match="cosh is not a power"):
        plot_library([row(potential="cosh")], tmp_path / "a.png")
    with pytest.raises(InputError, match=r"harmonic.*'cosh'"):
        write(some_state(), tmp_path / "new", model=Model(MODELS["CD"], 1.0, POTENTIALS["cosh"]))


def test_a_function_that_numba_cannot_compile_is_named():
    law = Potential("bad", False, "a test", U=lambda x: np.heaviside(x, 0), dU=np.sign, d2U=np.sign)
    with pytest.raises(InputError, match="'bad': numba cannot compile"):
        law.compiled  # noqa: B018
