"""Common parts of the figures: colours, and atomic writing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.base.errors import InputError
from petscjam.base.files import write_atomically
from petscjam.base.types import Array
from petscjam.geometry.box import Box

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import EllipseCollection
    from matplotlib.figure import Figure

Colour = str | tuple[float, float, float, float]
Colours = Callable[[float], Colour]  # of each pressure

MARKERS = "osD^vP"
STORAGE, LOSS, UNSTABLE, STABLE = "#1f5fa8", "#c8551b", "#8b1a1a", "#2e6b34"


def save(figure: Figure, path: str | PathLike[str], results: Mapping[str, Any] | None = None, dpi: float = 150) -> None:
    """Write ``figure``, completely or not at all.

    Parameters
    ----------
    figure : Figure
    path : path
        Its extension gives the format; PNG without one.
    results : dict, optional
        The number of those whose packing is not in balance is written below the figure.
    dpi : float
        Pixels per inch.

    Raises
    ------
    InputError
        If the format is not known, the file cannot be written, or there is nothing that can be drawn.
    """
    kind = Path(path).suffix.removeprefix(".").lower() or "png"
    known = figure.canvas.get_supported_filetypes()
    if kind not in known:
        raise InputError(f"{path}: {kind!r} is not a format of figures; known are {', '.join(sorted(known))}")
    unbalanced = [r.origin.net_force for r in (results or {}).values() if r.origin.balanced is False]
    if unbalanced:
        forces = [force for force in unbalanced if force is not None]
        reach = f": net forces on disks reach {max(forces):.2g} p·d" if forces else ""
        count = f"{len(unbalanced)} of {len(results)} results: " if results and len(results) > 1 else ""
        figure.supxlabel(f"{count}not in balance{reach}", color=UNSTABLE)
    picture = BytesIO()
    try:
        figure.savefig(picture, dpi=dpi, format=kind)
    except ValueError as error:  # no number of an axis can be drawn, as on a logarithmic one
        raise InputError(f"the figure cannot be drawn: {error}") from error
    write_atomically(path, picture.getvalue())


def solids(results: Mapping[str, Any]) -> tuple[dict[str, Any], str]:
    """Return the results of stable packings, or all if none is stable, and a title with this information."""
    stable = {name: r for name, r in results.items() if r.stable}
    title = f"{len(results)} result{'s' * (len(results) != 1)}"
    if not stable:
        states = sorted({r.state for r in results.values()})
        return dict(results), f"{title}, {states[0] if len(states) == 1 else 'none of stable packings'}"
    left_out = len(results) - len(stable)
    return stable, title + f", {left_out} not stable, left out" * (left_out > 0)


def legend(axes: Axes) -> None:
    """Draw a legend in which each label is once."""
    handles = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    axes.legend(handles.values(), handles.keys(), frameon=False, fontsize=8)


def heading(results: Mapping[str, Any]) -> str:
    """Return number of disks and pressure, or of packings, and the law, or their number."""
    first = next(iter(results.values()))
    count, laws = len({r.origin.checksum for r in results.values()}), {r.damping for r in results.values()}
    title = f"{first.origin.particles} disks, p = {first.origin.pressure:.3g}" if count == 1 else f"{count} packings"
    return f"{title}; {first.damping if len(laws) == 1 else f'{len(laws)} laws'}"


def given(prestress: bool) -> str:
    """Return ``with pre-stress`` or ``without pre-stress``."""
    return f"with{'' if prestress else 'out'} pre-stress"


def pressure_colours(pressures: Sequence[float]) -> Colours:
    """Return the colour of a pressure: darker for lower pressure."""
    from matplotlib import colormaps

    low, high = np.log(min(pressures)), np.log(max(pressures))
    return lambda p: colormaps["viridis"](0.9 * (np.log(p) - low) / (high - low) if high > low else 0.4)


def arrows(axes: Axes, x: Array, u: Array, **style: Any) -> None:
    """Draw arrows in units of the axes.

    Parameters
    ----------
    axes
        Of matplotlib.
    x, u : (n, 2)
        Start and vector of each arrow.
    **style
        As for ``quiver``.
    """
    axes.quiver(*x.T, *u.T, angles="xy", scale_units="xy", scale=1, **style)


def draw_cell(axes: Axes, box: Box, part: float = 1.0) -> None:
    """Draw the edges of the cell, or of its central part.

    Parameters
    ----------
    axes
        Of matplotlib.
    box : Box
    part : float
        Length of the edges, divided by that of the cell.
    """
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) - 0.5
    axes.plot(*(box.cell.sum(0) / 2 + part * corners @ box.cell).T, color="0.6", lw=0.8)


def disks(axes: Axes, centres: Array, radii: Array, **style: Any) -> EllipseCollection:
    """Return disks in units of the axes, not added to them.

    Parameters
    ----------
    axes
        Of matplotlib.
    centres, radii : (n, 2), (n,)
    **style
        As for a collection of matplotlib.
    """
    from matplotlib.collections import EllipseCollection

    width, upright = 2 * radii, np.zeros(len(radii))
    return EllipseCollection(
        width, width, upright, units="xy", offsets=centres, offset_transform=axes.transData, **style
    )


def place_colour(values: Sequence[float], value: float) -> Colour:
    """Return the colour of one of ``values``, by its place in ascending order.

    Parameters
    ----------
    values : sequence of float
    value : float
    """
    from matplotlib import colormaps

    place = sorted(values).index(value) / max(len(values) - 1, 1)
    return colormaps["viridis"](0.9 * place)
