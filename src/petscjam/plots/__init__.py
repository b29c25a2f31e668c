"""Figures: results, packings and their preparation, libraries of packings, and sheared runs.

Each function returns the figure and, with a path, writes it. matplotlib is imported when the first figure is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping
from inspect import signature
from os import PathLike
from pkgutil import resolve_name
from typing import TYPE_CHECKING

from petscjam.base.errors import InputError
from petscjam.plots.figure import finished, house_style, note_unbalanced, save
from petscjam.plots.library import plot_library
from petscjam.plots.packing import plot_packing
from petscjam.response.origin import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["house_style", "plot_library", "plot_packing", "plot_results", "save"]


@house_style()
def plot_results(
    results: Mapping[str, Result], path: str | PathLike[str] | None = None, *, ax: Axes | None = None
) -> Figure:
    """Draw results of one kind, as read from a file.

    Parameters
    ----------
    results : mapping
        From names.
    path : path, optional
        Write the figure; its extension gives the format.
    ax
        Of matplotlib: draw here, if the picture of this kind has one panel. Of moduli this is the panel of G*(ω).

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If there are none, the picture has several panels and ``ax`` is given, or the figure cannot be written.
    """
    if not results:
        raise InputError("the file holds no results yet")
    first = next(iter(results.values()))
    if not first.figure:
        raise InputError(f"there is no picture of {type(first).__name__}")
    draw = resolve_name(first.figure) if isinstance(first.figure, str) else first.figure
    if ax is None:
        figure = draw(results)
        note_unbalanced(figure, results)
    elif "ax" in signature(draw).parameters:
        figure = draw(results, ax=ax)
    else:
        raise InputError(f"ax: the picture of {type(first).__name__} has several panels")
    return finished(figure, path)
