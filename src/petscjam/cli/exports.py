"""Exports: packings for other programs, moduli for rheologists, input for LAMMPS, and flat tables of anything."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Collection
from fnmatch import fnmatchcase
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from petscjam.base.errors import InputError
from petscjam.base.files import naming
from petscjam.parallel.comm import Comm, on_root


def export(options: argparse.Namespace, comm: Comm) -> None:
    """Export a packing, a sheared run, results, or a folder of them.

    Parameters
    ----------
    options : argparse.Namespace
    comm : Comm
    """
    writers = {"packing": _export_packing, "run": _export_run, "results": _export_results}
    writers |= dict.fromkeys(("library", "runs"), _export_folder)

    def work() -> None:
        from petscjam.io.kinds import recognise

        kind = recognise(options.file)
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
    here: Path = options.file
    target: Path = options.output or (
        Path(f"{here.absolute()}.{fmt}") if here.is_dir() else here.with_suffix(f".{fmt}")
    )
    if fmt != "lammps":  # a folder
        check_output(target, overwrite=options.overwrite, inputs=[options.file])
    return fmt, target


def _export_packing(options: argparse.Namespace) -> Path:
    from petscjam.io.exporters import FORMATS, export_packing
    from petscjam.io.importers import import_packing
    from petscjam.io.tidy import WRITERS, read_table, write_table

    fmt, target = _target(options, "xyz", [*FORMATS, *WRITERS], "packing")
    if fmt in WRITERS:
        write_table(read_table(options.file), target, fmt, overwrite=options.overwrite)
        return target
    export_packing(import_packing(options.file), target, fmt, overwrite=options.overwrite)
    return target


def _export_results(options: argparse.Namespace) -> Path:
    from petscjam.analysis.statistics import average
    from petscjam.io.results import read_results
    from petscjam.io.rheology import export_average
    from petscjam.io.tidy import WRITERS, of_results, write_table

    results = read_results(options.file)
    first = next(iter(results.values()), None)
    if first is None:
        raise InputError(f"{options.file}: holds no results yet")
    one = options.group in results or (options.group is None and len(results) == 1) or options.omega is not None
    known = () if first.exports else tuple(WRITERS)
    fmt, target = _target(options, "csv", known, f"file of {type(first).__name__}")
    if options.average:
        if not first.exports:
            raise InputError(f"export: --average goes with moduli, not with {type(first).__name__}")
        if fmt != "csv":
            raise InputError(f"export: --average is written as csv, not as {fmt}")
        if options.time is not None:
            raise InputError("export: --time goes with --to gt, not with --average")
        export_average(average(_matching(options, results), options.omega), target, overwrite=options.overwrite)
        return target
    if fmt == "parquet" or (fmt == "csv" and not (first.exports and one)):
        for name in ("omega", "time"):
            if getattr(options, name) is not None:
                raise InputError(f"export: --{name} goes with one modulus as csv, tts or gt")
        write_table(of_results(_matching(options, results)), target, fmt, overwrite=options.overwrite)
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
    from petscjam.io.tidy import write_table
    from petscjam.md.result import export_csv, read

    fmt, target = _target(options, "csv", ("csv", "parquet", "lammps"), "sheared run")
    if options.strain is not None and fmt != "lammps":
        raise InputError("export: --strain goes with --to lammps")
    run = read(options.file)
    if fmt == "parquet":
        write_table(run.flat(), target, fmt, overwrite=options.overwrite)
        return target
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


def _export_folder(options: argparse.Namespace) -> Path:
    from petscjam.io.tidy import WRITERS, read_table, write_table

    fmt, target = _target(options, "csv", WRITERS, "folder")
    write_table(read_table(options.file), target, fmt, overwrite=options.overwrite)
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
