"""The verbs prepare, info, import, plot and report: read, call, write, print."""

from __future__ import annotations

import argparse
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from petscjam.base.errors import InputError, SolverError
from petscjam.base.files import naming
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
                return f"there already: {file} ({in_short(Packing.read(file))})"
            check_output(file, overwrite=options.overwrite, inputs=[options.config] if options.config else [])
            with progress("prepare", show=True) as report:
                packing = prepare_packing(
                    n, pressure, seed, **recipe.start, threads=threads, budget=options.budget, progress=report
                )
            packing.write(file, overwrite=True)
            return f"prepared: {file} ({in_short(packing)})"

    check(n, pressure, seed, budget=options.budget, **recipe.start)
    threads = options.threads or threads_for([n], comm)
    say(comm, on_root(comm, work))


def _seed(options: argparse.Namespace) -> int:
    return 1 if options.seed is None else options.seed


def in_short(packing: Packing) -> str:
    """Return a line about a packing: its size, packing fraction and verdict."""
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
        from petscjam.plots.files import CONTENTS, as_json

        file, reading = options.file, (options.index, options.potential, options.diameters)
        kind = recognise(file)
        contents = CONTENTS[kind]
        if options.json:
            found = contents.read(file, *reading) if kind == "packing" else contents.read(file)
            return as_json(file, kind, found)
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
            print(f"{options.output}: {in_short(packing)}")

    on_root(comm, work)


def _measured(packing: Packing) -> str:
    from petscjam.geometry.network import ContactNetwork

    network = ContactNetwork.of(packing)
    return f"p = {network.pressure:.6g} k, phi = {packing.phi:.6f}, Z = {network.Z:.4f}"


def _judged(packing: Packing, file: Path) -> Packing:
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


def report(options: argparse.Namespace, comm: Comm) -> None:
    """Write a page of HTML on a file or a folder.

    Parameters
    ----------
    options : argparse.Namespace
    comm : Comm
    """

    def work() -> None:
        from petscjam.plots.report import write_report

        for text in write_report(options.file, options.output, overwrite=options.overwrite):
            print(f"petscjam: warning: left out: {text}", file=sys.stderr, flush=True)
        print(options.output)

    on_root(comm, work)


def plot(options: argparse.Namespace, comm: Comm) -> None:
    """Draw a result, a packing or a folder of packings.

    Parameters
    ----------
    options : argparse.Namespace
    comm : Comm
    """

    def work() -> None:
        from petscjam.base.files import check_output, naming
        from petscjam.io.kinds import recognise
        from petscjam.plots.figure import house_style
        from petscjam.plots.files import CONTENTS
        from petscjam.plots.shear import plot_maps

        given: Path = options.file
        target = options.output or (Path(f"{given.absolute()}.png") if given.is_dir() else given.with_suffix(".png"))
        check_output(target, overwrite=options.overwrite, inputs=[given])
        kind = recognise(given)
        if options.maps and kind != "run":
            raise InputError(f"plot: --maps goes with a sheared run, and {given} is none")
        found = CONTENTS[kind].read(given)
        with naming(given), house_style(options.style, options.dpi):
            if options.maps:
                plot_maps(found.state, target)
            else:
                CONTENTS[kind].draw(found, target)
        print(target)

    on_root(comm, work)
