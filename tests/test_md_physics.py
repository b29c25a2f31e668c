"""The fast disk dynamics: step by step the slow twin, and what the equations of motion demand.

Each test is for all engines, but those of:

- flows: hundreds of disks or thousands of steps, which the simulator of a GPU needs hours for;
- loops that are cut into pieces, and the bounds of eigenvalues: only the engine for the CPU has them as functions;
- head-on collisions: a state is looked at after each of hundreds of steps, and a look costs more than a step there.
"""

import sys
from dataclasses import replace
from itertools import islice, product

import numpy as np
import pytest
from helpers import any_engine
from test_md_twin import LAW, bounces_as_it_should, by_other_images, close, disks, drags_a_lone_disk, never_parts, strip

from petscjam.base.errors import InputError, SolverError
from petscjam.geometry.neighbours import CHUNK
from petscjam.geometry.potential import POTENTIALS, Potential, power_law
from petscjam.md import kernels
from petscjam.md.engine import LAYERED, TICKS
from petscjam.md.model import BULK, INTEGRATORS, MODELS, Model, stable_step
from petscjam.md.simulation import Simulation
from petscjam.md.state import State, random_state
from petscjam.reference import md as twin

COSH = Potential("cosh", True, "a test", lambda x: np.cosh(x) - 1, lambda x: np.sinh(x), lambda x: np.cosh(x))
EACH = pytest.mark.parametrize("integrator", INTEGRATORS)
LAWS = {case.id: case.values[0] for case in LAW}
OTHERS = {
    "plain": {},
    "film": {"drag_exponent": 0.6, "drag_speed": 2.0, "drag_cutoff": 0.05},
    "hertzian-relative": {"potential": POTENTIALS["hertzian-relative"]},
    "harmonic": {"potential": POTENTIALS["harmonic"]},
    "power": {"potential": power_law(3.0, relative=False)},
    "cosh": {"potential": COSH},
    "drags": {"stokes_drag": 0.7, "rotational_drag": 0.05},
}


# Stokes drag has no drag of contacts that could be nonlinear.
CASES = [case for case in product(LAWS, OTHERS) if not (case[1] == "film" and LAWS[case[0]].body)]


def diagonal(law, others, integrator="heun"):
    """Every law and every other option at least once."""
    place = list(LAWS).index(law)
    return place % len(OTHERS) == list(OTHERS).index(others) and integrator == list(INTEGRATORS)[place % 2]


PRESSURE = {
    "EXX": (0, 0, 0),
    "EXY": (0, 0, 1),
    "EYY": (0, 1, 1),
    "DXX": (1, 0, 0),
    "DXY": (1, 0, 1),
    "DYX": (1, 1, 0),
    "DYY": (1, 1, 1),
    "KXX": (2, 0, 0),
    "KXY": (2, 0, 1),
    "KYY": (2, 1, 1),
}


def advance(simulation, steps):
    """Make steps at the rate of the moment."""
    strains = simulation.strain + simulation.rate * simulation.dt * np.arange(1, steps + 1)
    simulation.advance(strains, np.full(steps, simulation.rate))


def slow(state, model, dt, integrator, masses=1.0, anew=False):
    """Every state of the slow twin, from the first on; ``anew``: no force is kept from the step before."""
    before = None
    while True:
        yield state
        if integrator == "heun":
            state = twin.heun_step(state, model, dt, masses)
        else:
            if anew or before is None:
                before = twin.accelerations(state, model, masses)
            state, before = twin.single_step(state, model, dt, before, masses)


def fast(integrator):
    """The same of the fast code, one call a step."""

    def run(state, model, dt):
        simulation = Simulation(state, model, dt, integrator)
        while True:
            yield simulation.state
            advance(simulation, 1)

    return run


def end_of(kind, integrator):
    """Return a function of a state, a model, dt and a number of steps, that returns the last state."""

    def end(state, model, dt, steps):
        simulation = kind(state, model, dt, integrator)
        advance(simulation, steps)
        return simulation.state

    return end


def apart(a, b):
    """Largest difference of two states, whatever images they are given by."""
    H = a.height
    dx, dv = a.positions - b.positions, a.velocities - b.velocities
    rows = np.rint(dx[:, 1] / H)
    dx[:, 1] -= rows * H
    dx[:, 0] -= rows * a.strain * H
    dx[:, 0] -= np.rint(dx[:, 0] / a.length) * a.length
    dv[:, 0] -= rows * a.rate * H
    return max(np.abs(dx).max(), np.abs(dv).max(), np.abs(a.spins - b.spins).max())


# The slow twin


@any_engine("law, others, integrator", [(*case, name) for case in CASES for name in INTEGRATORS], diagonal)
def test_steps_are_those_of_the_slow_twin(kind, law, others, integrator):
    """Lists of pairs come and go; the one-evaluation scheme begins anew with each call."""
    model, masses = Model(LAWS[law], 2.0, **OTHERS[others]), np.linspace(0.5, 2.0, 16)
    state, dt = disks(3, 16), 0.01
    simulation = kind(state, model, dt, integrator, masses=masses)
    for exact in islice(slow(state, model, dt, integrator, masses, anew=True), 8):
        assert apart(simulation.state, exact) < 1e-12
        assert sum(simulation.energy()) == pytest.approx(twin.energy(exact, model, masses), abs=1e-11)
        advance(simulation, 1)
    assert simulation.rebuilds > 1


@pytest.fixture(autouse=True)
def cosh(monkeypatch):
    monkeypatch.setitem(POTENTIALS, "cosh", COSH)


@pytest.fixture
def wide_lists(kind, monkeypatch):
    """Let lists last."""
    monkeypatch.setattr(sys.modules[kind.__module__], "SKINS", (0.5, 0.5))


@any_engine("name, integrator", product(MODELS, INTEGRATORS), lambda name, _: name == "CD_rot")
def test_a_call_for_many_steps(kind, name, integrator, wide_lists):
    """On one list the one-evaluation scheme keeps the force of the step before."""
    model, state, dt = Model(MODELS[name], 2.0), slowed(disks(4, 30)), 0.01
    simulation = kind(state, model, dt, integrator)
    advance(simulation, 12)
    assert simulation.rebuilds <= 2  # at the start, and a GPU at the beginning of a call
    assert apart(simulation.state, next(islice(slow(state, model, dt, integrator), 12, None))) < 1e-12


def with_a_giant(state, share):
    """The first disk has a radius of ``share`` of the cell."""
    return replace(state, radii=np.append(share * min(state.length, state.height), state.radii[1:]))


@EACH
def test_steps_of_a_giant_among_small_disks(kind, integrator):
    model, dt = Model(MODELS["CD_rot"], 2.0), 0.01
    state = slowed(with_a_giant(disks(6, 24), 0.25))
    simulation = kind(state, model, dt, integrator)
    for exact in islice(slow(state, model, dt, integrator, anew=True), 8):
        assert apart(simulation.state, exact) < 1e-12
        advance(simulation, 1)
    assert simulation.rebuilds > 1


@pytest.mark.parametrize("shape", [(9.0, 3.0), (3.0, 9.0)], ids=str)
def test_steps_in_a_long_or_a_high_cell(kind, shape):
    """Sheared by many widths, the tilt turning over on the way."""
    model, dt = Model(MODELS["CD_rot"], 2.0), 0.01
    state = disks(12, 30)
    x = state.positions / [state.length, state.height] * shape
    turnover = (1.5 - 1e-3) * shape[0] / shape[1] * (1 if state.rate > 0 else -1)
    state = replace(state, positions=x, length=shape[0], height=shape[1], strain=turnover)
    simulation = kind(state, model, dt)
    tilts = []
    for exact in islice(slow(state, model, dt, "heun"), 8):
        assert apart(simulation.state, exact) < 1e-12
        tilts.append(exact.box.cell[1, 0] / shape[0])
        advance(simulation, 1)
    assert max(tilts) > 0.4 and min(tilts) < -0.4


def test_disks_that_may_meet_two_images_of_another_are_refused(kind):
    with pytest.raises(InputError, match="too small for disks of these sizes"):
        kind(with_a_giant(disks(6, 40), 0.45), Model(MODELS["CD_rot"], 2.0))


def slowed(state):
    """A tenth of the motion."""
    rate = state.rate / 10
    return replace(state, velocities=state.velocities / 10, spins=state.spins / 10, rate=rate)


def trapezoid(values):
    return (values[0] + values[-1]) / 2 + sum(values[1:-1])


def sums_of_a_state(sums, state, model, masses):
    """Compare with the slow twin; the stress of a fluid is added to sums over steps only."""
    fluid = model.fluid * state.area * state.rate
    pressure = np.array(twin.pressure_tensor(state, model, masses)) * state.area
    for name, place in PRESSURE.items():
        expected = pressure[place] + fluid * (name in ("DXY", "DYX"))
        assert sums[getattr(kernels, name)] == pytest.approx(expected, abs=1e-10), name
    assert sums[kernels.HEAT] == pytest.approx(twin.dissipation(state, model) - fluid * state.rate, abs=1e-10)
    assert sums[kernels.TOUCHING] == len(list(twin.touching(state)))
    assert sums[kernels.JUMPS] == 0


@any_engine("law, others", CASES, diagonal)
def test_sums_are_those_of_the_slow_twin(kind, law, others):
    """Pressure tensor, heat, work and contacts: over the states between steps, of the first and of the last state."""
    model, masses = Model(LAWS[law], 2.0, **OTHERS[others]), np.linspace(0.5, 2.0, 24)
    state, dt, steps = disks(5, 24), 0.01, 15
    simulation = kind(state, model, dt, masses=masses)
    sums_of_a_state(simulation.now, state, model, masses)
    advance(simulation, steps)
    total, _, _ = simulation.collect()
    states = list(islice(slow(state, model, dt, "heun", masses), steps + 1))
    pressure = trapezoid([np.array(twin.pressure_tensor(s, model, masses)) for s in states]) * state.area
    sums_of_a_state(simulation.now, states[-1], model, masses)
    for name, place in PRESSURE.items():
        assert total[getattr(kernels, name)] == pytest.approx(pressure[place], abs=1e-10), name
    couples = [model.rotational_drag * s.rate / 2 * np.sum(s.spins + s.rate / 2) for s in states]
    heat = trapezoid([twin.dissipation(s, model) for s in states])
    assert total[kernels.HEAT] == pytest.approx(heat, abs=1e-10)
    work = trapezoid(couples) - state.rate * pressure.sum(0)[0, 1]
    assert total[kernels.WORK] == pytest.approx(work, abs=1e-10)
    assert total[kernels.TOUCHING] == sum(len(list(twin.touching(s))) for s in states[:-1])


def tiled(state, times):
    """The same flow in a cell ``times`` as wide and as high."""
    L, H = state.length, state.height
    nx, ny = (a.ravel()[:, None] for a in np.meshgrid(np.arange(times), np.arange(times)))
    x = np.stack([state.positions[:, 0] + nx * L + ny * state.strain * H, state.positions[:, 1] + ny * H], 2)
    v = np.stack([state.velocities[:, 0] + ny * state.rate * H, state.velocities[:, 1] + 0 * ny], 2)
    return State(
        x.reshape(-1, 2),
        v.reshape(-1, 2),
        np.tile(state.spins, times**2),
        np.tile(state.radii, times**2),
        times * L,
        state.strain,
        state.rate,
        state.time,
        height=times * H,
    )


@EACH
@pytest.mark.parametrize("name", MODELS)
def test_a_flow_repeated_in_a_large_cell_is_the_same_flow(name, integrator):
    """With as many disks that loops and lists are cut into pieces."""
    model, state, times = Model(MODELS[name], 2.0, stokes_drag=0.1), disks(6, 20), 15
    assert len(state) * times**2 > CHUNK
    small = Simulation(state, model, 0.01, integrator)
    large = Simulation(tiled(state, times), model, 0.01, integrator)
    for simulation in (small, large):
        for _ in range(10):
            advance(simulation, 1)
    same_cell = [replace(s, length=state.length, height=state.height) for s in (large.state, tiled(small.state, times))]
    assert apart(*same_cell) < 1e-11
    one, many = small.collect(), large.collect()
    assert close(many[0], times**2 * one[0], 1e-9)
    assert (many[1] == times**2 * one[1]).all()
    assert (many[2] == times**2 * one[2]).all()


# Collisions


@EACH
@pytest.mark.parametrize("Q", [1.0, 2.0, 10.0])
def test_head_on_collision(Q, integrator):
    bounces_as_it_should(fast(integrator), Q)


@any_engine("integrator", [(name,) for name in INTEGRATORS], lambda name: name == "single")
def test_overdamped_disks_never_part(kind, integrator):
    never_parts(end_of(kind, integrator))


@any_engine("bin, place", product([2, 20, 78, 97], [0.3, 2.0, 4.4]), lambda bin, place: bin < 30 and place < 1)
def test_angles_of_a_collision(kind, bin, place):
    """ϑ turns v_ij onto r_ij (VOT eqs. 26, 27); without damping disks part at 180° − ϑ."""
    angle = np.radians(-180 + 3.6 * (bin + 0.5))
    r, v = (np.array([np.cos(a), np.sin(a)]) for a in (place, place - angle))
    x = np.array([[5.0, 5.0], [5.0, 5.0] + (1 + 1e-6) * r])[::-1]
    state = State(x, [1e-3 * v, [0.0, 0.0]], np.zeros(2), np.full(2, 0.5), 10.0)
    simulation = kind(state, Model(MODELS["CD_n"], 1e9))
    advance(simulation, round(5 / simulation.dt))
    _, (made, broken, _), (making, breaking) = simulation.collect()
    assert made == broken == 1
    assert making[bin] == 1
    assert breaking[(149 - bin) % 100] == 1


@EACH
def test_the_angle_of_a_lone_disk_whose_rotation_is_damped(kind, integrator):
    """θ = −γ̇t/2 + (θ̇ + γ̇/2)/λ (1 − exp(−λt)), λ = ζr/(mR²/2), to second order."""
    model, rate, R, spin = Model(MODELS["CD_n"], 1.0, rotational_drag=0.1, mass=2.0), 0.3, 0.6, 0.8
    decay, errors = 0.1 / (2.0 * R**2 / 2), []
    for dt in (0.05, 0.025):
        state = State([[1.0, 2.0]], [[0.6, 0.0]], [spin], [R], 6.0, rate=rate, angles=[0.2])
        simulation = kind(state, model, dt, integrator)
        advance(simulation, round(2 / dt))
        exact = 0.2 - rate / 2 * 2 + (spin + rate / 2) / decay * (1 - np.exp(-2 * decay))
        errors.append(simulation.state.angles[0] - exact)
    assert errors[0] == pytest.approx(4 * errors[1], rel=0.1)
    assert abs(errors[0]) < 1e-3


@EACH
def test_drag_on_a_lone_disk(kind, integrator):
    coarse, fine = (drags_a_lone_disk(end_of(kind, integrator), dt) for dt in (0.05, 0.025))
    assert coarse == pytest.approx(4 * fine, rel=0.1)
    assert coarse < 1e-3


# Largest time steps


def linearised(state, model, masses):
    """M⁻¹B and M⁻¹K of a state at rest, over (x, y, Rθ) of every disk, from the slow twin; K without f/r."""
    n = len(state)
    still = replace(state, velocities=np.zeros((n, 2)), spins=np.zeros(n), rate=0.0)
    without = twin.accelerations(still, model, masses)[0]
    B = []
    for k in range(3 * n):
        motion = np.eye(3 * n)[k].reshape(n, 3)
        moving = replace(still, velocities=motion[:, :2], spins=motion[:, 2] / state.radii)
        a, spin = twin.accelerations(moving, model, masses)
        B.append(np.column_stack([without - a, -spin * state.radii]).ravel())
    K = np.zeros((2 * n, 2 * n))
    for c in twin.contacts(still, model):
        d, distance = state.radii[[c.i, c.j]].sum(), np.hypot(*c.r)
        row = np.zeros((n, 2))
        row[c.i], row[c.j] = c.r / distance, -c.r / distance
        x, unit = twin.overlap(d, distance, model)
        K += model.potential.d2U(x) / unit**2 * np.outer(row, row)
    return np.array(B).T, (K.reshape(n, -1) / masses[:, None]).reshape(K.shape)


@pytest.mark.parametrize("phi", [0.3, 0.9])
@pytest.mark.parametrize(
    "others", [{}, {"stokes_drag": 20.0, "rotational_drag": 4.0}, {"potential": power_law(2.5, False)}]
)
@pytest.mark.parametrize("law", LAW)
def test_the_bounds_of_the_rates_are_above_the_largest_eigenvalues(law, others, phi):
    """And not far above, where disks are alike."""
    model = Model(law, 2.0, **others)
    for masses in (np.ones(20), np.geomspace(1e-3, 1e3, 20)):
        state = disks(11, 20, phi)
        simulation = Simulation(state, model, 1e-6, masses=masses)
        largest = [np.abs(np.linalg.eigvals(A)).max() for A in linearised(state, model, masses)]
        bounds = simulation.fastest()
        assert all(bound >= value * (1 - 1e-12) for bound, value in zip(bounds, largest, strict=True))
        if masses[0] == 1:
            assert all(bound <= 2 * value for bound, value in zip(bounds, largest, strict=True))


def amplification(B, K, integrator):
    """The matrix of one step of length 1, over (x, v) or, with the force kept from the last, (x, v, f)."""
    n = len(B)
    if integrator == "heun":  # VOT eqs. 21–24
        x, v = np.hsplit(np.eye(2 * n), 2)
        x, v = x.T, v.T
        f = -K @ x - B @ v
        f1 = -K @ (x + v) - B @ (v + f)
        v1 = v + (f + f1) / 2
        return np.vstack([x + (v + v1) / 2, v1])
    x, v, f = (part.T for part in np.hsplit(np.eye(3 * n), 3))
    x1 = x + v + f / 2
    f1 = -K @ x1 - B @ (v + f)
    return np.vstack([x1, v + (f + f1) / 2, f1])


@EACH
@pytest.mark.parametrize("share", [0.0, 0.05, 0.3, 0.8, 1.0])
def test_the_largest_step_is_stable(share, integrator):
    """Whatever the modes of B and K: forms drawn at random, which do not commute; ``share`` is that of B."""
    random = np.random.default_rng(1)
    for _ in range(300):
        n = random.integers(1, 6)
        B, K = (A.T @ A for A in (random.normal(size=(random.integers(1, n + 1), n)) for _ in "BK"))
        B, K = B / np.linalg.eigvalsh(B)[-1] * share * 10, K / np.linalg.eigvalsh(K)[-1] * (1 - share) * 100
        dt = stable_step(integrator, 10 * share, 100 * (1 - share))
        values = np.linalg.eigvals(amplification(B * dt, K * dt**2, integrator))
        assert np.abs(values).max() < 1 + 1e-6  # double eigenvalues of size 1 are known to a root of rounding


@EACH
@pytest.mark.parametrize(("b", "k"), [(1.0, 0.0), (0.0, 1.0)])
def test_a_larger_step_is_not_stable(b, k, integrator):
    """One relaxation or one oscillation alone; an oscillation under Heun's scheme at up to 4/3 of it."""
    dt = stable_step(integrator, b, k) * (1.001 if b or integrator == "single" else 1.001 * np.sqrt(4 / 3))
    step = amplification(np.array([[b * dt]]), np.array([[k * dt**2]]), integrator)
    assert np.abs(np.linalg.eigvals(step)).max() > 1 + 1e-5


@EACH
@pytest.mark.parametrize("dt", [0.015, 0.03])
def test_steps_are_divided_where_the_contacts_demand_it(dt, integrator, monkeypatch):
    """Dense bands at Q = 0.1 and a strain rate of 0.3, up to fifteen contacts on a disk: no heat is lost."""

    def missed():
        simulation = flow("CD", integrator, n=256, phi=0.9, Q=0.1, rate=0.3, dt=dt, steps=round(6 / dt))
        before, start = sum(simulation.energy()), simulation.substeps
        advance(simulation, round(20 / dt))
        total, _, _ = simulation.collect()
        heat = total[kernels.HEAT] * dt
        gap = sum(simulation.energy()) - before - total[kernels.WORK] * dt + heat
        return abs(gap) / heat, (simulation.substeps - start) / round(20 / dt)

    share, parts = missed()
    assert share < 2e-3
    assert 1 < parts < 0.05 / dt * (integrator == "single") + 16
    monkeypatch.setattr(Simulation, "demand", lambda self: 1)
    try:
        share, _ = missed()
    except SolverError:
        share = 1.0
    assert share > 0.02


def test_light_disks_take_small_steps(kind):
    """A mass of 1e-2 divides by 100 what damping and springs allow."""
    for lightest, least, most in ((1.0, 1, 2), (1e-2, 16, 64)):
        state = slowed(disks(3, 16))
        simulation = kind(state, Model(MODELS["CD"], 1.0), 0.05, masses=np.where(np.arange(16) == 7, lightest, 1.0))
        advance(simulation, 1)
        assert least <= simulation.most <= simulation.substeps <= most


def test_steps_below_a_thousandth_are_refused(kind):
    with pytest.raises(SolverError, match="require steps below"):
        advance(kind(disks(3, 24), Model(MODELS["CD"], 1.0), 0.05, masses=np.full(24, 1e-6)), 1)


# Conservation, and orders of convergence


def lattice(n):
    """A compressed square lattice of n × n disks in slight motion: for a while no contact is made or broken."""
    rng, rate = np.random.default_rng(0), 0.05
    x = 0.9 * np.stack(np.meshgrid(np.arange(n), np.arange(n)), -1).reshape(-1, 2)
    x, v = x + rng.uniform(-0.01, 0.01, x.shape), rng.normal(0, 0.02, x.shape)
    v[:, 0] += rate * x[:, 1]
    return State(x, v, rng.normal(0, 0.1, n * n), np.full(n * n, 0.5), 0.9 * n, 0.02, rate)


def refined(kind, start, model, integrator, observe, time=0.5, steps=(16, 32, 64)):
    """Return ``observe(simulation)`` after ``time`` in these many steps; nothing may touch or part."""
    found = []
    for n in steps:
        simulation = kind(start, model, time / n, integrator)
        advance(simulation, n)
        total, counts, _ = simulation.collect()
        assert (counts == 0).all()
        found.append(observe(simulation, total))
    return found


@any_engine("name, integrator", product(MODELS, INTEGRATORS), lambda *case: case == ("CD_rot", "single"))
def test_integrators_are_of_second_order(kind, name, integrator):
    """Half the step, a quarter of the change, while contacts stay what they are.

    So is what is missing in the energy budget: change of energy = work of the shear stress − heat.
    """
    model, start = Model(MODELS[name], 2.0, stokes_drag=0.1, rotational_drag=0.01), lattice(4)
    before = twin.energy(start, model)

    def observe(simulation, total):
        power = total[kernels.WORK] - total[kernels.HEAT]
        return simulation.state, sum(simulation.energy()) - before - power * simulation.dt

    (a, first), (b, second), (c, third) = refined(kind, start, model, integrator, observe)
    assert apart(a, b) == pytest.approx(4 * apart(b, c), rel=0.1)
    assert apart(b, c) > 1e-8
    assert first == pytest.approx(4 * second, rel=0.2)
    assert second == pytest.approx(4 * third, rel=0.1)


def angular_momentum(state):
    x, v = state.positions, state.velocities
    return np.sum(x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0]) + twin.inertia(state) @ state.spins


def test_angular_momentum(kind):
    """Of a cluster in the open: VOT's integrator to second order, one evaluation a step to rounding."""
    start, model = strip(0.95), Model(MODELS["CD_rot"], 1.0)
    x = np.where(start.positions < start.length / 2, start.positions + start.length, start.positions)
    start = replace(start, positions=x, velocities=0.1 * start.peculiar, length=20.0, height=20.0, rate=0.0, strain=0.0)

    def change(simulation, _):
        return angular_momentum(simulation.state) - angular_momentum(start)

    coarse, fine = refined(kind, start, model, "heun", change, steps=(32, 64))
    assert coarse == pytest.approx(4 * fine, rel=0.1)
    assert abs(fine) > 1e-8
    assert refined(kind, start, model, "single", change) == pytest.approx(np.zeros(3), abs=1e-13)


@any_engine("name, integrator", product(MODELS, INTEGRATORS), lambda name, _: name == "CD_rot")
def test_momentum_is_conserved_to_rounding(kind, name, integrator):
    """Of the motion against the linear profile, which is the same for every image."""
    state = disks(7, 24)
    state = replace(state, velocities=state.velocities - state.peculiar.mean(0))
    simulation = kind(state, Model(MODELS[name], 1.0), 0.02, integrator)
    advance(simulation, 40)
    assert simulation.rebuilds > 3
    assert np.abs(simulation.state.peculiar.mean(0)).max() < 1e-13


# Invariance


def after(kind, state, integrator, steps=10):
    simulation = kind(state, Model(MODELS["CD_rot"], 1.0), 0.01, integrator)
    advance(simulation, steps)
    return simulation.state, simulation.collect()[0]


@any_engine("seed, integrator", product(range(5), INTEGRATORS), lambda seed, _: seed == 0)
def test_any_image_will_do(kind, seed, integrator):
    state = disks(seed, 24)
    other = by_other_images(state, np.random.default_rng(seed).integers(-4, 5, (24, 2)))
    (one, sums), (two, others) = after(kind, state, integrator), after(kind, other, integrator)
    assert apart(one, two) < 1e-12
    assert close(others, sums)


def shifted(state, x, y):
    along = np.array([state.rate * y, 0.0])
    return replace(state, positions=state.positions + np.array([x, y]), velocities=state.velocities + along)


@any_engine("seed", [(seed,) for seed in range(5)], lambda seed: seed == 0)
def test_the_origin_is_anywhere(kind, seed):
    """The new frame moves with the flow at its origin."""
    state, (x, y) = disks(seed, 24), np.random.default_rng(seed).uniform(-5, 5, 2)
    (one, sums), (two, others) = after(kind, state, "heun"), after(kind, shifted(state, x, y), "heun")
    assert apart(shifted(one, x + state.rate * y * one.time, y), two) < 1e-11
    assert close(others, sums)


def test_the_order_of_the_disks_does_not_matter(kind):
    state, order = disks(8, 24), np.random.default_rng(0).permutation(24)

    def shuffled(state):
        arrays = ("positions", "velocities", "spins", "radii")
        return replace(state, **{name: getattr(state, name)[order] for name in arrays})

    (one, sums), (two, others) = after(kind, state, "heun"), after(kind, shuffled(state), "heun")
    assert apart(shuffled(one), two) < 1e-12
    assert close(others, sums)


@pytest.mark.parametrize("bulk", BULK)
def test_a_change_of_the_rate(kind, bulk, wide_lists):
    """Velocities and spins scaled (VOT eqs. 40, 41), moved with the linear profile, or left as they are.

    All this in the cell; that some disks have left it since pairs were listed must not matter.
    """
    state, model, dt = slowed(disks(9, 30)), Model(MODELS["CD_rot"], 1.0), 0.01
    rising = np.argmax(state.velocities[:, 1])
    state = shifted(state, 0.0, state.height - state.positions[rising, 1] - 1e-6)
    simulation = kind(state, model, dt)
    advance(simulation, 12)
    assert simulation.rebuilds <= 2
    now = simulation.state.wrapped()
    assert simulation.state.positions[rising, 1] > state.height
    new = 1.5 * now.rate
    v, w = now.velocities.copy(), now.spins
    if bulk == "scale":
        v, w = v * new / now.rate, w * new / now.rate
    if bulk == "profile":
        v[:, 0] += (new - now.rate) * now.positions[:, 1]
    changed = replace(now, velocities=v, spins=w, rate=new)
    expected = next(islice(slow(changed, model, dt, "heun"), 3, None))
    simulation.collect()
    simulation.advance(now.strain + new * dt * np.arange(1, 4), np.full(3, new), bulk)
    assert apart(simulation.state, expected) < 1e-12
    gained = twin.energy(changed, model) - twin.energy(now, model)
    assert simulation.collect()[0][kernels.JUMPS] == pytest.approx(gained, abs=1e-11)


@any_engine("bulk, integrator", product(BULK, INTEGRATORS), lambda *case: False)
def test_the_energy_budget_closes_while_the_rate_changes(kind, bulk, integrator):
    """What changes of the rate bring is booked apart; of second order where all follow the linear profile."""
    gaps, falls = [], 0.36 if bulk == "profile" else 0.6
    for steps in (32, 64, 128):
        simulation = kind(lattice(5), Model(MODELS["CD_rot"], 2.0), 0.5 / steps, integrator)
        before = sum(simulation.energy())
        rates = 0.05 * np.cos(2 * simulation.dt * (np.arange(steps) + 0.5))
        simulation.advance(simulation.strain + np.cumsum(rates * simulation.dt), rates, bulk)
        total, _, _ = simulation.collect()
        work, heat = total[kernels.WORK] * simulation.dt, total[kernels.HEAT] * simulation.dt
        gaps.append(abs(sum(simulation.energy()) - before - total[kernels.JUMPS] - work + heat))
    assert gaps[2] < falls * gaps[1] < falls**2 * gaps[0]
    assert gaps[2] < 3e-3 * heat


# Flows


def flow(name, integrator="heun", kind=Simulation, n=64, rate=0.01, dt=0.05, steps=4000, phi=0.82, Q=1.0):
    """A flow far from its start at random positions."""
    start = random_state(n, phi, 1)
    v = np.column_stack([rate * start.positions[:, 1], np.zeros(n)])
    simulation = kind(replace(start, velocities=v, rate=rate), Model(MODELS[name], Q), dt, integrator)
    advance(simulation, steps)
    simulation.collect()
    return simulation


FLOWS = {"cpu": {}, "cuda": {"n": 16, "rate": 0.3, "steps": 20}}


@any_engine("name, integrator", product(MODELS, INTEGRATORS), lambda name, _: name == "CD_rot")
def test_contacts_are_twice_the_contact_time(engine, kind, name, integrator):
    """Z = 2 × total contact time/(N × window), contacts still open counted: exact, in parts of steps."""
    simulation = flow(name, integrator, kind, dt=0.1, **FLOWS[engine])
    n, window = len(simulation), 3000 if engine == "cpu" else 40
    older = simulation.checkpoint()["contacts"][:, 2]
    before, substeps = np.sum(simulation.steps * TICKS - older), simulation.substeps
    advance(simulation, window)
    if (engine, name, integrator) == ("cpu", "CD_rot", "heun"):  # there and back, time and again
        assert window < simulation.substeps - substeps < 2 * window
    total, (made, broken, lasted), angles = simulation.collect()
    still = simulation.checkpoint()["contacts"][:, 2]
    assert made > (100 if engine == "cpu" else 10)
    assert len(older) + made == len(still) + broken
    assert angles.sum(1).tolist() == [made, broken]
    touched = lasted + np.sum(simulation.steps * TICKS - still) - before
    assert total[kernels.TOUCHING] * TICKS == touched
    assert 2 < 2 * total[kernels.TOUCHING] / (n * window) < 5


@any_engine("name", [(name,) for name in MODELS], lambda name: name == "CD_rot")
def test_contacts_are_those_of_the_slow_twin(engine, kind, name):
    simulation = flow(name, kind=kind, **FLOWS[engine])
    for _ in range(3):
        advance(simulation, 50 if engine == "cpu" else 7)
        simulation.collect()
        listed = {frozenset(pair) for pair in simulation.checkpoint()["contacts"][:, :2].tolist()}
        assert listed == {frozenset((i, j)) for i, j, _, _ in twin.touching(simulation.state)}


def test_a_sample_of_disks_and_contacts(kind):
    """Spins, velocities (VOT eqs. 29, 35, 36), contact velocities (eqs. 31–34, the arms of eq. 6), layers."""
    simulation = kind(disks(10, 40), Model(MODELS["CD_rot"], 1.0), 0.01)
    advance(simulation, 7)
    simulation.collect()
    layers, moments, scatter = np.zeros((LAYERED, 4)), np.zeros((5, 4)), np.zeros(4)
    sums = simulation.sample(layers, moments, scatter)
    state, rows = simulation.state, []
    for i, j, r, v in twin.touching(state):
        d, out = state.radii[i] + state.radii[j], -r / np.hypot(*r)
        rolling = np.hypot(*r) / d * (state.spins[i] * state.radii[i] + state.spins[j] * state.radii[j])
        across = v @ twin.turned(out)
        rows.append([across, rolling, across + rolling, v @ out])
    rows, c = np.array(rows), twin.peculiar(state)
    expected = [state.spins.sum(), (state.spins**2).sum(), *(c**2).sum(0), (rows[:, 3] ** 2).sum()]
    assert sums == pytest.approx([*expected, (rows[:, 0] ** 2).sum(), len(rows)])
    assert moments[0] == pytest.approx((rows / state.rate).sum(0))
    assert moments[1:] == pytest.approx(rows.T @ rows / state.rate**2)
    assert np.abs(rows / state.rate - scatter).max(1).min() < 1e-10
    inside = state.wrapped()
    layer = (inside.positions[:, 1] / state.height * 4).astype(int)
    for k, weight in enumerate((np.ones(40), inside.velocities[:, 0], np.pi * state.radii**2)):
        assert layers[k] == pytest.approx(np.bincount(layer, weight, 4))
    stress = np.zeros((3, 4))
    for contact in twin.contacts(state, simulation.model):
        flow = np.outer(contact.elastic + contact.dissipative, contact.r)
        for disk in (contact.i, contact.j):
            stress[:, layer[disk]] += flow[0, 0] / 2, flow[0, 1] / 2, flow[1, 1] / 2
    for disk, (x, y) in enumerate(c):
        stress[:, layer[disk]] += x * x, x * y, y * y
    assert layers[3:] == pytest.approx(stress)
    total = sum(twin.pressure_tensor(state, simulation.model)) * state.length * state.height
    assert stress.sum(1) == pytest.approx(total[[0, 0, 1], [0, 1, 1]])


@EACH
@pytest.mark.parametrize("name", MODELS)
def test_the_energy_budget_of_a_flow(name, integrator):
    """Forces jump as contacts are made and broken: what is missing falls with the time step."""
    shares = []
    for dt in (0.05, 0.0125):
        simulation = flow(name, integrator, dt=dt, steps=round(200 / dt))
        before = sum(simulation.energy())
        advance(simulation, round(200 / dt))
        total, _, _ = simulation.collect()
        gained, heat = sum(simulation.energy()) - before, total[kernels.HEAT] * dt
        shares.append(abs(gained - total[kernels.WORK] * dt + heat) / heat)
    assert shares[0] < 5e-3
    assert shares[1] < shares[0] / 4


@EACH
def test_disks_turn_with_half_the_vorticity(integrator):
    simulation, spins = flow("CD_rot", integrator, n=256, steps=2000), []
    for _ in range(200):
        advance(simulation, 100)
        spins.append(simulation.state.spins.mean())
    blocks = np.mean(np.reshape(spins, (10, -1)), axis=1) / simulation.rate
    error = blocks.std(ddof=1) / np.sqrt(len(blocks))
    assert error < 0.02
    assert blocks.mean() == pytest.approx(-0.5, abs=0.02 + 3 * error)


def test_disks_that_leave_their_neighbours_within_a_step_are_refused(kind):
    """No list of pairs holds for a step: an error, not an endless loop."""
    state = disks(0, 24)
    simulation = kind(replace(state, velocities=30 * state.velocities), Model(MODELS["CD_rot"], 1.0), 0.05)
    with pytest.raises(SolverError, match="take a smaller dt"):
        advance(simulation, 10)
