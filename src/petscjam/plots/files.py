"""The text of ``info`` and the figure of ``plot`` for each kind of file and folder: see :func:`recognise`."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from petscjam.base.errors import InputError
from petscjam.geometry.packing import Packing
from petscjam.io.importers import import_packing
from petscjam.io.kinds import kind_of
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


def as_json(path: Path, kind: str, found: Any) -> str:
    """Return the facts of a file or a folder as JSON; what is not a number or unknown is null.

    Parameters
    ----------
    path : Path
    kind : str
        As :func:`recognise` returns it.
    found : object
        Content of the file.
    """
    said: dict[str, Any] = {"file": str(path), "kind": kind}
    if isinstance(found, Packing):
        said |= {**found.facts(), "checksum": found.checksum, "certificate": asdict(found.certificate)}
        said["provenance"] = dict(found.provenance)
    elif isinstance(found, Library):
        said |= {"recipe": dict(found.recipe), "packings": found.rows, "failed": found.failed}
    elif isinstance(found, Run):
        said |= _of_run(found)
    elif kind == "runs":
        said["runs"] = {name: _of_run(run) for name, run in found.items()}
    else:
        said["results"] = {
            name: {**r.facts(), "kind": kind_of(type(r)), "origin": asdict(r.origin), "notes": r.notes}
            for name, r in found.items()
        }
    return json.dumps(_plain(said), ensure_ascii=False, indent=1, allow_nan=False)


def _of_run(run: Run) -> dict[str, Any]:
    said: dict[str, Any] = {
        "settings": run.settings.attributes,
        "last_strain": run.strain[-1],
        "warnings": run.warnings,
    }
    with suppress(InputError):
        said["means"] = {symbol: m._asdict() for symbol, m in run.means().items()}
    return said


def _plain(value: Any) -> Any:
    """Return ``value`` as JSON has it."""
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, bool | int | float) else str(value)


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
