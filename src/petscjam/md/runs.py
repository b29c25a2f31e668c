"""Shear disks at a constant rate, in a ramp of the strain rate, or by any protocol."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import wraps
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec

import numpy as np

from petscjam.base import ranges
from petscjam.base.compiled import build, use_threads
from petscjam.base.errors import DoubtfulWarning, InputError
from petscjam.base.files import check_output, marked, naming, open_h5
from petscjam.base.interrupt import deferred
from petscjam.base.progress import Report, reporting
from petscjam.base.ranges import MOST_ROWS, MOST_STEPS
from petscjam.base.versions import release
from petscjam.geometry.potential import POTENTIALS, power_law
from petscjam.md import protocols
from petscjam.md.engine import Engine
from petscjam.md.frames import frames_of, remove_frames
from petscjam.md.model import Model
from petscjam.md.protocols import Protocol
from petscjam.md.recording import Recorder, Steps, read_checkpoint
from petscjam.md.result import Run, read_run
from petscjam.md.settings import Settings
from petscjam.md.simulation import Simulation
from petscjam.md.starts import Phases, Start, first_state, given_state, rescaled, two_phases
from petscjam.parallel.claims import claimed, made_folder
from petscjam.parallel.memory import require
from petscjam.rows.damping import DampingLaw, with_law

# An engine with dependencies of its own is a name, and imported when it is asked for.
ENGINES: dict[str, type[Engine] | str] = {"cpu": Simulation, "cuda": "petscjam.md.cuda.CudaSimulation"}
ROW_COUNT, LEAST = 1000, 50  # rows of a run, and smallest number of steps of a row
CUTOFF = 0.01  # ε of nonlinear drag, in d|γ̇|
PER_PERIOD = 32  # rows of a period, at least
BUILD = ("version", "numba", "processor")  # settings that change only the last bits
OWN = ("threads", "cycles", *BUILD)  # settings that a resumed run may change
BYTES_PER_STEP = 16  # in a row: strains and rates of a fifth of its steps, and temporary arrays
BYTES_PER_ROW = 4000  # numbers of a row, its share of a block, and copies during writing


@reporting
@with_law
def shear(
    model: str | DampingLaw = "CD_rot",
    n: int | None = None,
    phi: float | None = None,
    Q: float = 1.0,
    rate: float = 1e-4,
    strain: float = 10.0,
    seed: int = 1,
    dt: float | None = None,
    start: Start = None,
    output: str | PathLike[str] | None = None,
    **options: Any,
) -> Run:
    """Shear disks at a constant rate (VOT sec. II).

    Parameters
    ----------
    model : str or DampingLaw
        ``CD``, ``CD_rot``, ``CD_n``, or a law of the linear response, as ``ContactDamping(beta=0.3)``.
    n : int
        Number of disks, even, half of diameter 1, half of 1.4; default: 1024 or that of ``start``.
    phi : float
        Packing fraction; default: 0.82 or that of ``start``.
    Q : float
        Elasticity of collisions, above 0 (VOT eq. 9).
    rate : float
        γ̇ in 1/τe.
    strain : float
        Amount of strain.
    seed : int
        Of the random start.
    dt : float
        Time step in τe; default: 0.05, or less for strong damping, with an error of the energy budget below 1 %
        of the heat. Steps are divided if the contacts require it for stability.
    start : State, Run, Packing or path
        Initial state; default: random positions, moved apart, with the linear profile. Velocities and spins of a
        run are scaled to the new rate (VOT eqs. 40, 41). The start is recorded, because flows depend on their
        history. The potential is that of the start. A packing may have any cell; if its first lattice vector is not
        along x, it is rotated until one of its two shortest lattice vectors is, the one with the smaller rotation.
    output : path
        File of the run (HDF5), complete at every moment.
    **options
        As for :func:`run`: rescale, start_bands, integrator, threads, exponent, stokes_drag, rotational_drag,
        mass, drag_exponent, drag_speed, drag_cutoff, angles, row_time, resume, overwrite, progress, frames.

    Returns
    -------
    Run
        ``warnings`` has the reasons why its numbers may be inaccurate; they are also Python warnings.

    Raises
    ------
    InputError
        If a number is out of its range, or the output cannot be written or resumed.
    SolverError
        If velocities diverge.
    """
    return run(
        protocols.steady(rate, strain), model, n, phi, Q, seed=seed, dt=dt, start=start, output=output, **options
    )


@reporting
@with_law
def ramp(
    model: str | DampingLaw = "CD_rot",
    n: int | None = None,
    phi: float | None = None,
    Q: float = 1.0,
    rate: float = 1e-6,
    to: float = 1e-3,
    kappa: float = 1e-5,
    seed: int = 1,
    dt: float | None = None,
    start: Start = None,
    output: str | PathLike[str] | None = None,
    **options: Any,
) -> Run:
    """Increase the strain rate by 10^κ̃ every τe, and decrease it again (VOT sec. III D).

    Each row averages over 10³ τe.

    Parameters
    ----------
    rate, to : float
        First and highest rate, 1/τe.
    kappa : float
        κ̃.
    model, n, phi, Q, seed, dt, start, output, **options
        As in :func:`shear`.
    """
    protocol = protocols.ramp(rate, to, kappa)
    return run(protocol, model, n, phi, Q, seed=seed, dt=dt, start=start, output=output, **options)


def begin(
    protocol: Protocol,
    model: str | DampingLaw,
    n: int | None = None,
    phi: float | None = None,
    Q: float = 1.0,
    *,
    seed: int = 1,
    dt: float | None = None,
    start: Start = None,
    rescale: bool = False,
    start_bands: Phases | None = None,
    output: str | PathLike[str] | None = None,
    integrator: str = "heun",
    threads: int = 1,
    exponent: float | None = None,
    stokes_drag: float = 0.0,
    rotational_drag: float = 0.0,
    mass: float = 1.0,
    drag_exponent: float = 1.0,
    drag_speed: float | None = None,
    drag_cutoff: float | None = None,
    angles: bool = False,
    row_time: float | None = None,
    resume: bool = False,
    overwrite: bool = False,
    frames: int = 0,
    progress: Report | None = None,
    engine: str = "cpu",
) -> Steps:
    """Shear disks by any protocol; parameters that are not listed are those of :func:`shear`.

    ``run`` makes all steps; ``begin`` is a generator of them (:meth:`petscjam.md.recording.Recorder.fill`).

    Parameters
    ----------
    protocol : Protocol
        As ``steady(1e-4, 10)`` of :mod:`petscjam.md.protocols`.
    rescale : bool
        Change the cell and the positions of ``start`` to the packing fraction ``phi``; radii and peculiar velocities
        stay.
    start_bands : ((float, float), (float, float))
        (φ, γ̇) of a Bagnoldian and of a Newtonian band, into which the start is divided
        (:func:`petscjam.md.starts.two_phases`).
    integrator : str
        ``heun`` (VOT eqs. 21–24) or ``single`` (one evaluation of the forces in each step, smaller largest dt).
    threads : int
        Useful from ten thousand disks on; results do not depend on them.
    exponent : float
        α of the repulsion (VOT eq. 1); default: that of ``start``, or 2.
    stokes_drag, rotational_drag : float
        Stokes drag on disks and on their rotation, in m/τe and m ds²/τe.
    mass : float
        Of every disk, in m. Q stays m/(kd τe) with the unit m of mass, so mass does not change kd = 1/Q.
    drag_exponent : float
        α ∈ (0, 1] of nonlinear drag of contacts: the friction is multiplied by [(v² + ε²)/w²]^((α − 1)/2) (BT eq. 9).
    drag_speed, drag_cutoff : float
        w and ε of nonlinear drag, in ds/τe; default: w = dQ, BT's ρ0/τ1 with the mean diameter d, and ε = 0.01 d|γ̇|
        with the first (of an oscillation, largest) strain rate. A smaller ε needs smaller time steps.
    angles : bool
        Keep the angles by which the disks have turned, in radians: in the state, the file and the frames.
    row_time : float
        τe between two rows of the time series, at least 50 steps; default: a thousandth of the run, at most a 32nd
        of a period, or 10³ τe in a ramp.
    resume : bool
        Continue from the end of ``output``, bit for bit as without the stop. A longer run continues from its end.
        The default ``dt`` and ``row_time`` are those of ``output``.
    overwrite : bool
        Replace ``output``.
    frames : int
        Number of snapshots, evenly spaced in time, in the folder OUTPUT.frames
        (:func:`petscjam.md.frames.write_frame`).
    progress : callable
        See :mod:`petscjam.base.progress`.
    engine : str
        A name of :data:`ENGINES`.
    """
    kind = engine_of(engine)
    use_threads(threads)
    ranges.SEED.check("shear: the seed", seed)
    ranges.FRAMES.check("shear: the number of frames", frames)
    if frames and output is None:
        raise InputError("shear: frames are written next to the output: give one")
    with _claimed(output, start, overwrite=overwrite or resume, frames=frames > 0):
        earlier = _earlier(output, kind) if output is not None and resume and Path(output).exists() else None
        there = None if earlier is None else earlier.run.settings
        given, origin = given_state(start)
        if rescale:
            if given is None or phi is None:
                raise InputError("shear: rescale goes with start and phi")
            given, origin = rescaled(given, phi), f"{origin}, rescaled from φ = {given.phi:.8g}"
        if start_bands is not None:
            origin += "; bands of " + ", ".join(f"φ = {x:g} at γ̇ = {y:g}" for x, y in start_bands)
            if protocol.bulk == "boundary":
                raise InputError("shear: with bulk = boundary the start is not changed: give no bands")
        first = given if earlier is None else earlier.run.state
        potential = POTENTIALS["harmonic-relative"] if first is None else first.potential
        if exponent is not None:
            potential = power_law(exponent, potential.relative)
        drags = {"stokes_drag": stokes_drag, "rotational_drag": rotational_drag}
        if drag_exponent != 1:
            d = 1.2 if first is None else 2 * float(first.radii.mean())
            slow = CUTOFF * d * abs(protocol.settings["rate"])
            drags |= {"drag_exponent": drag_exponent, "drag_speed": d * Q if drag_speed is None else drag_speed}
            drags |= {"drag_cutoff": slow if drag_cutoff is None else drag_cutoff}
        elif drag_speed is not None or drag_cutoff is not None:
            raise InputError("shear: drag_speed and drag_cutoff go with a drag_exponent below 1")
        law = Model.of(model, Q, potential=potential, mass=mass, **drags)
        dt = law.step(dt, integrator) if dt is not None or there is None else there.dt
        total, row_steps = _lengths(protocol, dt, row_time, None if there is None else there.row_steps)
        made: dict[str, Any] = {"dt": dt, "integrator": integrator, "row_steps": row_steps, "threads": threads}
        made |= {"angles": angles, "protocol": protocol.name, "history": protocol.settings, "bulk": protocol.bulk}
        made |= {"version": release("petscjam"), **build()}
        if earlier is not None:
            asked = {"particles": n, "phi": phi} | ({"seed": seed} if given is None else {"start": origin})
            asked |= {} if start_bands is None else {"start": origin}
            earlier.check(replace(earlier.run.settings, model=law, **made).attributes | asked)
            with naming(earlier.file):
                disks = kind.restored(earlier.saved, law, dt, integrator, threads)
                latest = {name: made[name] for name in (*BUILD, *["history"] * (total > disks.steps))}
                recorder = Recorder(replace(earlier.run.settings, **latest), disks, earlier.run, earlier.saved)
        else:
            first = first_state(given, origin, n, phi, seed, law, protocol)
            turned = np.zeros(len(first)) if first.angles is None else first.angles
            first = replace(first, angles=turned if angles else None)
            first = first if start_bands is None else two_phases(first, start_bands)
            made |= {"start": origin, "strain0": first.strain, "time0": first.time}
            made |= {"particles": len(first), "phi": first.phi, "seed": seed if given is None else None}
            disks = kind(first, law, dt, integrator, threads)
            recorder = Recorder(Settings(law, **made), disks)
            if output is not None:
                remove_frames(output, overwrite=overwrite)
        return (yield from recorder.fill(disks, protocol, total, output, frames, progress))


P = ParamSpec("P")


def _whole(begin: Callable[P, Steps]) -> Callable[P, Run]:
    """Return the function that makes all steps of a run."""

    @deferred()
    def run(*arguments: P.args, **options: P.kwargs) -> Run:
        done = finish(begin(*arguments, **options))
        for text in done.warnings:
            warnings.warn(text, DoubtfulWarning, stacklevel=4)
        return done

    return wraps(begin, assigned=("__module__", "__doc__", "__annotations__"))(run)


def finish(steps: Steps) -> Run:
    """Make all steps of a run, and return it.

    Parameters
    ----------
    steps : generator
        Of :func:`begin`.
    """
    while True:
        try:
            next(steps)
        except StopIteration as done:
            return done.value


run = reporting(with_law(_whole(begin)))


def engine_of(name: str) -> type[Engine]:
    """Return the engine called ``name``.

    Raises
    ------
    InputError
        If there is none, or it cannot be used on this machine.
    """
    if name not in ENGINES:
        raise InputError(f"shear: no engine {name!r}; there are {', '.join(ENGINES)}")
    kind = ENGINES[name]
    if isinstance(kind, str):
        module, _, name = kind.rpartition(".")
        kind = getattr(import_module(module), name)
    return kind


@contextmanager
def _claimed(output: str | PathLike[str] | None, start: Start, *, overwrite: bool, frames: bool) -> Iterator[None]:
    """Check the output, and claim it and its frames."""
    with ExitStack() as held:
        if output is not None:
            held.enter_context(claimed(output))
            inputs = [start] if isinstance(start, str | PathLike) else []
            check_output(output, overwrite=overwrite, inputs=inputs)
            if frames:
                held.enter_context(made_folder(frames_of(output)))
                held.enter_context(claimed(frames_of(output)))
        yield


def _lengths(protocol: Protocol, dt: float, row_time: float | None, earlier: int | None) -> tuple[int, int]:
    """Return the steps of the run and of a row, those of an ``earlier`` part unless ``row_time`` is given.

    Raises
    ------
    InputError
        If there are too many steps or rows, or they need more memory than is free.
    """
    if row_time is not None:
        ranges.ROW_TIME.check("shear: row_time", row_time)
    steps = protocol.duration / dt
    if not steps <= MOST_STEPS:
        raise InputError(f"shear: the run takes {steps:.3g} steps of {dt:.3g} tau_e; at most {MOST_STEPS:.0g}")
    total = max(round(steps), 1)
    between = protocol.row_time if row_time is None and earlier is None else row_time
    if between is not None:
        row_steps = max(LEAST, round(between / dt))
    else:
        row_steps = earlier or max(LEAST, -(-total // ROW_COUNT))
        if protocol.period is not None and earlier is None:
            row_steps = min(row_steps, max(1, int(protocol.period / dt / PER_PERIOD), -(-total // MOST_ROWS)))
    rows = -(-total // row_steps)
    if row_steps > MOST_STEPS:
        raise InputError(f"shear: row_time = {between:g} is {row_steps:.3g} steps; at most {MOST_STEPS:.0g}")
    if rows > MOST_ROWS:
        raise InputError(f"shear: the run has {rows} rows, at most {MOST_ROWS:.0g}; take a longer row_time")
    require(min(row_steps, total) * BYTES_PER_STEP + rows * BYTES_PER_ROW, f"shear: {rows} rows")
    return total, row_steps


class _Earlier(NamedTuple):
    """A run to continue, and its checkpoint."""

    file: str | PathLike[str]
    run: Run
    saved: dict[str, Any]

    def check(self, asked: Mapping[str, Any]) -> None:
        """Refuse other settings (None is equal to any); warn about another build."""
        settings = self.run.settings.attributes
        for name, value in asked.items():
            there: Any = settings.get(name)
            if name == "strains":  # the last may be longer
                there, value = there[:-1], value[:-1]
            if value is None or name in OWN or (name == "seed" and there is None):
                continue
            if not (np.allclose(there, value, rtol=1e-9) if name == "phi" else np.array_equal(there, value)):
                raise InputError(f"{self.file}: was made with {name} = {there}, not {value}; it cannot be resumed")
        changed = [
            f"{name} {settings[name]}, now {asked[name]}"
            for name in BUILD
            if settings.get(name) not in (None, asked[name])
        ]
        if changed:
            warnings.warn(f"{self.file}: was made with {'; '.join(changed)}: the last bits may differ", stacklevel=4)


def _earlier(output: str | PathLike[str], engine: type[Engine]) -> _Earlier:
    """Return the run of a file."""
    with open_h5(output) as h5:
        if marked(h5)[1] == 1:
            raise InputError("was made by an older petscjam; it cannot be resumed, but it can be a start")
        run = read_run(h5)
        shapes = {name: axes for name, axes in engine.CHECKPOINT.items() if name != "angles" or run.settings.angles}
        return _Earlier(output, run, read_checkpoint(h5, shapes))
