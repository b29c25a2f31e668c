"""Nonlinear drag of contacts in the disk engine (BT eq. 9): closed forms, and the slow twin in test_md_physics.py."""

import numpy as np
import pytest
from helpers import triangular_lattice
from scipy.integrate import solve_ivp

import petscjam as pj
from petscjam.base.errors import InputError
from petscjam.cli import main
from petscjam.io.lammps_shear import write_lammps
from petscjam.md import protocols
from petscjam.md.model import MODELS, Model
from petscjam.md.simulation import Simulation
from petscjam.md.state import State
from petscjam.rows.damping import ContactDamping, StokesDrag

pytestmark = pytest.mark.parallel(nprocs=1)
CENTRES = ContactDamping(beta=1.0, rotations=False)


@pytest.mark.parametrize("integrator", ["heun", "single"])
@pytest.mark.parametrize("alpha", [0.5, 0.8])
def test_a_collision_is_that_of_the_equation_of_motion(alpha, integrator):
    """Two disks of diameter 1 collide head-on at a relative speed of 0.2: δ̈ = −2δ − 2/Q [(δ̇² + ε²)/w²]^((α−1)/2) δ̇."""
    Q, w, eps, time, dt = 2.0, 0.3, 1e-2, 1.5, 1e-3
    model = Model(MODELS["CD"], Q, drag_exponent=alpha, drag_speed=w, drag_cutoff=eps)
    x, v = np.array([[9.5, 10.0], [10.5, 10.0]]), np.array([[0.1, 0.0], [-0.1, 0.0]])
    simulation = Simulation(State(x, v, np.zeros(2), np.full(2, 0.5), 20.0), model, dt, integrator)
    steps = round(time / dt)
    simulation.advance(np.zeros(steps), np.zeros(steps))

    def motion(t, y):
        drag = ((y[1] ** 2 + eps**2) / w**2) ** ((alpha - 1) / 2) * y[1]
        return [y[1], -2 * y[0] - 2 / Q * drag]

    exact = solve_ivp(motion, (0, time), [0.0, 0.2], rtol=1e-10, atol=1e-12).y[:, -1]
    gap = np.diff(simulation.state.positions[:, 0])[0]
    assert 1 - gap == pytest.approx(exact[0], abs=2e-5)
    assert -np.diff(simulation.state.velocities[:, 0])[0] == pytest.approx(exact[1], abs=2e-4)


def lattice_loss(alpha, w, omega, gamma, Q):
    """G″ of a lattice that moves affinely: the first harmonic of Σ |v|^(α−1) v rx over its bonds, at small strain."""
    size, phase = 0.99, (np.arange(4000) + 0.5) / 4000 * 2 * np.pi
    stress, area = np.zeros_like(phase), size**2 * 0.75**0.5
    for angle in np.radians([0, 60, 120]):
        y = size * np.sin(angle)
        speed = gamma * omega * np.cos(phase) * y  # along x
        stress += np.abs(speed / w) ** (alpha - 1) * speed * y / Q / area if y else 0
    return 2 / gamma * np.mean(stress * np.cos(phase))


@pytest.mark.parametrize("alpha", [0.5, 2 / 3])
def test_the_loss_of_a_lattice_does_not_depend_on_the_cutoff(alpha):
    """G″ ~ (γ0ω)^(α−1); the cutoff, 0.01 and 0.001 of γ0ω ds, matters less than 1e-3."""
    omega, gamma, Q, w = 0.1, 1e-3, 1.0, 1e-4
    found = []
    for part in (1e-2, 1e-3):
        options = {"drag_exponent": alpha, "drag_speed": w, "drag_cutoff": part * gamma * omega, "angles": False}
        protocol = protocols.oscillation(gamma, omega, 2)
        run = pj.md.run(protocol, CENTRES, Q=Q, start=triangular_lattice(4), **options)
        found.append(pj.md.harmonics(run).modulus.imag)
    exact = lattice_loss(alpha, w, omega, gamma, Q)
    assert found == pytest.approx([exact, exact], rel=2e-3)
    assert found[0] == pytest.approx(found[1], rel=1e-3)


def test_the_default_is_the_drag_of_bt(tmp_path, capsys):
    """w = ρ0/τ1 = dQ; the file keeps it, and a resumed run goes on with it."""
    file = tmp_path / "run.h5"
    options = {"n": 16, "phi": 0.8, "Q": 0.5, "rate": 1e-2, "drag_exponent": 0.5, "output": file}
    pj.md.shear("CD", strain=0.05, **options)
    model = pj.md.read(file).settings.model
    assert (model.drag_exponent, model.drag_speed) == (0.5, pytest.approx(1.2 * 0.5))
    assert model.drag_cutoff == pytest.approx(0.01 * 1.2 * 1e-2)
    assert main(["info", str(file)]) == 0
    assert "drag ~ v^0.5 with w = 0.6, cutoff 0.00012" in capsys.readouterr().out
    longer = pj.md.shear("CD", strain=0.1, resume=True, **options)
    assert longer.strain[-1] == pytest.approx(0.1, rel=1e-3)
    with pytest.raises(InputError, match="drag_exponent"):
        pj.md.shear("CD", strain=0.2, resume=True, **options | {"drag_exponent": 0.6})


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--drag-exponent 0", "must be from 0.01 to 1, not 0"),
        ("--drag-exponent 1.5", "must be from 0.01 to 1, not 1.5"),
        ("--drag-exponent nan", "not a finite number"),
        ("--drag-exponent 0.5 --drag-cutoff 0", "must be from 1e-50 to 1e+50, not 0"),
        ("--drag-speed 3", "go with a drag_exponent below 1"),
    ],
)
def test_bad_input_is_refused_in_one_line(tmp_path, capsys, words, message):
    assert main(["shear", "--particles", "16", *words.split(), "-o", str(tmp_path / "run.h5")]) == 2
    assert message in capsys.readouterr().err


def test_stokes_drag_is_no_drag_of_contacts():
    with pytest.raises(
        InputError, match=r"drag_exponent = 0\.5, but stokes \(eta_fluid=1\.0\) has no drag of contacts"
    ):
        Model(StokesDrag(1.0), 1.0, drag_exponent=0.5, drag_cutoff=1e-3)


def test_lammps_has_no_such_drag(tmp_path):
    model = Model(MODELS["CD"], 1.0, drag_exponent=0.5, drag_cutoff=1e-3)
    state = pj.md.shear("CD", 16, 0.8, rate=1e-2, strain=0.05).state
    with pytest.raises(InputError, match=r"linear drag of contacts, but its exponent is 0\.5"):
        write_lammps(state, model, tmp_path / "lammps", rate=1e-2, strain=0.1)
