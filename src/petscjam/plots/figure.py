"""The style of all figures, common parts of them, and atomic writing."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
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
    from matplotlib.axis import Axis
    from matplotlib.collections import EllipseCollection
    from matplotlib.figure import Figure
    from matplotlib.text import Text

Colour = str | tuple[float, float, float, float]

# M. Okabe, K. Ito, Color Universal Design (2008): told apart by the colour-blind
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
STORAGE, LOSS, STABLE, *_ = PALETTE
UNSTABLE = "#8b1a1a"
STYLE = {
    "axes.titlesize": 10,
    "axes.formatter.use_mathtext": True,
    "figure.titlesize": 11,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "legend.title_fontsize": 8,
    "pdf.fonttype": 42,
    "ps.fonttype": 42,
    "svg.fonttype": "none",
    "savefig.dpi": 150,
}
GAP = 2.0  # least distance of tick labels, pixels


@contextmanager
def house_style(style: str | None = None, dpi: float | None = None) -> Iterator[None]:
    """Draw in the style of all figures; what the user's settings of matplotlib change stays as they say.

    Parameters
    ----------
    style : str, optional
        A style sheet of matplotlib, or the path of one.
    dpi : float, optional
        Pixels per inch of figures that are written.

    Raises
    ------
    InputError
        If there is no such style.
    """
    from cycler import cycler
    from matplotlib import rc_context, rcParams, rcParamsDefault
    from matplotlib import style as sheets

    ours: dict[Any, Any] = {**STYLE, "axes.prop_cycle": cycler(color=PALETTE)}
    with rc_context():
        rcParams.update({key: value for key, value in ours.items() if rcParams[key] == rcParamsDefault[key]})
        try:
            sheets.use(style or [])
        except OSError:
            known = ", ".join(name for name in sheets.available if not name.startswith("_"))
            raise InputError(f"--style: {style!r} is neither a file nor a style; known are {known}") from None
        if dpi is not None:
            rcParams["savefig.dpi"] = dpi
        yield


def panel(ax: Axes | None, width: float = 7.2, height: float = 5.2) -> Axes:
    """Return ``ax``, or the only axes of a new figure of so many inches.

    Parameters
    ----------
    ax
        Of matplotlib.
    width, height : float
    """
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained").subplots() if ax is None else ax


def finished(figure: Any, path: str | PathLike[str] | None) -> Figure:
    """Return the whole ``figure``, after it is written if there is a ``path``.

    Parameters
    ----------
    figure
        Of matplotlib, or a part of it.
    path : path or None
        As for :func:`save`.
    """
    whole: Figure = figure.figure
    while whole is not whole.figure:
        whole = whole.figure
    if path is None:
        settle(whole)
    else:
        save(whole, path)
    return whole


def save(figure: Figure, path: str | PathLike[str], dpi: float | None = None) -> None:
    """Write ``figure``, completely or not at all; PDF with its fonts (Type 42), SVG with text as text.

    Parameters
    ----------
    figure : Figure
    path : path
        Its extension gives the format; PNG without one.
    dpi : float, optional
        Pixels per inch; default: those of the style, 150.

    Raises
    ------
    InputError
        If the format is not known, the file cannot be written, or there is nothing that can be drawn.
    """
    kind = Path(path).suffix.removeprefix(".").lower() or "png"
    known = figure.canvas.get_supported_filetypes()
    if kind not in known:
        raise InputError(f"{path}: {kind!r} is not a format of figures; known are {', '.join(sorted(known))}")
    picture = BytesIO()
    logging.getLogger("fontTools").setLevel(logging.ERROR)  # it warns of the dates of fonts
    with house_style(dpi=dpi):
        try:
            settle(figure)
            figure.savefig(picture, format=kind)
        except ValueError as error:  # no number of an axis can be drawn, as on a logarithmic one
            raise InputError(f"the figure cannot be drawn: {error}") from None
    write_atomically(path, picture.getvalue())


def settle(figure: Figure) -> None:
    """Break titles that are too wide at a comma, and take fewer tick labels where they would overlap.

    A logarithmic axis keeps the labels of its decades, if these are two; a shorter one gets those of a linear axis.

    Parameters
    ----------
    figure : Figure
    """
    from matplotlib.text import Text
    from matplotlib.ticker import LogFormatter, MaxNLocator, NullFormatter, ScalarFormatter

    figure.draw_without_rendering()
    for text in figure.findobj(Text):
        if ", " in text.get_text() and (text.axes is None or text is text.axes.title):
            _break(text)
    for axis in [axis for axes in figure.axes if axes.axison for axis in (axes.xaxis, axes.yaxis)]:
        if not _collide(axis):
            continue
        if axis.get_scale() == "log" and isinstance(axis.get_minor_formatter(), LogFormatter):
            axis.set_minor_formatter(NullFormatter())
            if len(_labels(axis)) < 2:
                axis.set_major_formatter(ScalarFormatter())
                axis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
        for count in (6, 5, 4, 3, 2):
            if not _collide(axis):
                break
            if isinstance(axis.get_major_locator(), MaxNLocator):
                axis.set_major_locator(MaxNLocator(count, steps=[1, 2, 5, 10]))
            else:
                axis.set_ticks(axis.get_majorticklocs()[::2])


def _break(text: Text) -> None:
    """Break a title into as many lines as make it narrower than its panel, or its figure."""
    width = 1.15 * text.axes.bbox.width if text.axes else 0.98 * text.figure.bbox.width
    parts, whole = text.get_text().split(", "), len(text.get_text())
    for lines in range(2, len(parts) + 1):
        if text.get_window_extent().width <= width:
            break
        rows = [parts[0]]
        for part in parts[1:]:
            if len(rows) < lines and len(rows[-1]) + len(part) / 2 > whole / lines:
                rows.append(part)
            else:
                rows[-1] += f", {part}"
        text.set_text("\n".join(rows))


def _labels(axis: Axis) -> list[Any]:
    """Return the tick labels of an axis that are drawn."""
    low, high = sorted(axis.get_view_interval())
    ticks = [*axis.get_major_ticks(), *axis.get_minor_ticks()]
    return [
        label
        for tick in ticks
        for label in (tick.label1, tick.label2)
        if low <= tick.get_loc() <= high and label.get_visible() and label.get_text()
    ]


def _collide(axis: Axis) -> bool:
    """Return whether two tick labels are nearer than ``GAP``."""
    axis.get_tightbbox()  # places the labels
    boxes = [label.get_window_extent().padded(GAP / 2) for label in _labels(axis)]
    return any(a.overlaps(b) for k, a in enumerate(boxes) for b in boxes[:k])


def note_unbalanced(figure: Figure, results: Mapping[str, Any]) -> None:
    """Write below the figure how many packings of ``results`` are not in balance.

    Parameters
    ----------
    figure : Figure
    results : mapping
    """
    unbalanced = [r.origin.net_force for r in results.values() if r.origin.balanced is False]
    if unbalanced:
        forces = [force for force in unbalanced if force is not None]
        reach = f": net forces on disks reach {max(forces):.2g} p·d" if forces else ""
        count = f"{len(unbalanced)} of {len(results)} results: " if len(results) > 1 else ""
        figure.supxlabel(f"{count}not in balance{reach}", color=UNSTABLE)


def scale_bar(axes: Axes, unit: float, symbol: str = "d") -> None:
    """Draw a scale below the lower left corner: 1, 2 or 5 times a power of ten units.

    Parameters
    ----------
    axes
        Of matplotlib.
    unit : float
        Length of the unit, in those of the axes.
    symbol : str
        Of the unit.
    """
    from matplotlib.font_manager import FontProperties
    from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

    span = float(np.ptp(axes.get_xlim())) / (4 * unit)  # largest length
    power = 10.0 ** np.floor(np.log10(span))
    length = max(step * power for step in (1, 2, 5) if step * power <= span)
    place: dict[str, Any] = {"loc": "upper left", "pad": 0.1, "frameon": False, "bbox_to_anchor": (0, 0)}
    place |= {"bbox_transform": axes.transAxes, "fontproperties": FontProperties(size=9), "color": "0.25"}
    height = 0.006 * float(np.ptp(axes.get_ylim()))
    bar = AnchoredSizeBar(axes.transData, length * unit, f"{length:g} ${symbol}$", size_vertical=height, **place)
    axes.add_artist(bar)


def solids(results: Mapping[str, Any]) -> tuple[dict[str, Any], str]:
    """Return the results of stable packings, or all if none is stable, and this as the end of a title."""
    stable = {name: r for name, r in results.items() if r.stable}
    if not stable:
        states = sorted({r.state for r in results.values()})
        return dict(results), f", {states[0] if len(states) == 1 else 'none stable'}"
    left_out = len(results) - len(stable)
    return stable, f", {left_out} of {len(results)} not stable, left out" * (left_out > 0)


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
