"""Time steps of sheared disks: the largest stable one against its bound, and what the energy budget misses.

    python benchmarks/stability.py

First, for each model and integrator, flows of 1024 disks with steps undivided: the largest of a row of time
steps at which the energy budget of 4000 steps misses less than a tenth of the heat, and the bound from the
contacts of the start. Then the share of the heat that the budget misses with the default step, 256 disks: the
largest over packing fractions and strain rates.
"""

import warnings
from itertools import product

import numpy as np

import petscjam as pj
from petscjam.base.errors import SolverError
from petscjam.md import kernels
from petscjam.md.model import INTEGRATORS, MODELS, Model, stable_step
from petscjam.md.simulation import Simulation

STEPS = 4000
FLOWS = [(1.0, 0.84, 1e-3, 0.2), (0.1, 0.9, 0.3, 6.0)]  # Q, φ, γ̇, and the strain of the start
TRIED = np.arange(0.8, 2.6, 0.1)  # of the bound
PHIS, RATES, STRAINS = [0.3, 0.6, 0.8], [0.3, 1e-2, 1e-3], [6.0, 4.0, 2.0]


class Undivided(Simulation):
    """Steps are not divided, whatever the contacts demand."""

    def demand(self):
        """Return 1."""
        return 1


def missed(state, model, integrator, dt):
    """Return the share of the heat that is not accounted for; inf if the run fails."""
    simulation = Undivided(state, model, 1e-4, integrator)
    simulation.dt, before = dt, sum(simulation.energy())
    rates = np.full(STEPS, state.rate)
    try:
        simulation.advance(simulation.strain + np.cumsum(rates) * dt, rates)
    except SolverError:
        return np.inf
    total = simulation.collect()[0] * dt
    heat = total[kernels.HEAT]
    return abs(sum(simulation.energy()) - before - total[kernels.WORK] + heat) / heat


def stability(name, Q, phi, rate, strain):
    """Print bound and largest stable step of each integrator, in units of Q."""
    state, model = pj.md.shear(name, 1024, phi, Q, rate=rate, strain=strain).state, Model(MODELS[name], Q)
    for integrator in INTEGRATORS:
        bound = stable_step(integrator, *Simulation(state, model).fastest())
        heats = (missed(state, model, integrator, share * bound) > 0.1 for share in TRIED)
        share = next((tried - 0.1 for tried, hot in zip(TRIED, heats, strict=False) if hot), np.inf)
        print(
            f"{name:6s} Q = {Q:g}, φ = {phi:g}, γ̇ = {rate:g}, {integrator:6s}: bound {bound / Q:.3f} Q, "
            f"stable to {share:.1f} times that",
            flush=True,
        )


def budgets(name, Q):
    """Print the largest share of the heat that is missed with each integrator's default step."""
    for integrator in INTEGRATORS:
        shares = {
            (phi, rate): pj.md.shear(name, 256, phi, Q, rate=rate, strain=strain, integrator=integrator).missed
            for phi, (rate, strain) in product(PHIS, zip(RATES, STRAINS, strict=True))
        }
        worst = max(shares, key=shares.get)
        dt = Model(MODELS[name], Q).step(None, integrator)
        print(
            f"{name:6s} Q = {Q:<4g} {integrator:6s} dt = {dt:.4f}: {100 * shares[worst]:.2f} % missed "
            f"(φ = {worst[0]:g}, γ̇ = {worst[1]:g})",
            flush=True,
        )


def main():
    """Print a line for each case."""
    warnings.simplefilter("ignore")
    for name, flow in product(MODELS, FLOWS):
        stability(name, *flow)
    for name, Q in product(MODELS, [0.3, 1.0, 10.0]):
        budgets(name, Q)


if __name__ == "__main__":
    main()
