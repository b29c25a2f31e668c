"""One flat table of any file or folder: a line for each point of each result, for each run, packing or disk."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from petscjam.base.errors import InputError
from petscjam.base.files import check_output, naming, write_atomically
from petscjam.base.interrupt import check
from petscjam.base.tables import Table
from petscjam.io.importers import import_packing
from petscjam.io.kinds import recognise
from petscjam.io.results import read_results
from petscjam.md.result import MEANS, Run, read, read_folder
from petscjam.preparation.library import read_library
from petscjam.response.origin import Result

WRITERS = {"csv": Table.to_csv, "parquet": Table.to_parquet}


def read_table(path: str | PathLike[str]) -> Table:
    """Return the content of a file or a folder as one flat table.

    A file of results has a line for each frequency, mode, contact … of each result, with packing and settings; a
    sheared run one for each interval, a packing one for each disk. A folder of results has the lines of all its files,
    a folder of runs a line for each run with its time means, a folder of packings a line for each packing.

    Parameters
    ----------
    path : path

    Raises
    ------
    InputError
        If a file is missing or damaged, or a folder has results of several kinds.
    """
    kind = recognise(path)
    if kind == "packing":
        return import_packing(path).flat()
    if kind == "run":
        return read(path).flat()
    if kind == "runs":
        return of_runs(read_folder(path))
    if kind == "library":
        files = results_of(path)
        return _of_files(files) if files else read_library(path).flat()
    return of_results(read_results(path))


def write_table(table: Table, path: str | PathLike[str], fmt: str, *, overwrite: bool = False) -> None:
    """Write a table as ``csv`` or ``parquet``.

    Parameters
    ----------
    table : Table
    path : path
    fmt : str
        A name of ``WRITERS``.
    overwrite : bool

    Raises
    ------
    InputError
        If ``path`` exists and ``overwrite`` is not set, or cannot be written, or a package is missing.
    """
    check_output(path, overwrite=overwrite)
    write_atomically(path, WRITERS[fmt](table))


def of_results(results: Mapping[str, Result]) -> Table:
    """Return the flat tables of results, one below the other, with their names as the first column."""
    return Table.stacked(_labelled("result", name, result.flat()) for name, result in results.items())


def of_runs(runs: Mapping[str, Run]) -> Table:
    """Return a line for each run: its settings, and its time means with their errors."""
    rows = []
    for name, run in runs.items():
        settings = {key: value for key, value in run.settings.attributes.items() if np.ndim(value) == 0}
        row: dict[str, Any] = {"run": name, **settings, "last_strain": float(run.strain[-1])}
        if run.after().sum() > 1:
            for symbol, m in run.means().items():
                column = MEANS.get(symbol, symbol).replace("<spin>/rate", "spin_over_rate")
                row |= {column: m.value, f"{column}_error": m.error}
        rows.append(row)
    return Table.of_rows(rows)


def results_of(folder: str | PathLike[str]) -> list[Path]:
    """Return the files of a folder without packings, if they are results; none if there are packings."""
    kinds = {file: recognise(file) for file in sorted(Path(folder).glob("*.h5"))}
    return [] if "packing" in kinds.values() else [file for file, kind in kinds.items() if kind == "results"]


def _of_files(files: Iterable[Path]) -> Table:
    tables, kinds = [], dict[str, Path]()
    for file in files:
        check()
        with naming(file):
            results = read_results(file)
            tables.append(_labelled("file", file.name, of_results(results)))
        for result in results.values():
            kinds.setdefault(type(result).__name__, file)
    if len(kinds) > 1:
        there = ", ".join(f"{kind} ({file.name})" for kind, file in kinds.items())
        raise InputError(f"export: results of several kinds are no table: {there}; export the files one by one")
    return Table.stacked(tables)


def _labelled(column: str, label: str, table: Table) -> Table:
    return Table({column: np.full(len(table), label, dtype=object), **table.columns}, table.units)
