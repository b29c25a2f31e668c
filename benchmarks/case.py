"""One case of sheared disks for other programs: its state, its numbers with errors, and the speed of this program.

    python benchmarks/case.py [--seeds S] [--strain γ] [--runs FOLDER]

CD_rot, N = 1024, φ = 0.82, Q = 1, γ̇τe = 1e-3, dt = 0.04 τe. Writes docs/case: the state as input of LAMMPS
(disks.data, in.shear), its numbers without a time step and after 1000 steps, and the means of independent runs.
Runs are resumable, one after another on one core: about 40 s each for a strain of 50.
"""

import argparse
import time
from pathlib import Path

import numpy as np

import petscjam as pj
from petscjam.analysis.flows import mean
from petscjam.analysis.statistics import standard_error
from petscjam.base.compiled import build
from petscjam.io.lammps_shear import write_lammps
from petscjam.md.engine import DXX, DXY, DYY, EXX, EXY, EYY, KXX, KXY, KYY, TOUCHING
from petscjam.md.simulation import Simulation

DOCS = Path(__file__).resolve().parents[1] / "docs" / "case"
CASE = {"model": "CD_rot", "n": 1024, "phi": 0.82, "Q": 1.0, "rate": 1e-3, "dt": 0.04}
STEPS = 1000
MEANS = {
    "P": "pressure",
    "P, elastic": "pressure_elastic",
    "Σ": "stress",
    "Σ, elastic": "stress_elastic",
    "μ = Σ/P": "friction",
    "Z": "contacts",
}


def means(run):
    """Return the means of a run."""
    found = {name: run.mean(what).value for name, what in MEANS.items()}
    found["Σ, dissipative, share"] = run.mean("dissipative_xy").value / run.mean("stress").value * -1
    found["νcoll τe, contacts made per disk"] = mean(run, "collision_rate").value
    found["τdur/τe"] = mean(run, "duration_time").value
    found["⟨θ̇⟩/γ̇"] = run.mean("spin").value / CASE["rate"]
    return found


def stresses(sums, area):
    """Return P, Σ and Z of sums over contacts and disks."""
    pressure = (sums[EXX] + sums[EYY] + sums[DXX] + sums[DYY] + sums[KXX] + sums[KYY]) / (2 * area)
    return pressure, -(sums[EXY] + sums[DXY] + sums[KXY]) / area, 2 * sums[TOUCHING] / CASE["n"]


def advance(simulation, steps):
    """Shear on at the same rate."""
    rates = np.full(steps, simulation.rate)
    simulation.advance(simulation.strain + np.cumsum(rates) * simulation.dt, rates)


def first_numbers(state, model):
    """Return lines of a table: the state as it is, and after some steps of the integrator."""
    lines = []
    for integrator in ("heun", "single"):
        simulation = Simulation(state, model, CASE["dt"], integrator)
        for steps in (0, STEPS):
            advance(simulation, steps)
            sums = simulation.now
            P, sigma, Z = stresses(sums, simulation.length * simulation.height)
            energy = " | ".join(f"{e:.9g}" for e in simulation.energy())
            lines.append(f"| {integrator}, {steps} steps | {P:.9g} | {sigma:.9g} | {Z:.8g} | {energy} |")
    return lines


def speed(state, model, integrator):
    """Return the million particle-steps a second on one core."""
    simulation, best = Simulation(state, model, CASE["dt"], integrator), np.inf
    advance(simulation, STEPS)
    for _ in range(5):
        began = time.process_time()
        advance(simulation, 10 * STEPS)
        best = min(best, time.process_time() - began)
    return 10 * STEPS * CASE["n"] / best / 1e6


def main():
    """Run what is missing, and write."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=16, help="independent runs of each time step (16)")
    parser.add_argument("--strain", type=float, default=50.0, help="of a run (50); a quarter is left out")
    parser.add_argument("--runs", type=Path, default=Path("runs/case"), help="folder of the runs (runs/case)")
    options = parser.parse_args()
    options.runs.mkdir(parents=True, exist_ok=True)
    DOCS.mkdir(parents=True, exist_ok=True)
    start = pj.md.shear(**CASE, strain=5.0, seed=1, output=options.runs / "start.h5", resume=True)
    model = start.settings.model
    write_lammps(start.state, model, DOCS, rate=CASE["rate"], strain=options.strain, dt=CASE["dt"], overwrite=True)
    tables = {}
    for dt in (CASE["dt"], CASE["dt"] / 2):
        found = []
        for seed in range(1, options.seeds + 1):
            file = options.runs / f"dt{dt:g}-seed{seed}.h5"
            run = pj.md.shear(**CASE | {"dt": dt}, strain=options.strain, seed=seed, output=file, resume=True)
            found.append(means(run))
            print(file, *(f"{name} {value:.5g}" for name, value in found[-1].items()), sep="  ", flush=True)
        tables[dt] = {name: np.array([one[name] for one in found]) for name in found[0]}
    head = " | ".join(f"dt = {dt:g} τe" for dt in tables)
    lines = [
        "# Results of the test case",
        "",
        f"Means of {options.seeds} runs from random positions to a strain of {options.strain:g}, the first quarter "
        "left out; errors from the scatter of the runs.",
        "",
        f"| | {head} |",
        "|---|" + "---|" * len(tables),
    ]
    for name in tables[CASE["dt"]]:
        values = [table[name] for table in tables.values()]
        cells = (f"{v.mean():.5g} ± {standard_error(v):.1g}" for v in values)
        lines.append(f"| {name} | {' | '.join(cells)} |")
    lines += [
        "",
        f"The state of `disks.data`, γ = {start.state.strain:g}, and the same after {STEPS} steps of dt = "
        f"{CASE['dt']:g} τe:",
        "",
        "| | P | Σ | Z | elastic energy | peculiar kinetic energy | rotational energy |",
        "|---|---|---|---|---|---|---|",
        *first_numbers(start.state, model),
        "",
        "| machine | heun | single |",
        "|---|---|---|",
        f"| one core of {build()['processor']} | "
        + " | ".join(f"{speed(start.state, model, name):.0f}" for name in ("heun", "single"))
        + " |",
        "",
        "Million particle-steps per second, with all observables at every step.",
    ]
    (DOCS / "results.md").write_text("\n".join([*lines, ""]))


if __name__ == "__main__":
    main()
