"""The verbs that analyse packings, and figures; each result is written when it is finished."""

from __future__ import annotations

import argparse
import resource
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from petscjam.base.errors import InputError, SolverError
from petscjam.base.files import naming
from petscjam.cli.laws import chosen_laws, law_options
from petscjam.cli.verbs import in_short, say
from petscjam.parallel.comm import Comm, on_root
from petscjam.rows.damping import DampingLaw

if TYPE_CHECKING:
    from petscjam.io.jobs import Analysis


def analyse(options: argparse.Namespace, comm: Comm) -> None:
    """Run the analysis that a verb declares, for all packings.

    Parameters
    ----------
    options : argparse.Namespace
    comm : Comm
    """
    result, verb = options.declared
    function = resolve_name(options.analyse) if isinstance(options.analyse, str) else options.analyse
    settings = {name: getattr(options, name) for name in options.settings}
    if "damping" in result.settings or (verb.laws and options.analyse != verb.analyse):
        _analyse(options, comm, function, settings, chosen_laws(options))
    elif verb.laws and law_options(options):
        raise InputError(f"{options.verb}: {law_options(options)[0]} goes with {verb.laws}")
    else:
        _analyse(options, comm, function, settings)


def figure(options: argparse.Namespace, comm: Comm) -> None:
    """Make a figure of a paper: packings, results, picture and page.

    Parameters
    ----------
    options : argparse.Namespace
    comm : Comm
    """
    from petscjam.base.progress import progress
    from petscjam.figures import Request, make_figure
    from petscjam.parallel.petsc import start
    from petscjam.plots.figure import house_style

    start(comm)
    folder = options.output or Path("runs") / options.preset

    def log(line: str) -> None:
        print(line, flush=True)

    with progress(f"figure {options.name}", show=comm.rank == 0) as report, house_style(options.style, options.dpi):
        request = Request(
            options.name,
            options.preset,
            folder,
            options.parameters,
            overwrite=options.overwrite,
            resume=options.resume,
            existing=options.existing,
            engine=options.engine,
        )
        make_figure(request, comm=comm, progress=report, log=log)
    say(comm, on_root(comm, (folder / f"{options.name}.md").read_text))
    say(comm, f"{folder / options.name}.png")


def _analyse(
    options: argparse.Namespace,
    comm: Comm,
    function: Callable[..., Any],
    settings: Mapping[str, Any],
    laws: Sequence[DampingLaw | None] = (None,),
) -> None:
    from petscjam.io.jobs import PackingAnalysis
    from petscjam.parallel.petsc import start

    start(comm)
    _finish(_analysed(options, comm, PackingAnalysis(function, settings), laws), "results")


def moduli(options: argparse.Namespace, comm: Comm) -> None:
    """Compute G* of all packings, distributed over teams of ranks; each result is written when it is finished.

    Parameters
    ----------
    options : argparse.Namespace
    comm : Comm
    """
    import numpy as np

    from petscjam.io.jobs import ModulusAnalysis
    from petscjam.parallel.petsc import start
    from petscjam.response.reduced import checked_rtol

    start(comm)
    laws, omega = chosen_laws(options), options.omega
    reduced = [options.rtol is not None, options.out_of_core, options.block_low_rank > 0, options.beta_family]
    if options.direct and any(reduced):
        names = "--rtol, --out-of-core, --block-low-rank and --beta-family"
        raise InputError(f"moduli: {names} go with the reduced model, not --direct")
    if options.mass is not None and options.beta_family:
        raise InputError("moduli: --beta-family has no inertia: leave out --mass")
    rtol = 1e-6 if options.rtol is None else options.rtol
    checked_rtol(rtol, 1e-12)
    for w in options.fields:
        if not omega.min() <= w <= omega.max():
            raise InputError(f"--fields {w:g} lies outside the sweep")
    nearest = [np.argmin(np.abs(np.log(omega / w))) for w in options.fields]
    analysis = ModulusAnalysis(
        omega,
        strain=options.strain,
        rtol=rtol,
        direct=options.direct,
        mass=options.mass,
        fields_at=omega[np.unique(np.array(nearest, dtype=int))],
        family=options.beta_family,
        out_of_core=options.out_of_core,
        block_low_rank=options.block_low_rank,
    )
    if way := analysis.way(laws):
        say(comm, way)
    failures = _analysed(options, comm, analysis, laws)
    peaks = comm.gather(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    say(comm, f"peak memory of each rank: {' '.join(f'{peak:.0f}' for peak in peaks or [])} MB")
    _finish(failures, "moduli")


def _analysed(options: argparse.Namespace, comm: Comm, analysis: Analysis, laws: Sequence[Any] = (None,)) -> list[str]:
    """Analyse the given packings and print the results; return the reasons of failures."""
    from petscjam.base.progress import progress
    from petscjam.io.jobs import Ensemble, analyse
    from petscjam.io.results import read_results
    from petscjam.parallel.claims import claimed
    from petscjam.plots.tables import table

    with progress(options.verb, show=comm.rank == 0) as report, claimed(options.output, comm):
        ensemble = Ensemble(
            on_root(comm, _all_packings, options),
            options.output,
            laws,
            options.prestress,
            team_size=options.team_size,
            resume=options.resume,
            overwrite=options.overwrite,
        )
        made, failures = analyse(
            ensemble, analysis, comm=comm, progress=report, log=lambda line: print(line, flush=True)
        )
    if made or options.resume:
        say(comm, on_root(comm, lambda: table(read_results(options.output))))
    return failures


def _packings_of(given: Path) -> list[Path]:
    """Return the file itself, or the packings of a folder, without results."""
    from petscjam.io.kinds import recognise

    return [file for file in sorted(given.glob("*.h5")) if recognise(file) != "results"] if given.is_dir() else [given]


def _all_packings(options: argparse.Namespace) -> list[Path]:
    """Return the packings of all given files and folders; refuse if there are none.

    A sheared run stands for the packing of its last state, quenched into a file in the folder of the output.
    """
    from petscjam.md.result import is_run

    found = [file for one in options.packings for file in _packings_of(one)]
    if not found:
        raise InputError(f"{options.packings[0]}: no packings in this folder")
    runs = {file: options.output.with_name(f"{file.stem}.quenched.h5") for file in found if is_run(file)}
    if runs:
        quenched = _quench(runs, found, options)
        found = [runs.get(file, file) for file in found if file in quenched or file not in runs]
    return list(dict.fromkeys(found))


def _quench(runs: dict[Path, Path], packings: list[Path], options: argparse.Namespace) -> set[Path]:
    """Quench the last state of each run into its file, unless the file has it already; return the jammed runs.

    An error is raised only if all runs fail.
    """
    from petscjam.base.files import check_output
    from petscjam.geometry.packing import Packing
    from petscjam.md.quench import quench, snapshot
    from petscjam.md.result import read
    from petscjam.parallel.claims import claimed

    check_output(options.output, overwrite=options.overwrite or options.resume, inputs=runs)
    if len(set(runs.values())) < len(runs):
        names = "".join(f"\n  {run}" for run in runs)
        raise InputError(f"{options.output}: runs of one name would be quenched into one file there:{names}")
    with ExitStack() as claims:
        for target in runs.values():
            claims.enter_context(claimed(target))
        starts = {}
        for run, target in runs.items():
            with naming(run):
                start = snapshot(read(run))
            if target.exists() and Packing.read(target).provenance.get("quenched") == start.checksum:
                print(f"{run}: quenched already: {target}", flush=True)
            else:
                inputs = [options.output, *packings]
                check_output(target, overwrite=options.overwrite, inputs=inputs)
                starts[run] = start
        failures: dict[Path, Exception] = {}
        for run, start in starts.items():
            try:
                with naming(run):
                    packing = quench(start)
            except (InputError, SolverError) as error:
                failures[run] = error
                continue
            packing.write(runs[run], overwrite=True)
            print(f"{run}: quenched: {runs[run]} ({in_short(packing)})", flush=True)
        if len(failures) == len(runs):
            raise next(iter(failures.values()))
        for failure in failures.values():
            print(f"petscjam: warning: left out: {failure}", file=sys.stderr, flush=True)
        return set(runs) - set(failures)


def _finish(failures: list[str], what: str) -> None:
    """Raise an error if some packings failed."""
    if failures:
        lines = "".join(f"\n  {failure}" for failure in failures)
        raise SolverError(f"{len(failures)} {what} failed; --resume tries them again:{lines}")
