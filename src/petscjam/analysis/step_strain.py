"""The stress after a step of strain of any size, by the disk engine, with the linear relaxation modulus G(t).

Axes: a step, t time.
"""

from __future__ import annotations

from argparse import ArgumentParser
from dataclasses import dataclass, field, replace
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from petscjam.analysis.oscillation import Units, sheared
from petscjam.base import arguments, ranges
from petscjam.base.errors import InputError
from petscjam.base.progress import Progress, Report, reporting
from petscjam.base.types import Array, numbers
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.packing import Packing
from petscjam.md import protocols
from petscjam.md.model import Model
from petscjam.md.runs import begin, finish
from petscjam.md.starts import given_state
from petscjam.parallel.comm import Comm, agree, on_root, resolve
from petscjam.response.origin import Result, Verb, stored
from petscjam.response.reduced import spectrum
from petscjam.rows.damping import DampingLaw, law_or_default, with_law

STEP = ranges.Range(1e-12, 10)
TIMES = ranges.Range(1e-30, 1e30)
INERTIA, HEAVIEST = 5e-4, 0.1  # largest mass, in kτ1t with the earliest time t of a run, and in kτ1²
FEWEST, FINEST = 4, 1e-4  # time steps in which the strain is applied, and its largest part
FASTEST = 50.0  # strain rate, 1/τe
AT_ONCE = 0.1  # longest time of the strain, in earliest times


@dataclass(frozen=True, eq=False)
class StepStrain(Result):
    """Stress relaxation after steps of strain. Units: stress k (BT) or ke/d² (VOT), time τ1.

    Attributes
    ----------
    step : (A,)
        γ, ascending.
    time : (T,)
        After the step, τ1, ascending.
    modulus : (A, T)
        [σ(t) − σ(before)]/γ.
    linear : (T,)
        G(t) of the reduced model.
    mass : (T,)
        Of every disk, kτ1².
    contact_events : (A,)
        Contacts made and broken up to the last time, over the number of contacts.
    """

    step: Array = field(metadata=stored("1", "A", finite=True))
    time: Array = field(metadata=stored("tau1", "T", finite=True))
    modulus: Array = field(metadata=stored("stress", "A T", finite=True))
    linear: Array = field(metadata=stored("stress", "T", finite=True))
    mass: Array = field(metadata=stored("stress*tau1**2", "T", finite=True))
    contact_events: Array = field(metadata=stored("1", "A"))
    settings: ClassVar[tuple[str, ...]] = ("damping",)
    lines: ClassVar[str] = "A T"
    units: ClassVar[str] = "moduli in k, at the last time, in tau1; linear: G(t) of the linear response"
    figure: ClassVar[str] = "petscjam.plots.step_strain:step_figure"

    def row(self) -> dict[str, float | str]:
        """Return its line of the table."""
        return {
            "law": str(self.damping),
            "t": self.time[-1],
            "G linear": self.linear[-1],
            f"G at {self.step[0]:.3g}": self.modulus[0, -1],
            f"G at {self.step[-1]:.3g}": self.modulus[-1, -1],
            "contact events": self.contact_events[-1],
        }


@reporting
@with_law
def step_strain(
    packing: Packing,
    steps: ArrayLike,
    times: ArrayLike,
    *,
    inertia: float = INERTIA,
    engine: str = "cpu",
    damping: DampingLaw | str | None = None,
    prestress: bool = True,
    comm: Comm | None = None,
    name: str = "packing",
    progress: Progress | None = None,
) -> StepStrain:
    """Shear a packing by γ at once, and return its stress afterwards.

    Each decade of time has its own run, with a mass as small as the time allows: G(t) is that of massless disks.

    Parameters
    ----------
    packing : Packing
        As for :func:`petscjam.oscillate`.
    steps : (A,) array_like
        γ.
    times : (T,) array_like
        In τ1.
    inertia : float
        The mass in kτ1t, with the earliest time t of a run; it is at most 0.1 kτ1², and smaller if the largest step
        would take more than t/10.
    engine : str
        A name of :data:`petscjam.md.runs.ENGINES`.
    damping, comm, name, progress
        As for :func:`petscjam.spectrum`. The engine is serial: rank 0 of ``comm`` runs it.
    prestress : bool
        True: disks exert their contact forces.

    Raises
    ------
    InputError
        On a number that is out of range, or without pre-stress.
    SolverError
        If velocities diverge, or a solve of the linear response fails.
    """
    comm = resolve(comm)
    agree(comm, packing, steps, times, inertia, engine, damping, prestress)
    law = law_or_default(damping)
    gamma, t = np.unique(numbers("strain", steps)), np.unique(numbers("time", times))
    for what, some, known in (("strain", gamma, STEP), ("time", t, TIMES)):
        if not len(some):
            raise InputError(f"{what}: there is none")
        for value in some:
            known.check(f"{what}: values", float(value))
    ranges.Range(1e-9, 1).check("inertia", inertia)
    if not prestress:
        raise InputError("step-strain: the disks exert their contact forces, so pre-stress cannot be left out")
    turned, notes = sheared(packing)
    model = spectrum(turned, (0.01 / t[-1], 100 / t[0]), damping=law, displacements=False, comm=comm, name=name)
    decade = np.floor(np.log10(t / t[0]) + 1e-9)
    groups = [t[decade == k] for k in np.unique(decade)]
    masses = [_mass(turned, law, gamma[-1], some[0], inertia) for some in groups]
    runs = [Relax(float(a), *each) for a in gamma for each in zip(groups, masses, strict=True)]
    found = on_root(comm, _relaxed, runs, turned, law, engine, progress)
    moduli, events, doubts = zip(*found, strict=True)
    return StepStrain(
        step=gamma,
        time=t,
        modulus=np.concatenate(moduli).reshape(len(gamma), len(t)),
        linear=model.G(t),
        mass=np.repeat(masses, [len(some) for some in groups]),
        contact_events=np.reshape(events, (len(gamma), len(groups)))[:, -1],
        origin=replace(model.origin, checksum=packing.checksum),
        notes=(*model.notes, *notes, *filter(None, doubts)),
    )


class Relax(NamedTuple):
    """A run: γ, times in τ1, and mass in kτ1²."""

    step: float
    times: Array
    mass: float


def _applied(packing: Packing, law: DampingLaw, step: float, mass: float) -> tuple[Units, float, float]:
    """Return the units of a run, its time step, and the time in which the strain is applied, in τe."""
    units = Units.of(packing, mass)
    dt = Model.of(law, units.Q, potential=packing.potential).step(None, "heun") / 2
    return units, dt, max(FEWEST, int(np.ceil(step / FINEST)), int(np.ceil(step / dt / FASTEST))) * dt


def _mass(packing: Packing, law: DampingLaw, step: float, earliest: float, inertia: float) -> float:
    """Return the mass of a run, kτ1²."""
    soft = Units.of(packing, 1.0).stress
    mass = min(inertia * earliest, HEAVIEST * soft)
    while True:
        units, _, ramp = _applied(packing, law, step, mass)
        if ramp * units.rate <= AT_ONCE * earliest:
            return mass
        mass /= 2


def _relaxed(
    runs: list[Relax], packing: Packing, law: DampingLaw, engine: str, progress: Report | None
) -> list[tuple[Array, float, str]]:
    """Return [σ(t) − σ(before)]/γ, (T,), contacts made and broken by contact, and doubts, of each run."""
    start, _ = given_state(packing)
    assert start is not None
    before = -ContactNetwork.of(start.packing()).stress[0, 1]
    cost = np.array([one.times[-1] / one.mass for one in runs])
    found: list[tuple[Array, float, str]] = []
    for k, one in enumerate(runs):
        units, dt, ramp = _applied(packing, law, one.step, one.mass)
        end = one.times[-1] / units.rate
        protocol = protocols.steps([one.step / ramp, 0.0], [one.step, 1.05 * end], bulk="profile")

        def report(fraction: float, text: str, k: int = k) -> None:
            if progress is not None:
                done = float((cost[:k].sum() + fraction * cost[k]) / cost.sum())
                progress(done, f"γ = {runs[k].step:.3g}, t to {runs[k].times[-1]:.3g}")

        steps = begin(protocol, law, Q=units.Q, start=start, dt=dt, engine=engine, progress=report)
        relaxed = finish(steps)
        middle = (relaxed.time + np.append(0, relaxed.time[:-1])) / 2 - ramp / 2
        stress = np.interp(one.times / units.rate, middle, relaxed.stress)
        events = relaxed.rows["made"].sum() + relaxed.rows["broken"].sum()
        contacts = len(start) * relaxed.contacts[-1] / 2
        doubts = "; ".join(relaxed.warnings)
        doubts = doubts and f"step {one.step:.3g}, t to {one.times[-1]:.3g}: {doubts}"
        found.append(((stress - before) / one.step / units.stress, float(events / contacts), doubts))
    return found


def _options(parser: ArgumentParser) -> None:
    points = arguments.points
    text = "steps of the strain gamma: A:B:N or a list A,B,… (default 1e-6:1e-1:6)"
    kind, span = arguments.Within(points, STEP), "1e-6:1e-1:6"
    parser.add_argument("--step", dest="steps", type=kind, default=span, metavar="RANGE", help=text)
    text = "times after the step, in tau1: A:B:N or a list A,B,… (default 1:1e3:13)"
    kind, span = arguments.Within(points, TIMES), "1:1e3:13"
    parser.add_argument("--time", dest="times", type=kind, default=span, metavar="RANGE", help=text)
    text = "mass of every disk, in k tau1 t, t the earliest time of a decade, at most 0.1 k tau1^2 (default 5e-4)"
    parser.add_argument("--inertia", type=arguments.number, default=INERTIA, metavar="X", help=text)
    arguments.engine(parser)


VERB = Verb(step_strain, "stress after steps of strain, one group for each packing and law", _options, stressed=True)
