"""The engine for GPUs on this machine: agreement with the CPU, repetition, restarts, speed.

    python benchmarks/shear_cuda.py

It installs nothing, ends within five minutes, and prints a table with the name of the card. Exit status 1: a check has
failed. In numba's simulator: NUMBA_ENABLE_CUDASIM=1 python benchmarks/shear_cuda.py --disks 16 --tiles 2,3 --steps 20
"""

import argparse
import sys
import time
import warnings
from dataclasses import replace

import numpy as np

from petscjam.base.errors import DoubtfulWarning
from petscjam.md import cuda, cuda_batch, protocols, simulation
from petscjam.md.cuda import CudaSimulation, abreast, together
from petscjam.md.engine import JUMPS, Advance
from petscjam.md.model import Model
from petscjam.md.runs import begin, run
from petscjam.md.simulation import Simulation

MODEL = Model.of("CD_rot", 1.0)
SKIN = 0.1  # ds: no list is rebuilt in a check
failed = []


def check(text, passed):
    """Print the result of a check."""
    print(f"{'passed' if passed else 'FAILED'}  {text}", flush=True)
    if not passed:
        failed.append(text)


def tiled(state, m):
    """Return m × m copies of a state, with velocities that differ by a thousandth of γ̇ ds."""
    column, row = (index.ravel()[:, None] for index in np.meshgrid(np.arange(m), np.arange(m)))
    x = state.positions[:, 0] + (column + row * state.strain) * state.length
    y, u = state.positions[:, 1] + row * state.height, state.velocities[:, 0] + row * state.rate * state.height
    v = np.broadcast_to(state.velocities[:, 1], y.shape)
    noise = 1e-3 * state.rate * np.random.default_rng(1).normal(size=(y.size, 2))
    return replace(
        state,
        positions=np.column_stack([x.ravel(), y.ravel()]),
        velocities=np.column_stack([u.ravel(), v.ravel()]) + noise,
        spins=np.tile(state.spins, m * m),
        radii=np.tile(state.radii, m * m),
        length=m * state.length,
        height=m * state.height,
    )


def at_rate(state, rate):
    """Return the state at another rate, velocities scaled (VOT eqs. 40, 41)."""
    factor = rate / state.rate
    return replace(state, velocities=factor * state.velocities, spins=factor * state.spins, rate=rate)


def advanced(engine, steps):
    """Make steps at the present rate; return the engine."""
    rates = np.full(steps, engine.rate)
    engine.advance(np.cumsum(np.append(engine.strain, rates * engine.dt))[1:], rates, "scale")
    return engine


def made(kind, state, integrator, steps):
    """Return an engine after some steps without a new list in between, and its sums."""
    engine = kind(state, MODEL, None, integrator, 1)
    engine.skin = SKIN
    totals = advanced(engine, steps).collect()
    return engine, totals


def agreement(state, integrator, steps):
    """Compare trajectories and sums with those of the CPU, and one run with another."""
    (cpu, one), (gpu, two) = (made(kind, state, integrator, steps) for kind in (Simulation, CudaSimulation))
    a, b = cpu.state.wrapped(), gpu.state.wrapped()
    away = a.positions - b.positions
    away -= np.rint(away / [a.length, a.height]) * [a.length, a.height]
    apart = max(np.abs(away).max(), np.abs(a.velocities - b.velocities).max(), np.abs(a.spins - b.spins).max())
    sums = np.delete(np.abs(one.sums - two.sums) / np.abs(one.sums).clip(1e-9), JUMPS).max()
    events = np.abs(one.counts - two.counts).max()
    built = gpu.rebuilds - 2
    text = f"{len(state)} disks, {integrator}, {steps} steps: differs by {apart:.1e}, sums by {sums:.1e}"
    check(f"{text}, events by {events}; {built} lists in between", apart < 1e-10 and sums < 1e-8 and events == 0)
    again, _ = made(CudaSimulation, state, integrator, steps)
    check(f"{len(state)} disks, {integrator}: the same again, bit for bit", equal(again.state, gpu.state))
    saved = gpu.checkpoint()
    on = [advanced(engine, steps) for engine in (gpu, CudaSimulation.restored(saved, MODEL, gpu.dt, integrator))]
    sums = [engine.collect() for engine in on]
    same = equal(*(engine.state for engine in on)) and all(map(np.array_equal, *sums))
    check(f"{len(state)} disks, {integrator}: a restart continues bit for bit", same)


def equal(a, b):
    """Whether two states are the same, bit for bit."""
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ("positions", "velocities", "spins"))


def company(state, steps):
    """Compare runs in a batch with the same runs alone."""
    states = [at_rate(state, rate) for rate in (1e-4, 3e-4)]
    alone = [advanced(CudaSimulation(start, MODEL, None, "single"), steps) for start in states]
    both = [CudaSimulation(start, MODEL, None, "single") for start in states]
    batch = cuda_batch.Batch(both[0], 2)
    for engine in both:
        batch.put(engine)
    rates = [np.full(steps, engine.rate) for engine in both]
    strains = [np.cumsum(np.append(e.strain, r * e.dt))[1:] for e, r in zip(both, rates, strict=True)]
    together(Advance(*request, "scale", True) for request in zip(both, strains, rates, strict=True))
    check(
        "runs in a batch are those alone, bit for bit",
        all(equal(a.state, b.state) for a, b in zip(alone, both, strict=True)),
    )


def physics(state, strain):
    """Compare the means of a run with those of the CPU."""
    given = {"model": "CD_rot", "start": state, "integrator": "single"}
    cpu, gpu = (run(protocols.steady(1e-2, strain), engine=engine, **given) for engine in ("cpu", "cuda"))
    for name in ("elastic_yy", "contacts", "dvx2"):
        a, b = cpu.mean(name), gpu.mean(name)
        close = abs(a.value - b.value) < 4 * np.hypot(a.error, b.error)
        both = f"{a.value:.4g} ± {a.error:.1g} on the CPU, {b.value:.4g} ± {b.error:.1g} on the GPU"
        check(f"mean {name} to a strain of {strain:g}: {both}", close)
    check(f"the energy budget misses {gpu.missed:.1e} of the heat", gpu.missed < 0.01)


def speed(name, states, seconds, row_steps, goal=None):
    """Measure particle-steps a second with all observables, and print a line."""
    n, rate = len(states[0]), states[0].rate
    dt = MODEL.step(None, "single")

    def start(task):
        k, rows = task
        protocol = protocols.steady(rate, rows * row_steps * dt * rate)
        row_time = row_steps * dt
        return begin(protocol, "CD_rot", start=states[k], integrator="single", row_time=row_time, engine="cuda")

    def measured(rows):
        began, runs = time.perf_counter(), {}
        errors = list(abreast([(k, rows) for k in range(len(states))], start, runs.__setitem__))
        assert not errors, errors
        built = sum(done.rows["rebuilds"].sum() for done in runs.values())
        steps = sum(done.rows["steps"].sum() for done in runs.values())
        return time.perf_counter() - began, steps / built

    measured(1)  # compiles
    once = measured(1)[0]
    some = 1 + max(1, int(seconds / once))
    took, lasts = measured(some)
    figure = (some - 1) * row_steps * n * len(states) / max(took - once, 1e-9)  # without the start of the runs
    reached = "" if goal is None else f"goal {goal / 1e9:.0f}: {'reached' if figure >= goal else 'NOT reached'}"
    step = 1e6 * (took - once) / ((some - 1) * row_steps)
    print(f"{name:44s} {step:10.2f} {figure / 1e6:12.0f} {lasts:9.0f}  {reached}", flush=True)


def main():
    """Check, then measure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--disks", type=int, default=1024, help="of a run of a batch")
    parser.add_argument("--tiles", default="8,32", help="M1,M2: large runs have M² times as many disks")
    parser.add_argument(
        "--steps", type=int, default=200, help="of a check; a row has 250 times as many, of the largest run fifty times"
    )
    parser.add_argument("--seconds", type=float, default=4.0, help="of each measurement")
    options = parser.parse_args()
    few, many = map(int, options.tiles.split(","))
    warnings.simplefilter("ignore", DoubtfulWarning)
    simulation.SKIN = SKIN
    cuda.MOST = options.disks
    began, row_steps = time.perf_counter(), 250 * options.steps
    print(cuda.name(), flush=True)
    strain = min(1.0, options.steps / 200)
    flow = run(protocols.steady(1e-3, strain), "CD_rot", options.disks, 0.80, integrator="single").state
    slow, dense = at_rate(flow, 1e-4), run(protocols.steady(1e-3, strain), "CD_rot", options.disks, 0.82).state
    for state, integrator in ((slow, "heun"), (slow, "single"), (tiled(slow, few), "single")):
        agreement(state, integrator, options.steps)
    company(slow, options.steps)
    physics(flow, 10 * strain)
    print(f"\n{'':44s} {'us a step':>10s} {'million/s':>12s} {'steps/list':>9s}")
    room, large = cuda_batch.places(options.disks), f"{options.disks * few**2} disks"
    usual = cuda_batch.THREADS
    for threads in [usual] if cuda.simulated else [usual, (1024, 1024)]:
        cuda_batch.THREADS = threads
        more = f"{threads[0]} threads"
        runs = max(cuda_batch.places(options.disks), 2)
        speed(f"{runs} x {options.disks}, rate 1e-4, {more}", [slow] * runs, options.seconds, row_steps, 12e9)
        speed(f"{large}, rate 1e-4, {more}", [tiled(slow, few)], options.seconds, row_steps, 4e9)
    cuda_batch.THREADS = usual
    speed(f"{2 * room} x {options.disks}, rate 1e-4", [slow] * 2 * room, options.seconds, row_steps)
    speed(f"{room} x {options.disks}, phi 0.82, rate 1e-3", [dense] * room, options.seconds, row_steps)
    speed(f"{room} x {options.disks}, rate 1e-5", [at_rate(flow, 1e-5)] * room, options.seconds, row_steps)
    calm = at_rate(flow, 3e-5)
    speed(f"{large}, rate 3e-5", [tiled(calm, few)], options.seconds, row_steps, 4e9)
    speed(f"{options.disks * many**2} disks, rate 1e-4", [tiled(slow, many)], options.seconds, row_steps // 5, 6e9)
    print(f"{time.perf_counter() - began:.0f} s in all")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
