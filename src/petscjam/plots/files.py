"""The text of ``info`` and the figure of ``plot`` for each kind of file and folder: see :func:`recognise`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from petscjam.io.importers import import_packing
from petscjam.io.results import read_results
from petscjam.md.result import Run, read, read_folder
from petscjam.plots import plot_packing, plot_results
from petscjam.plots.library import plot_library
from petscjam.plots.shear import plot_flow, plot_ramp, plot_run
from petscjam.plots.tables import describe_library, describe_packing, describe_run, describe_runs, table
from petscjam.preparation.library import Library, read_library

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Contents(NamedTuple):
    """The name of a kind of file, and functions that read it, describe it, and draw it, into a file if one is given."""

    name: str
    read: Callable[..., Any]
    describe: Callable[[Any], str]
    draw: Callable[[Any, Path | None], Figure]


def _draw_library(library: Library, path: Path | None) -> Figure:
    return plot_library(library.rows, path)


def _draw_run(run: Run, path: Path | None) -> Figure:
    return (plot_ramp if run.settings.protocol == "ramp" else plot_run)(run, path)


CONTENTS = {
    "packing": Contents("a packing", import_packing, describe_packing, plot_packing),
    "library": Contents("a folder", read_library, describe_library, _draw_library),
    "runs": Contents("a folder", read_folder, describe_runs, plot_flow),
    "run": Contents("a sheared run", read, describe_run, _draw_run),
    "results": Contents("a result", read_results, table, plot_results),
}
