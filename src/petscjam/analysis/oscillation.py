"""A packing under γ = γ0 sin ωt at finite amplitudes: moduli, harmonics, contact changes, and return to the same state.

The disk engine (:mod:`petscjam.md`) shears it, or the minimiser at ω = 0, the quasi-static limit. The linear response
with the same masses is computed, too.

Axes: a amplitude, w frequency, h harmonic (3 and 5).
"""

from __future__ import annotations

from argparse import ArgumentParser
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.analysis.aqs import State, changes, states_at
from petscjam.base import arguments, ranges
from petscjam.base.errors import InputError, SolverError
from petscjam.base.progress import Progress, Report, reporting
from petscjam.base.types import Array, numbers
from petscjam.geometry.packing import Packing
from petscjam.md import protocols
from petscjam.md.model import Model
from petscjam.md.oscillations import harmonics, over_cycles
from petscjam.md.recording import Steps
from petscjam.md.result import Run
from petscjam.md.runs import begin, engine_of, finish
from petscjam.md.starts import along_x, given_state
from petscjam.parallel.comm import Comm, agree, on_root, resolve
from petscjam.response.moduli import complex_modulus
from petscjam.response.origin import Result, Verb, frequencies, stored
from petscjam.rows.damping import DampingLaw, law_or_default, with_law

AMPLITUDE = ranges.Range(1e-12, 10)
CYCLES = ranges.Range(3, 1e12, whole=True)
OMEGA = ranges.Range(0, ranges.OMEGA.high)
STATES = 128  # of a quasi-static cycle
COST = 2500.0  # of a quasi-static cycle, about that of the engine at ω = 1/COST; for the progress
LEAST = 400  # time steps of a cycle: they change a small-amplitude G* by 1e-4
DEPARTS = 0.1  # at γ†


@dataclass(frozen=True, eq=False)
class Oscillations(Result):
    """Response of one packing to γ = γ0 sin ωt. Units: stress k (BT) or ke/d² (VOT), time τ1.

    Attributes
    ----------
    amplitude : (A,)
        γ0, ascending.
    omega : (W,)
        Angular frequencies, 1/τ1, ascending; 0 is the quasi-static limit.
    mass : float
        Of every disk, kτ1².
    cycles : int
        Of each oscillation; a quarter of them, the transient, and the last are left out of the means.
    values : (A, W) complex
        G′ + iG″, the first harmonic of the stress over γ0. NaN at ω = 0, as the rest, if the packing unjams: a note
        says where.
    scatter : (A, W) complex
        Standard errors of G′ and G″ over the cycles.
    higher : (2, A, W) complex
        Harmonics 3 and 5 of the stress over γ0.
    linear : (W,) complex
        G*(ω) of the linear response with inertia, G0 at ω = 0. In the engine the contact point of a law that rolls is
        at ρi r/σ (VOT eq. 6), so G* differs from it by some overlaps, even at small amplitudes.
    heat : (A, W)
        Energy that is dissipated in the last cycle, over the area: πγ0²G″ if the cycle is periodic. At ω = 0 ∮σdγ.
    contact_events : (A, W)
        Contacts made and broken in the last cycle, over the number of contacts. At ω = 0 between 128 states a cycle.
    returns : (A, W)
        Root mean square displacement of the disks in the last cycle over γ0 d: 0 if the motion is periodic. At ω = 0
        without rattlers.
    """

    amplitude: Array = field(metadata=stored("1", "A", finite=True))
    omega: Array = field(metadata=stored("1/tau1", "W", finite=True))
    mass: float = field(metadata=stored("stress*tau1**2", finite=True))
    cycles: int = field(metadata=stored("1"))
    values: NDArray[np.complex128] = field(metadata=stored("stress", "A W"))
    scatter: NDArray[np.complex128] = field(metadata=stored("stress", "A W"))
    higher: NDArray[np.complex128] = field(metadata=stored("stress", "2 A W", parts=("third", "fifth")))
    linear: NDArray[np.complex128] = field(metadata=stored("stress", "W"))
    heat: Array = field(metadata=stored("stress", "A W"))
    contact_events: Array = field(metadata=stored("1", "A W"))
    returns: Array = field(metadata=stored("1", "A W"))
    settings: ClassVar[tuple[str, ...]] = ("damping",)
    lines: ClassVar[str] = "A W"
    units: ClassVar[str] = "moduli in k; smallest omega, in 1/tau1; linear: of the linear response with inertia"
    figure: ClassVar[str] = "petscjam.plots.oscillation:oscillation_figure"

    @property
    def departure(self) -> Array:
        """|G*/G*(smallest γ0) − 1|, (A, W)."""
        return np.asarray(np.abs(self.values / self.values[0] - 1))

    @property
    def onset(self) -> Array:
        """γ†, (W,): the amplitude from which on G* departs by a tenth from that at the smallest amplitude.

        Interpolated in the logarithms of both; NaN if it does not depart, or does already at the second amplitude.
        """
        found = np.full(len(self.omega), np.nan)
        x, y = np.log(self.amplitude), np.log(np.maximum(self.departure, 1e-300) / DEPARTS)
        for w, column in enumerate(y.T):
            within = np.flatnonzero(column <= 0).max(initial=0)
            if 0 < within < len(x) - 1:
                a, b = column[within : within + 2]
                found[w] = np.exp(x[within] - a / (b - a) * (x[within + 1] - x[within]))
        return found

    def row(self) -> dict[str, float | str]:
        """Return its line of the table: the lowest frequency, smallest and largest amplitude."""
        return {
            "law": str(self.damping),
            "mass": self.mass,
            "omega": self.omega[0],
            "G' linear": self.linear[0].real,
            f"G' at {self.amplitude[0]:.3g}": self.values[0, 0].real,
            f"G' at {self.amplitude[-1]:.3g}": self.values[-1, 0].real,
            "onset": self.onset[0],
        }


class Units(NamedTuple):
    """Of the engine, in which lengths are in smallest diameters, and of the response.

    With a potential of relative overlaps, stresses depend on the unit of length.

    Attributes
    ----------
    Q : float
        Elasticity of collisions, VOT eq. 9: the damping of the engine for the mass of the response.
    stress : float
        Stress of the engine over that of the response.
    rate : float
        Frequency of the engine, 1/τe, over that of the response, 1/τ1.
    """

    Q: float
    stress: float
    rate: float

    @classmethod
    def of(cls, packing: Packing, mass: float) -> Units:
        """Return the units: in the engine the mass is 1, and kd is kτ1.

        Parameters
        ----------
        packing : Packing
        mass : float
            Of every disk, kτ1².
        """
        stress = float((2 * packing.radii.min()) ** 2) if packing.potential.relative else 1.0
        Q = float(np.sqrt(mass / stress))
        return cls(Q, stress, stress * Q)


@reporting
@with_law
def oscillate(
    packing: Packing,
    amplitudes: ArrayLike,
    omegas: ArrayLike,
    *,
    mass: float = 1.0,
    cycles: int = 8,
    engine: str = "cpu",
    damping: DampingLaw | str | None = None,
    prestress: bool = True,
    comm: Comm | None = None,
    name: str = "packing",
    progress: Progress | None = None,
) -> Oscillations:
    """Shear a packing as γ0 sin ωt at every amplitude and frequency, from rest.

    Parameters
    ----------
    packing : Packing
        Any cell; it is turned if no edge is along x. One that is not a proved minimum is allowed: the notes say so.
    amplitudes : (A,) array_like
        γ0.
    omegas : (W,) array_like
        Angular frequencies, 1/τ1. A cycle takes some 150/ω time steps for a mass of 1, more for small masses. 0: the
        quasi-static limit, 128 minima of the energy a cycle.
    mass : float
        Of every disk, in kτ1²; moment of inertia mass ρ²/2.
    cycles : int
        At least 3.
    engine : str
        A name of :data:`petscjam.md.runs.ENGINES`; ``cuda`` makes all oscillations at once.
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
    agree(comm, packing, amplitudes, omegas, mass, cycles, engine, damping, prestress)
    law, omega = law_or_default(damping), np.unique(numbers("omega", omegas))
    slow = omega == 0
    frequencies(omega[~slow], empty=bool(slow.any()))
    gamma = np.unique(numbers("amplitude", amplitudes))
    if not len(gamma):
        raise InputError("amplitude: there is none")
    for value in gamma:
        AMPLITUDE.check("amplitude: amplitudes", float(value))
    ranges.INERTIA.check("mass", mass)
    CYCLES.check("cycles", cycles)
    if not prestress:
        raise InputError("oscillate: the disks exert their contact forces, so pre-stress cannot be left out")
    turned, notes = sheared(packing)
    some = omega[~slow] if not slow.all() else [1.0]  # G0 comes with any frequency
    response = complex_modulus(turned, some, damping=law, mass=mass, comm=comm, name=name)
    linear = np.full(len(omega), response.G0, dtype=complex)
    linear[~slow] = response.values[: np.count_nonzero(~slow)]
    tasks = [Task(float(a), float(w)) for a in gamma for w in omega]
    found, doubts = on_root(comm, _measured, tasks, turned, law, mass, cycles, engine, progress)
    values = {
        key: np.array(column).reshape(len(gamma), len(omega))
        for key, column in zip(Measure._fields, zip(*found, strict=True), strict=True)
    }
    higher = np.stack([values.pop("third"), values.pop("fifth")])
    return Oscillations(
        amplitude=gamma,
        omega=omega,
        mass=float(mass),
        cycles=int(cycles),
        linear=linear,
        higher=higher,
        origin=replace(response.origin, checksum=packing.checksum),
        notes=(*response.notes, *notes, *doubts),
        **values,
    )


def sheared(packing: Packing) -> tuple[Packing, tuple[str, ...]]:
    """Return a packing as the engine shears it, with an edge of its cell along x, and a note if it had to be turned."""
    turned, angle = along_x(packing)
    note = f"the packing is turned by {np.degrees(-angle):.6g} degrees: an edge of its cell must be along x"
    return turned, (note,) if angle else ()


class Task(NamedTuple):
    """An oscillation: γ0, and ω in 1/τ1."""

    amplitude: float
    omega: float


class Measure(NamedTuple):
    """Numbers of an oscillation, as in :class:`Oscillations`."""

    values: complex
    scatter: complex
    third: complex
    fifth: complex
    heat: float
    contact_events: float
    returns: float


def _measured(
    tasks: list[Task], packing: Packing, law: DampingLaw, mass: float, cycles: int, engine: str, progress: Report | None
) -> tuple[list[Measure], list[str]]:
    """Make the oscillations, on this rank; return their numbers, and the reasons to doubt them."""
    units, (start, _) = Units.of(packing, mass), given_state(packing)
    assert start is not None
    parts: dict[Task, float] = dict.fromkeys(tasks, 0.0)
    before: dict[Task, Run] = {}
    found: dict[Task, Measure] = {}
    doubts: dict[Task, str] = {}

    def report(task: Task, first: float, share: float, fraction: float, text: str) -> None:
        parts[task] = first + share * fraction
        if progress is not None:
            cost = np.array([1 / t.omega if t.omega else COST for t in tasks])
            progress(
                float(cost @ list(parts.values()) / cost.sum()), f"γ0 = {task.amplitude:.3g}, ω = {task.omega:.3g}"
            )

    def steps(task: Task) -> Steps:
        """All cycles but the last from the packing, then the last."""
        omega = units.rate * task.omega
        longest = Model.of(law, units.Q, potential=packing.potential).step(None, "heun")
        period = 2 * np.pi / omega
        dt = period / max(int(np.ceil(period / longest)), LEAST)
        make: Any = partial(begin, model=law, Q=units.Q, engine=engine, dt=dt)
        share = 1 - 1 / cycles
        before[task] = yield from make(
            protocols.oscillation(task.amplitude, omega, cycles - 1),
            start=start,
            progress=partial(report, task, 0.0, share),
        )
        return (
            yield from make(
                protocols.oscillation(task.amplitude, omega, 1),
                start=before[task].state,
                progress=partial(report, task, share, 1 - share),
            )
        )

    def done(task: Task, last: Run) -> None:
        earlier = before.pop(task)
        found[task] = _measure(earlier, last, units)
        if reasons := dict.fromkeys([*earlier.warnings, *last.warnings]):
            doubts[task] = f"amplitude {task.amplitude:.3g}, omega {task.omega:.3g}: {'; '.join(reasons)}"

    moving = [task for task in tasks if task.omega]
    for task in tasks:
        if not task.omega:
            try:
                found[task] = _quasistatic(packing, task.amplitude, cycles, partial(report, task, 0.0, 1.0))
            except (InputError, SolverError) as cause:
                found[task] = Measure(np.nan, np.nan, np.nan, np.nan, np.nan, np.nan, np.nan)
                doubts[task] = f"amplitude {task.amplitude:.3g}, omega 0: {cause}"
    abreast = getattr(engine_of(engine), "abreast", None)
    if abreast is None:
        for task in moving:
            done(task, finish(steps(task)))
    else:
        for task, error in abreast(moving, steps, done):
            raise SolverError(f"amplitude {task.amplitude:g}, omega {task.omega:g}: {error}") from None
    return [found[task] for task in tasks], [doubts[task] for task in tasks if task in doubts]


def _measure(before: Run, last: Run, units: Units) -> Measure:
    """Return the numbers of an oscillation, from all its cycles but the last, and from the last."""
    fit, state = harmonics(before), last.state
    first, third, fifth = fit.moduli / units.stress
    apart = state.box.minimum_image(state.positions - before.state.positions)
    path = fit.amplitude * 2 * state.radii.mean()
    events = last.rows["made"].sum() + last.rows["broken"].sum()
    contacts = len(state) * last.contacts.mean() / 2
    return Measure(
        first,
        fit.errors[0] / units.stress,
        third,
        fifth,
        float(last.rows["heat"].sum() / state.area / units.stress),
        float(events / contacts),
        float(np.sqrt((apart**2).sum(1).mean()) / path),
    )


def _quasistatic(packing: Packing, amplitude: float, cycles: int, report: Report) -> Measure:
    """Return the numbers of an oscillation at ω = 0, from minima of the energy at γ0 sin θ."""
    theta = 2 * np.pi / STATES * np.arange(1, STATES * cycles + 1)
    gamma = amplitude * np.sin(theta)
    stress, events = np.zeros(len(theta) + 1), 0
    before = now = State(packing, 0.0, 1.0)
    for k, state in enumerate(states_at(packing, gamma)):
        stress[k] = -state.network.stress[0, 1]
        if k > STATES * (cycles - 1):
            events += sum(abs(n) for n in changes(now, state).values())
        elif k == STATES * (cycles - 1):
            before = state
        now = state
        report(k / len(theta), "")
    wave = 2j / (STATES * amplitude) * np.exp(-1j * np.outer(theta[:STATES], (1, 3, 5)))
    moduli = stress[1:].reshape(cycles, STATES)[max((cycles - 1) // 4, 1) : -1] @ wave
    loop, path = stress[-STATES - 1 :], np.append(0, gamma[-STATES:])
    apart = packing.box.minimum_image(now.packing.positions - before.packing.positions)[before.network.backbone]
    return Measure(
        complex(moduli[:, 0].mean()),
        complex(over_cycles(moduli[:, 0].real), over_cycles(moduli[:, 0].imag)),
        complex(moduli[:, 1].mean()),
        complex(moduli[:, 2].mean()),
        float(((loop[1:] + loop[:-1]) / 2 * np.diff(path)).sum()),
        events / len(before.network),
        float(np.sqrt((apart**2).sum(1).mean()) / (amplitude * packing.mean_diameter)),
    )


def _options(parser: ArgumentParser) -> None:
    text = "amplitudes gamma0: A:B:N or a list A,B,… (default 1e-5:1e-1:5)"
    parser.add_argument(
        "--amplitude",
        dest="amplitudes",
        type=arguments.Within(arguments.points, AMPLITUDE),
        default="1e-5:1e-1:5",
        metavar="RANGE",
        help=text,
    )
    text = "angular frequencies in 1/tau1: A:B:N or a list A,B,…; 0: the quasi-static limit (default 1e-2:1:3)"
    parser.add_argument(
        "--omega",
        dest="omegas",
        type=arguments.Within(arguments.numbers, OMEGA),
        default="1e-2:1:3",
        metavar="RANGE",
        help=text,
    )
    text = "of every disk, in k tau1^2 (default 1); small masses take more time steps"
    kind = arguments.Within(arguments.number, ranges.INERTIA)
    parser.add_argument("--mass", type=kind, default=1.0, metavar="M", help=text)
    text = "cycles of each oscillation; a quarter of them and the last are left out of the means (default 8)"
    parser.add_argument("--cycles", type=arguments.Within(arguments.integer, CYCLES), default=8, metavar="K", help=text)
    arguments.engine(parser)


VERB = Verb(oscillate, "G* at finite amplitudes, one group for each packing and law", _options, stressed=True)
