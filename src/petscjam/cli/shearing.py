"""The verbs of sheared disks."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from petscjam.base.errors import InputError, SolverError
from petscjam.cli.laws import chosen_laws, law_options
from petscjam.cli.verbs import say
from petscjam.parallel.comm import Comm, on_root

if TYPE_CHECKING:
    from petscjam.md.grid import Point
    from petscjam.md.protocols import Protocol
    from petscjam.md.recording import Steps


def shear(options: argparse.Namespace, comm: Comm) -> None:
    """Shear disks at a constant rate, in steps of the rate, or in oscillation; one run, or a grid of runs.

    Parameters
    ----------
    options : argparse.Namespace
    comm : Comm
    """
    from petscjam.md import protocols

    if options.oscillate and (options.then or options.rate or options.strain or options.bulk):
        raise InputError("shear: --oscillate goes without --rate, --strain, --then and --bulk")
    if options.bulk and not (options.then or options.start):
        raise InputError("shear: --bulk goes with --then or --start: else the strain rate does not change")
    bulk = options.bulk or "scale"

    def protocol(rate: float) -> protocols.Protocol:
        if options.oscillate:
            return protocols.oscillation(*options.oscillate)
        strain = 10.0 if options.strain is None else options.strain
        if options.then:
            rates, strains = zip(*options.then, strict=True)
            return protocols.steps([rate, *rates], [strain, *strains], bulk)
        return protocols.steady(rate, strain, bulk)

    _work(options, comm, protocol, [0.0] if options.oscillate else options.rate or [1e-4])


def ramp(options: argparse.Namespace, comm: Comm) -> None:
    """Increase the strain rate and decrease it again; one run, or a grid of runs.

    Parameters
    ----------
    options : argparse.Namespace
    comm : Comm
    """
    from petscjam.md import protocols

    def protocol(rate: float) -> protocols.Protocol:
        return protocols.ramp(rate, options.to, options.kappa)

    _work(options, comm, protocol, options.rate or [1e-6])


def _work(options: argparse.Namespace, comm: Comm, protocol: Callable[[float], Protocol], rates: list[float]) -> None:
    from petscjam.base.progress import progress
    from petscjam.md.grid import run_grid
    from petscjam.md.runs import begin, engine_of, finish
    from petscjam.plots.tables import describe_run

    names = "rescale start_bands integrator dt threads exponent stokes_drag rotational_drag mass angles row_time frames"
    names += " drag_exponent drag_speed drag_cutoff"
    kind: Any = engine_of(options.engine)
    common = {name: getattr(options, name) for name in [*names.split(), "engine"]}
    alone = options.start[0] if len(options.start) == 1 else None

    def steps(rate: float, start: Any, **settings: Any) -> Steps:
        start = start or alone
        if start is not None and start.is_dir():
            from petscjam.io.lammps_shear import read_lammps

            start = read_lammps(start)
        return (yield from begin(protocol(rate), start=start, **common, **settings))

    def log(file: Path, done: Any) -> None:
        print(file, flush=True)
        for text in done.warnings:
            print(f"petscjam: warning: {file}: {text}", file=sys.stderr, flush=True)

    points = _points(options, rates)
    existing = {"resume": options.resume, "overwrite": options.overwrite}
    if len(points) == 1 and not options.output.is_dir():

        def one() -> str:
            with progress(options.verb, show=True) as report:
                done = finish(steps(**vars(points[0]), output=options.output, progress=report, **existing))
            log(options.output, done)
            return describe_run(done)

        say(comm, on_root(comm, one))
        return
    if alone is not None and (options.particles is None or options.phi is None):
        raise InputError(f"{options.verb}: many runs from one --start need --particles and --phi, too")
    large = sum((point.n or 0) > getattr(kind, "MOST", math.inf) for point in points)
    if large and comm.rank == 0:
        text = f"{large} of {len(points)} runs have more than {kind.MOST} disks: they follow each other on the GPU"
        print(f"petscjam: {text}", file=sys.stderr, flush=True)
    with progress(options.verb, show=comm.rank == 0) as report:
        settings = {"engine": options.engine, "progress": report, "log": log, **existing}
        made, failures = run_grid(points, options.output, steps, comm=comm, **settings)
    say(comm, f"{made} of {len(points)} runs: {options.output}")
    if failures:
        raise SolverError("".join(["some runs failed; --resume tries them again:", *(f"\n  {x}" for x in failures)]))


def _points(options: argparse.Namespace, rates: list[float]) -> list[Point]:
    """Return the runs of the options."""
    from petscjam.md.grid import grid

    if options.model and law_options(options):
        raise InputError(f"{options.verb}: {law_options(options)[0]} takes the place of --model")
    models = options.model or (chosen_laws(options) if law_options(options) else ["CD_rot"])
    start = bool(options.start)
    if start and (options.seeds or options.seed is not None):
        raise InputError(f"{options.verb}: --seed and --seeds go without --start: nothing would be random")
    sizes = options.particles or [None if start else 1024]
    phis = options.phi or [None if start else 0.82]
    seeds = options.seeds or [1 if options.seed is None else options.seed]
    starts = options.start if len(options.start) > 1 else [None]
    return grid(models, sizes, phis, options.Q, rates, seeds, starts)
