"""Largest time step, in τe at Q = 1, at which each integrator keeps a dense flow from heating up.

    python benchmarks/stability.py [DT …]

1024 disks at φ = 0.84, γ̇τe = 1e-3, 4000 steps with the guard switched off: a step is unstable if the peculiar
kinetic and rotational energy then is more than three times that at dt = 0.02.
"""

import sys

import numpy as np

import petscjam as pj
from petscjam.errors import SolverError
from petscjam.md.model import INTEGRATORS, MODELS, Model
from petscjam.md.simulation import Simulation

STEPS, RATE = 4000, 1e-3
TRIED = [0.04, 0.06, 0.08, 0.1, 0.12, 0.15, 0.18, 0.2, 0.25, 0.3, 0.35, 0.4]


def motion(model, state, integrator, dt):
    """Return the mean kinetic and rotational energy late in the run; inf if it fails."""
    simulation = Simulation(state, model, 0.01, integrator)
    simulation.dt = dt
    values = []
    try:
        for _ in range(40):
            rates = np.full(STEPS // 40, RATE)
            simulation.advance(simulation.strain + np.cumsum(rates) * dt, rates)
            values.append(sum(simulation.energy()[1:]))
    except SolverError:
        return np.inf
    return np.mean(values[20:])


def main():
    """Print a line for each model and integrator."""
    tried = [float(word) for word in sys.argv[1:]] or TRIED
    for name, law in MODELS.items():
        state = pj.md.shear(name, 1024, 0.84, rate=RATE, strain=0.2, dt=0.02).state
        for integrator in INTEGRATORS:
            model = Model(law, 1.0)
            calm = motion(model, state, integrator, 0.02)
            ratios = [motion(model, state, integrator, dt) / calm for dt in tried]
            print(
                name, integrator, *(f"{dt:g}: {ratio:.3g}" for dt, ratio in zip(tried, ratios, strict=True))
            )


if __name__ == "__main__":
    main()
