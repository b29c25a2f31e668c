"""The slow twin of the disk dynamics against closed forms, balances, and the law of the linear response."""

from dataclasses import replace
from itertools import islice
from math import pi, sinh, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import petscjam as pj
from petscjam.geometry.potential import power_law
from petscjam.md.model import MODELS, Model
from petscjam.md.state import State, cell_length
from petscjam.reference import md as twin
from petscjam.rows.damping import LAWS, viscous_form
from petscjam.rows.kinematics import SIMPLE_SHEAR

LAW = [
    *(pytest.param(law, id=name) for name, law in MODELS.items()),
    pytest.param(pj.ContactDamping(0.3), id="beta=0.3"),
    pytest.param(pj.ContactDamping(3.0, rotations=False), id="beta=3 at centres"),
    pytest.param(pj.StokesDrag(0.0), id="stokes"),
    pytest.param(pj.StokesDrag(3.0), id="stokes in a fluid"),
]


def test_every_law_is_tried():
    assert {type(case.values[0]) for case in LAW} == set(LAWS.values())


def disks(seed, n=10, phi=0.9, far=True):
    """Random overlapping disks, sheared, spinning, in a cell of any height, described by images anywhere."""
    rng = np.random.default_rng(seed)
    radii = rng.uniform(0.4, 0.7, n)
    L = cell_length(radii, phi)
    strain, rate = rng.uniform(-3, 3), rng.uniform(-1, 1)
    x, v, spins, steps = rng.random((n, 2)), rng.normal(size=(n, 2)), rng.normal(size=n), rng.integers(-2, 3, (n, 2))
    cell = L * (f := rng.uniform(0.87, 1.15)), L / f
    state = State(x * cell, v, spins, radii, cell[0], strain, rate, height=cell[1])
    return by_other_images(state, steps) if far else state


def cluster(seed):
    """The same disks in the open."""
    return replace(disks(seed, far=False), length=100.0, height=100.0, rate=0.0)


def by_other_images(state, steps):
    """The same disks, each by the image ``steps`` (N, 2) cells away in x and y."""
    m, n = np.transpose(steps)
    x, v, H = state.positions.copy(), state.velocities.copy(), state.height
    x[:, 0] += m * state.length + n * state.strain * H
    x[:, 1] += n * H
    v[:, 0] += n * state.rate * H
    return replace(state, positions=x, velocities=v)


def everything(state, model):
    """All that the twin says of a state, in one array."""
    forces, torques = twin.disk_forces(state, model)
    pressure = np.concatenate(twin.pressure_tensor(state, model))
    scalars = [twin.energy(state, model), twin.dissipation(state, model)]
    return np.concatenate([forces.ravel(), torques, pressure.ravel(), scalars])


def close(a, b, tolerance=1e-11):
    return np.abs(np.asarray(a) - b).max() < tolerance * max(1.0, np.abs(b).max())


states = st.builds(disks, st.integers(0, 2**32))
models = st.builds(
    Model,
    law=st.sampled_from([case.values[0] for case in LAW]),
    Q=st.floats(0.2, 20),
    potential=st.builds(power_law, st.sampled_from([2.0, 2.5, 3.0]), st.booleans()),
    stokes_drag=st.sampled_from([0.0, 0.7]),
    rotational_drag=st.sampled_from([0.0, 0.2]),
)


def without_damping(model):
    """The same repulsion alone: at Q = 1e20 the friction is lost in rounding."""
    return Model(model.law, 1e20, model.potential)


# Collisions


def heun(state, model, dt):
    """Every state of a run, from the first on."""
    while True:
        yield state
        state = twin.heun_step(state, model, dt)


def single(state, model, dt):
    before = twin.accelerations(state, model)
    while True:
        yield state
        state, before = twin.single_step(state, model, dt, before)


def collision(run, Q, dt):
    """Duration and restitution of a head-on collision of two equal small disks that touch at the start.

    The force jumps when the disks part, so the end is extrapolated: the cubic through the last four moments
    whose forces were all those of a contact.
    """
    times, gaps, speeds = [], [], []
    for state in run(head_on(), Model(MODELS["CD"], Q), dt):
        gap, speed = np.diff(state.positions[:, 0])[0] - 1, np.diff(state.velocities[:, 0])[0]
        if gap + speed * dt > 0:
            break
        times.append(state.time), gaps.append(gap), speeds.append(speed)
    t = np.array(times[-4:])
    gap, speed = (np.polyfit(t - t[-1], series[-4:], 3) for series in (gaps, speeds))
    parting = min(np.roots(gap), key=abs).real
    return np.array([t[-1] + parting, np.polyval(speed, parting) / 0.2])


def head_on():
    x, v = np.array([[4.5, 5.0], [5.5 - 1e-12, 5.0]]), np.array([[0.1, 0.0], [-0.1, 0.0]])
    return State(x, v, np.zeros(2), np.full(2, 0.5), 10.0)


def bounces_as_it_should(run, Q):
    """The damped oscillator: duration π/√(2 − 1/Q²), restitution exp(−π/√(2Q² − 1)), errors ∝ dt²."""
    exact = [pi / sqrt(2 - 1 / Q**2), np.exp(-pi / sqrt(2 * Q**2 - 1))]
    coarse, fine = collision(run, Q, 0.01), collision(run, Q, 0.005)
    assert (4 * fine - coarse) / 3 == pytest.approx(exact, abs=1e-6)
    assert np.abs(coarse - exact).max() == pytest.approx(4 * np.abs(fine - exact).max(), rel=0.1)


@pytest.mark.parametrize("run", [heun, single])
@pytest.mark.parametrize("Q", [1.0, 2.0, 10.0])
def test_head_on_collision(Q, run):
    bounces_as_it_should(run, Q)


def ending(run):
    """Return a function of a state, a model, dt and a number of steps, that returns the last state."""
    return lambda state, model, dt, steps: next(islice(run(state, model, dt), steps, None))


def never_parts(end):
    """Below Q = 1/√2 the overlap is u0/s exp(−kd t) sinh(s t), s = √(kd² − 2), for ever."""
    Q, dt, time = 0.5, 0.01, 4.0
    s = sqrt(1 / Q**2 - 2)
    state = end(head_on(), Model(MODELS["CD_rot"], Q), dt, round(time / dt))
    overlap = 1 - np.diff(state.positions[:, 0])[0]
    assert overlap == pytest.approx(0.2 / s * np.exp(-time / Q) * sinh(s * time), rel=1e-3)


@pytest.mark.parametrize("run", [heun, single])
def test_overdamped_disks_never_part(run):
    never_parts(ending(run))


def drags_a_lone_disk(end, dt):
    """Return the largest error after 2 τe against the closed form, across an edge of the cell.

    With c = v − γ̇ y x̂: cy decays at ζ, cx = (cx(0) − γ̇ cy(0) t) exp(−ζt), θ̇ + γ̇/2 at ζr/(R²/2).
    """
    model, rate, time = Model(MODELS["CD_n"], 1.0, stokes_drag=0.4, rotational_drag=0.1), 0.3, 2.0
    c, y, R = np.array([0.2, 0.5]), 5.7, 0.6
    start = State([[1.0, y]], [[c[0] + rate * y, c[1]]], [0.8], [R], 6.0, strain=0.1, rate=rate)
    last = end(start, model, dt, round(time / dt))
    slowing = np.exp(-0.4 * time)
    rise = c[1] * (1 - slowing) / 0.4
    errors = [
        last.strain - 0.1 - rate * time,
        last.time - time,
        last.spins[0] + rate / 2 - (0.8 + rate / 2) * np.exp(-0.1 / (R**2 / 2) * time),
        last.peculiar[0, 0] - (c[0] - rate * c[1] * time) * slowing,
        last.peculiar[0, 1] - c[1] * slowing,
        (last.positions[0, 1] - y - rise + 3) % 6 - 3,
    ]
    assert y + rise > 6
    return np.abs(errors).max()


@pytest.mark.parametrize("run", [heun, single])
def test_drag_on_a_lone_disk(run):
    coarse, fine = (drags_a_lone_disk(ending(run), dt) for dt in (0.05, 0.025))
    assert coarse == pytest.approx(4 * fine, rel=0.1)
    assert coarse < 1e-3


# Forces and torques


@given(states, models)
def test_momentum_is_lost_to_the_fluid_alone(state, model):
    forces, _ = twin.disk_forces(state, model)
    assert close(forces.sum(0), -model.body * state.peculiar.sum(0))


@given(st.integers(0, 2**32), st.floats(0.2, 20), st.sampled_from([0.0, 0.3, 1.0]))
def test_angular_momentum_is_conserved(seed, Q, beta):
    """By a cluster in the open: the arms meet at the contact point."""
    state = cluster(seed)
    forces, torques = twin.disk_forces(state, Model(pj.ContactDamping(beta), Q))
    turning = state.positions[:, 0] * forces[:, 1] - state.positions[:, 1] * forces[:, 0]
    assert np.abs(torques).max() > 1e-3 or beta == 0
    assert turning.sum() + torques.sum() == pytest.approx(0.0, abs=1e-11)


@given(st.integers(0, 2**32), st.floats(-2, 2))
def test_a_cluster_that_turns_as_a_whole_dissipates_nothing(seed, spin):
    state = cluster(seed)
    x = state.positions
    state = replace(state, velocities=spin * np.stack([-x[:, 1], x[:, 0]], 1), spins=np.full(len(x), spin))
    assert twin.dissipation(state, Model(MODELS["CD_rot"], 1.0)) < 1e-20
    assert twin.dissipation(state, Model(MODELS["CD"], 1.0)) >= 0.1 * spin**2


def test_gears_do_not_rub():
    """Equal surface speeds, opposite spins; equal spins slip with ωi si + ωj sj."""
    radii, spins = np.array([0.5, 0.7]), np.array([0.7, -0.5])
    state = State([[4.0, 5.0], [5.1, 5.0]], np.zeros((2, 2)), spins, radii, 10.0)
    model = Model(pj.ContactDamping(beta=0.5), 2.0)  # tangential friction 1/4
    assert twin.dissipation(state, model) < 1e-30
    arms = 1.1 / 1.2 * radii
    forces, torques = twin.disk_forces(replace(state, spins=[1.0, 3.0]), model)
    slip = arms[0] + 3 * arms[1]
    assert torques == pytest.approx(-0.25 * slip * arms)
    assert forces[:, 1] == pytest.approx([-0.25 * slip, 0.25 * slip])


@given(states, models, st.floats(-5, 5), st.floats(-5, 5))
def test_the_origin_is_anywhere(state, model, x, y):
    along = np.array([state.rate * y, 0.0])
    shifted = replace(state, positions=state.positions + np.array([x, y]), velocities=state.velocities + along)
    assert close(everything(shifted, model), everything(state, model))


@given(states, models, st.integers(0, 2**32))
def test_any_image_will_do(state, model, seed):
    other = by_other_images(state, np.random.default_rng(seed).integers(-3, 4, (len(state), 2)))
    assert close(everything(other, model), everything(state, model))
    assert close(everything(other.wrapped(), model), everything(state, model))


@given(states, models, st.integers(-3, 3))
def test_a_strain_of_whole_cells_is_none(state, model, cells):
    wrapped = state.wrapped()
    turned = replace(wrapped, strain=wrapped.strain + cells * state.length / state.height)
    assert close(everything(turned, model), everything(wrapped, model))


@given(states, models)
def test_turning_everything_by_half_a_circle_changes_signs_of_vectors_alone(state, model):
    turned = replace(state, positions=-state.positions, velocities=-state.velocities)
    n = len(state)
    sign = np.concatenate([np.full(2 * n, -1.0), np.ones(n + 14)])
    assert close(everything(turned, model), sign * everything(state, model))


# Energy


def along(state, h, positions=0.0, velocities=0.0, spins=0.0, strain=0.0):
    return replace(
        state,
        positions=state.positions + h * positions,
        velocities=state.velocities + h * velocities,
        spins=state.spins + h * spins,
        strain=state.strain + h * strain,
    )


def slope(function, h=1e-5):
    return (function(h) - function(-h)) / (2 * h)


@given(states, models, st.integers(0, 2**32))
def test_elastic_force_is_minus_the_gradient_of_the_energy(state, model, seed):
    still = replace(state, velocities=0 * state.velocities, spins=0 * state.spins, rate=0.0)
    model = without_damping(model)
    direction = np.random.default_rng(seed).normal(size=(len(state), 2))
    power = slope(lambda h: twin.energy(along(still, h, positions=direction), model))
    assert power == pytest.approx(-np.sum(twin.disk_forces(still, model)[0] * direction), abs=1e-6)


def grown(state, factors):
    """The state and its lattice with x and y multiplied by two factors."""
    x, (length, height) = state.positions * factors, factors * np.array([state.length, state.height])
    strain = state.strain * factors[0] / factors[1]
    return replace(state, positions=x, length=length, height=height, strain=strain)


@given(states, models)
def test_elastic_pressure_is_the_derivative_of_the_energy_by_the_cell(state, model):
    """Simple shear: −Lx Ly p_xy. Growth of the cell in x: −Lx Ly p_xx, in both directions: −2 Lx Ly p."""
    still = replace(state, velocities=0 * state.velocities, spins=0 * state.spins, rate=0.0)
    elastic, area = twin.pressure_tensor(still, model)[0], state.area
    sheared = np.stack([still.positions[:, 1], np.zeros(len(state))], 1)
    dE = slope(lambda h: twin.energy(along(still, h, positions=sheared, strain=1.0), model))
    assert dE == pytest.approx(-area * elastic[0, 1], abs=1e-6)
    for growth, pressure in (([1, 1], np.trace(elastic)), ([1, 0], elastic[0, 0])):
        dE = slope(lambda h, growth=growth: twin.energy(grown(still, 1 + h * np.array(growth)), model))
        assert dE == pytest.approx(-area * pressure, abs=1e-6)


@given(states, models)
def test_dissipation_is_the_power_of_the_damping(state, model):
    """It is what the forces take from the motion, and what they take from the shear; never negative."""
    forces, torques = twin.disk_forces(state, model)
    elastic, _ = twin.disk_forces(state, without_damping(model))
    damping = forces - elastic
    shear = state.area * twin.pressure_tensor(state, model)[1][0, 1] * state.rate
    vorticity = model.rotational_drag * np.sum(state.spins + state.rate / 2) * state.rate / 2
    power = np.sum(damping * state.peculiar) + torques @ state.spins + shear - vorticity
    assert twin.dissipation(state, model) == pytest.approx(-power, rel=1e-9, abs=1e-9)
    assert twin.dissipation(state, model) >= 0


@given(states, models, st.sampled_from([1.0, 3.0, np.linspace(0.5, 2.0, 10)]))
def test_energy_balance(state, model, masses):
    """Along the exact motion, dE/dt = −γ̇ Lx Ly p_xy + couple of the fluid − dissipation."""
    motion = state.velocities, *twin.accelerations(state, model, masses), state.rate
    dE = slope(lambda h: twin.energy(along(state, h, *motion), model, masses))
    work = -state.rate * state.area * sum(twin.pressure_tensor(state, model, masses))[0, 1]
    couple = state.rate / 2 * model.rotational_drag * np.sum(state.spins + state.rate / 2)
    heat = twin.dissipation(state, model)
    assert dE == pytest.approx(work + couple - heat, abs=1e-5 * max(1.0, heat))


# One law for the solver and for the molecular dynamics


def solver_form(state, law):
    """Contacts and B as the linear response finds them."""
    network = pj.ContactNetwork.of(state.packing())
    return network, viscous_form(network, np.ones(len(state), dtype=bool), [SIMPLE_SHEAR], law)


def strip(squeezed, n=6, seed=0):
    """Disks that each touch the two before, all at the same r/d_ij = ``squeezed``, across two edges."""
    rng = np.random.default_rng(seed)
    radii = rng.uniform(0.4, 0.7, n)
    x = [np.zeros(2), np.array([radii[0] + radii[1], 0.0])]
    for k in range(2, n):  # the triangle of sides a, b, c, on alternating sides
        a, b, c = radii[k - 2] + radii[k], radii[k - 1] + radii[k], radii[k - 2] + radii[k - 1]
        along = (a**2 + c**2 - b**2) / (2 * c)
        e = (x[k - 1] - x[k - 2]) / c
        x.append(x[k - 2] + along * e + (-1) ** k * sqrt(a**2 - along**2) * np.array([-e[1], e[0]]))
    L, v = 8.0, rng.normal(size=(n, 2))
    centre = np.array([L, L]) - squeezed * np.mean(x, axis=0)
    state = State(squeezed * np.array(x) + centre, v, rng.normal(size=n), radii, L, 0.3, 0.4)
    return state.wrapped()


@given(states, st.sampled_from([case.values[0] for case in LAW if not case.values[0].at_contact_point]))
def test_at_the_centres_the_law_is_that_of_the_solver(state, law):
    """Damping force −B·(v − γ̇y x̂, γ̇), with kτ1 = 1/Q; stress and dissipation from the same form."""
    Q = 3.0
    model = Model(law, Q)
    network, B = solver_form(state, law)
    motion = (np.column_stack([state.peculiar, state.spins]) + 0j, [state.rate])
    forces, _ = twin.disk_forces(state, model)
    elastic, _ = twin.disk_forces(state, without_damping(model))
    assert close(elastic, network.residual_force)
    assert close(twin.pressure_tensor(state, model)[0], network.stress)
    assert close(forces - elastic, -B.apply(*motion).real[:, :2] / Q)
    assert twin.dissipation(state, model) == pytest.approx(B.product(motion, motion).real / Q, rel=1e-9)
    strained = (np.zeros((len(state), 3)) + 0j, [1.0])
    shear = -twin.pressure_tensor(state, model)[1][0, 1] * state.area
    assert shear == pytest.approx(B.product(strained, motion).real / Q, abs=1e-9)


@pytest.mark.parametrize("squeezed", [1 - 1e-9, 0.95])
@pytest.mark.parametrize("beta", [0.0, 0.3, 1.0])
def test_at_the_contact_point_the_law_is_that_of_the_solver(beta, squeezed):
    """The solver's arms are the radii, VOT's are r d_i/(d_i + d_j): spins and torques differ by r/d_ij."""
    Q, law = 3.0, pj.ContactDamping(beta)
    state, model = strip(squeezed), Model(law, 3.0)
    network, B = solver_form(state, law)
    assert len(network) == 2 * len(state) - 3
    d = network.mean_diameter  # the solver's rotations are lengths, θd
    motion = (np.column_stack([state.peculiar, squeezed * d * state.spins]) + 0j, [state.rate])
    forces, torques = twin.disk_forces(state, model)
    elastic, _ = twin.disk_forces(state, without_damping(model))
    damping = -B.apply(*motion).real / Q
    assert close(forces - elastic, damping[:, :2])
    assert close(torques, squeezed * d * damping[:, 2])
    assert twin.dissipation(state, model) == pytest.approx(B.product(motion, motion).real / Q, rel=1e-9)
    strained = (np.zeros((len(state), 3)) + 0j, [1.0])
    shear = -twin.pressure_tensor(state, model)[1][0, 1] * state.area
    assert shear == pytest.approx(B.product(strained, motion).real / Q, abs=1e-9)


def test_models_are_those_of_the_paper():
    """VOT eq. 3, eqs. 5–7, and kd(t) = 0."""
    state = strip(0.95)
    for name, rolls, tangential in (("CD", False, 0.25), ("CD_rot", True, 0.25), ("CD_n", False, 0.0)):
        model = Model(MODELS[name], 4.0)
        assert (model.normal, model.tangential, model.rolls) == (0.25, tangential, rolls)
        for c in twin.contacts(state, model):
            if name == "CD":
                assert c.dissipative == pytest.approx(-0.25 * c.v)
            if name == "CD_n":
                assert c.dissipative == pytest.approx(-0.25 * (c.v @ c.r) * c.r / (c.r @ c.r))
