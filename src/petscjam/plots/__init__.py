"""Figures: complex moduli, a packing and its preparation, a library of packings, and other results.

matplotlib is imported when the first figure is drawn.
"""

from collections.abc import Mapping
from os import PathLike
from pkgutil import resolve_name

from petscjam.base.errors import InputError
from petscjam.plots.figure import save
from petscjam.plots.library import plot_library
from petscjam.plots.modulus import _draw_moduli as _draw_moduli
from petscjam.plots.packing import plot_packing
from petscjam.response.origin import Result

__all__ = ["plot_library", "plot_packing", "plot_results"]


def plot_results(results: Mapping[str, Result], path: str | PathLike[str]) -> None:
    """Draw results of one kind, as read from a file.

    Parameters
    ----------
    results : mapping
        From names.
    path : path
        Its extension gives the format.

    Raises
    ------
    InputError
        If there are none, or the figure cannot be written.
    """
    if not results:
        raise InputError("the file holds no results yet")
    first = next(iter(results.values()))
    if not first.figure:
        raise InputError(f"there is no picture of {type(first).__name__}")
    draw = resolve_name(first.figure) if isinstance(first.figure, str) else first.figure
    save(draw(results), path, results)
