"""The function of each verb: read, call, write, print."""

from __future__ import annotations

import argparse
import resource
import sys
from collections.abc import Collection, Sequence
from contextlib import ExitStack, suppress
from fnmatch import fnmatchcase
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from petscjam.base.errors import InputError, SolverError
from petscjam.base.files import naming
from petscjam.cli.laws import chosen_laws
from petscjam.parallel.comm import Comm, on_root

if TYPE_CHECKING:
    from petscjam.geometry.packing import Packing
    from petscjam.preparation.library import Recipe


def say(comm: Comm, text: str) -> None:
    """Print on rank 0.

    Parameters
    ----------
    comm : Comm
    text : str
    """
    if comm.rank == 0:
        print(text, flush=True)


def prepare(options: argparse.Namespace, comm: Comm) -> None:
    """Prepare one packing, or a library of several.

    Parameters
    ----------
    options : argparse.Namespace
    comm : Comm
    """
    from petscjam.base.progress import progress
    from petscjam.parallel.petsc import start
    from petscjam.preparation.library import Recipe, prepare_library

    recipe = Recipe(
        shear_stabilised=options.shear_stabilised,
        decompress=options.decompress,
        method=options.method,
        potential_name=options.potential,
        ratio=options.ratio,
        composition=options.composition,
        polydispersity=options.polydispersity,
    )
    start(comm)
    several = options.seeds is not None or len(options.particles) * len(options.pressure) > 1
    if not (several or options.decompress or options.output.is_dir()):
        _prepare_one(options, recipe, comm)
        return
    seeds = options.seeds or [_seed(options)]
    with progress("prepare", show=comm.rank == 0) as report:
        library = prepare_library(
            options.output,
            options.particles,
            options.pressure,
            seeds,
            comm=comm,
            resume=options.resume,
            overwrite=options.overwrite,
            threads=options.threads,
            budget=options.budget,
            progress=report,
            **vars(recipe),
        )
    made = {row["file"] for row in library.rows}
    reasons = {row["file"]: row["failure"] for row in library.failed}
    failed = sorted(library.tried - made)
    there = len(options.particles) * len(options.pressure) * len(seeds) - len(library.tried)
    proved = sum(row["proved"] is True for row in library.rows)
    say(
        comm,
        f"{len(library.tried) - len(failed)} prepared, {there} there already, {len(failed)} failed: "
        f"{options.output} ({proved} of {len(library.rows)} proved minima)",
    )
    if failed:
        lines = "".join(f"\n  {file}: {reasons.get(file, 'unknown')}" for file in failed)
        raise SolverError(f"{len(failed)} packings failed; --resume tries them again:{lines}")


def _prepare_one(options: argparse.Namespace, recipe: Recipe, comm: Comm) -> None:
    from petscjam.base.files import check_output
    from petscjam.base.progress import progress
    from petscjam.geometry.packing import Packing
    from petscjam.parallel.claims import claimed
    from petscjam.preparation.library import exists, threads_for
    from petscjam.preparation.prepare import check, prepare_packing

    n, pressure, seed, file = options.particles[0], float(options.pressure[0]), _seed(options), options.output

    def work() -> str:
        with claimed(file):
            if options.resume and exists(file, n, pressure, seed, recipe):
                return f"there already: {file} ({_in_short(Packing.read(file))})"
            check_output(file, overwrite=options.overwrite, inputs=[options.config] if options.config else [])
            with progress("prepare", show=True) as report:
                packing = prepare_packing(
                    n, pressure, seed, **recipe.start, threads=threads, budget=options.budget, progress=report
                )
            packing.write(file, overwrite=True)
            return f"prepared: {file} ({_in_short(packing)})"

    check(n, pressure, seed, budget=options.budget, **recipe.start)
    threads = options.threads or threads_for([n], comm)
    say(comm, on_root(comm, work))


def _seed(options: argparse.Namespace) -> int:
    return 1 if options.seed is None else options.seed


def _in_short(packing: Packing) -> str:
    verdict = {None: "not judged", True: "proved minimum", False: "not a proved minimum"}
    return f"{len(packing)} disks, phi = {packing.phi:.6f}, {verdict[packing.certificate.proved]}"


def info(options: argparse.Namespace, comm: Comm) -> None:
    """Print the content of a file or a folder.

    Parameters
    ----------
    options : argparse.Namespace
    comm : Comm
    """

    def text() -> str:
        from petscjam.io.kinds import recognise
        from petscjam.plots.files import CONTENTS

        file, reading = options.file, (options.index, options.potential, options.diameters)
        kind = recognise(file)
        contents = CONTENTS[kind]
        if kind == "packing":
            return f"{'file':18s} {file}\n{contents.describe(contents.read(file, *reading))}"
        said = contents.describe(contents.read(file))
        if any(reading):
            raise InputError(f"info: {file} is {contents.name}; --index, --potential and --diameters go with packings")
        return said

    with naming(options.file):
        said = on_root(comm, text)
    say(comm, said)


def import_(options: argparse.Namespace, comm: Comm) -> None:
    """Import a packing, and certify it or relax it.

    Parameters
    ----------
    options : argparse.Namespace
    comm : Comm
    """
    from petscjam.base.progress import progress
    from petscjam.parallel.petsc import start

    if not options.relax and (options.pressure is not None or options.shear_stabilised):
        raise InputError("import: --pressure and --shear-stabilised go with --relax")
    with suppress(InputError):
        start(comm)

    def work() -> None:
        from petscjam.base.files import check_output
        from petscjam.io.exporters import format_of
        from petscjam.io.importers import import_packing
        from petscjam.parallel.claims import claimed
        from petscjam.preparation.prepare import relax_packing

        format_of(options.output, "h5md", "h5md")
        with claimed(options.output):
            check_output(options.output, overwrite=options.overwrite, inputs=[options.file])
            packing = import_packing(options.file, options.index, options.potential, options.diameters)
            if options.relax:
                with naming(options.file), progress("relax", show=True) as report:
                    before = _measured(packing)
                    packing = relax_packing(
                        packing, options.pressure, shear_stabilised=options.shear_stabilised, progress=report
                    )
                print(f"before: {before}\nafter:  {_measured(packing)}")
            else:
                packing = _judged(packing, options.file)
            packing.write(options.output, overwrite=options.overwrite)
            print(f"{options.output}: {_in_short(packing)}")

    on_root(comm, work)


def _measured(packing: Packing) -> str:
    from petscjam.geometry.network import ContactNetwork

    network = ContactNetwork.of(packing)
    return f"p = {network.pressure:.6g} k, phi = {packing.phi:.6f}, Z = {network.Z:.4f}"


def _judged(packing: Any, file: Path) -> Any:
    """Return a packing with its certificate, if possible; warn if forces do not balance."""
    from petscjam.io.importers import imbalance
    from petscjam.preparation.certify import certify

    def warn(text: str) -> None:
        print(f"petscjam: warning: {file}{text}", file=sys.stderr, flush=True)

    try:
        packing = certify(packing) if packing.certificate.proved is None else packing
    except (InputError, SolverError) as error:
        warn(f" is not judged: {error}")
    with suppress(InputError):
        if said := imbalance(packing):
            warn(f": the forces do not balance: {said}; --relax minimises the energy")
    return packing


def export(options: argparse.Namespace, comm: Comm) -> None:
    """Export a packing, a sheared run, or a result for rheologists.

    Parameters
    ----------
    options : argparse.Namespace
    comm : Comm
    """
    writers = {"packing": _export_packing, "run": _export_run, "results": _export_results}

    def work() -> None:
        from petscjam.io.kinds import recognise

        kind = recognise(options.file)
        if kind not in writers:
            raise InputError(f"{options.file}: is a folder, not a file")
        if kind != "run" and options.strain is not None:
            raise InputError("export: --strain goes with a sheared run")
        others = options.group or options.average or options.omega is not None or options.time is not None
        if kind != "results" and others:
            raise InputError("export: --group, --average, --omega and --time go with results")
        print(writers[kind](options))

    on_root(comm, work)


def _target(options: argparse.Namespace, default: str, known: Collection[str] = (), name: str = "") -> tuple[str, Path]:
    """Return the format, one of those ``known`` here, and the file to write."""
    from petscjam.base.files import check_output
    from petscjam.io.exporters import format_of

    fmt = format_of(options.output or "", options.to, default)
    if known and fmt not in known:
        raise InputError(f"export: {options.file} is a {name}; its formats are {', '.join(known)}, not {fmt}")
    target: Path = options.output or options.file.with_suffix(f".{fmt}")
    if fmt != "lammps":  # a folder
        check_output(target, overwrite=options.overwrite, inputs=[options.file])
    return fmt, target


def _export_packing(options: argparse.Namespace) -> Path:
    from petscjam.io.exporters import FORMATS, export_packing
    from petscjam.io.importers import import_packing

    fmt, target = _target(options, "xyz", FORMATS, "packing")
    export_packing(import_packing(options.file), target, fmt, overwrite=options.overwrite)
    return target


def _export_results(options: argparse.Namespace) -> Path:
    from petscjam.analysis.statistics import average
    from petscjam.io.results import read_results
    from petscjam.io.rheology import export_average

    results = read_results(options.file)
    first = next(iter(results.values()), None)
    if first is None or not first.exports:
        what = "no results yet" if first is None else f"{type(first).__name__}, of which there is no export"
        raise InputError(f"{options.file}: holds {what}")
    fmt, target = _target(options, "csv")
    if options.average:
        if fmt != "csv":
            raise InputError(f"export: --average is written as csv, not as {fmt}")
        if options.time is not None:
            raise InputError("export: --time goes with --to gt, not with --average")
        export_average(average(_matching(options, results), options.omega), target, overwrite=options.overwrite)
        return target
    with naming(options.file):
        result = _one_of(options, results)
        write = resolve_name(first.exports)
        write(result, target, fmt, omegas=options.omega, times=options.time, overwrite=options.overwrite)
    if not result.stable:
        print(f"petscjam: warning: {target}: {result.state}", file=sys.stderr, flush=True)
    return target


def _export_run(options: argparse.Namespace) -> Path:
    from petscjam.io.lammps_shear import write_lammps
    from petscjam.md.result import export_csv, read

    fmt, target = _target(options, "csv", ("csv", "lammps"), "sheared run")
    if options.strain is not None and fmt != "lammps":
        raise InputError("export: --strain goes with --to lammps")
    run = read(options.file)
    if fmt == "csv":
        export_csv(run, target, overwrite=options.overwrite)
        return target
    model, dt = run.settings.model, run.settings.dt
    divided = run.rows["parts"].max() > 1
    write_lammps(
        run.state,
        model,
        target,
        rate=run.state.rate,
        strain=1.0 if options.strain is None else options.strain,
        dt=None if divided or dt > model.step(None, "heun") else dt,
        overwrite=options.overwrite,
    )
    return target


def _matching(options: argparse.Namespace, results: dict[str, Any]) -> dict[str, Any]:
    pattern = options.group or "*"
    found = {name: g for name, g in results.items() if fnmatchcase(name, pattern)}
    if not found:
        raise InputError(f"--group: no result in {options.file} is called {pattern}")
    return found


def _one_of(options: argparse.Namespace, results: dict[str, Any]) -> Any:
    if options.group is None and len(results) == 1:
        return next(iter(results.values()))
    if options.group not in results:
        names = "".join(f"\n  {name}" for name in results)
        raise InputError(f"--group: {options.group or 'left out'}; the file holds{names}")
    return results[options.group]


def packings_of(given: Path) -> list[Path]:
    """Return the file itself, or the packings of a folder, without results."""
    from petscjam.io.kinds import recognise

    return [file for file in sorted(given.glob("*.h5")) if recognise(file) != "results"] if given.is_dir() else [given]


def all_packings(options: argparse.Namespace) -> list[Path]:
    """Return the packings of all given files and folders; refuse if there are none.

    A sheared run stands for the packing of its last state, quenched into a file in the folder of the output.
    """
    from petscjam.md.result import is_run

    found = [file for one in options.packings for file in packings_of(one)]
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
            print(f"{run}: quenched: {runs[run]} ({_in_short(packing)})", flush=True)
        if len(failures) == len(runs):
            raise next(iter(failures.values()))
        for failure in failures.values():
            print(f"petscjam: warning: left out: {failure}", file=sys.stderr, flush=True)
        return set(runs) - set(failures)


def finish(failures: list[str], what: str) -> None:
    """Raise an error if some packings failed.

    Parameters
    ----------
    failures : list of str
    what : str
        What failed, in the plural.

    Raises
    ------
    SolverError
    """
    if failures:
        lines = "".join(f"\n  {failure}" for failure in failures)
        raise SolverError(f"{len(failures)} {what} failed; --resume tries them again:{lines}")


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
        fields_at=omega[np.unique(np.array(nearest, dtype=int))],
        family=options.beta_family,
        out_of_core=options.out_of_core,
        block_low_rank=options.block_low_rank,
    )
    if way := analysis.way(laws):
        say(comm, way)
    failures = analysed(options, comm, analysis, laws)
    peaks = comm.gather(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    say(comm, f"peak memory of each rank: {' '.join(f'{peak:.0f}' for peak in peaks or [])} MB")
    finish(failures, "moduli")


def analysed(options: argparse.Namespace, comm: Comm, analysis: Any, laws: Sequence[Any] = (None,)) -> list[str]:
    """Analyse the given packings and print the results; return the reasons of failures.

    Parameters
    ----------
    options : argparse.Namespace
    comm : Comm
    analysis : Analysis
    laws : sequence of DampingLaw or None
    """
    from petscjam.base.progress import progress
    from petscjam.io.jobs import Ensemble, analyse
    from petscjam.io.results import read_results
    from petscjam.parallel.claims import claimed
    from petscjam.plots.tables import table

    with progress(options.verb, show=comm.rank == 0) as report, claimed(options.output, comm):
        ensemble = Ensemble(
            on_root(comm, all_packings, options),
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


def plot(options: argparse.Namespace, comm: Comm) -> None:
    """Draw a result, a packing or a folder of packings.

    Parameters
    ----------
    options : argparse.Namespace
    comm : Comm
    """

    def work() -> None:
        from petscjam.base.files import check_output
        from petscjam.io.kinds import recognise
        from petscjam.plots.files import CONTENTS
        from petscjam.plots.shear import plot_maps

        given: Path = options.file
        target = options.output or (Path(f"{given.absolute()}.png") if given.is_dir() else given.with_suffix(".png"))
        check_output(target, overwrite=options.overwrite, inputs=[given])
        kind = recognise(given)
        if options.maps and kind != "run":
            raise InputError(f"plot: --maps goes with a sheared run, and {given} is none")
        found = CONTENTS[kind].read(given)
        if options.maps:
            plot_maps(found.state, target)
        else:
            CONTENTS[kind].draw(found, target)
        print(target)

    on_root(comm, work)
