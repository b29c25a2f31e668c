"""Common parts of several figures.

Axes: w frequency, k packing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.analysis.statistics import standard_error

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from petscjam.plots.figure import Colour


def draw_mean(
    axes: Axes,
    some: list[Any],
    colour: Colour,
    label: str,
    *,
    marker: str = "o",
    x: float = 1.0,
    y: float = 1.0,
    most: float = np.inf,
) -> None:
    """Draw the means of G′ (filled) and G″ (open) over packings, and their standard errors, rescaled.

    Parameters
    ----------
    axes, colour
        Of matplotlib.
    some : list of ComplexModulus
        On one grid of frequencies.
    label, marker : str
    x, y : float
        Factors of ω and of G*.
    most : float
        The highest frequency that is drawn, 1/τ1.
    """
    kept = some[0].omega <= most
    omega, values = some[0].omega[kept] * x, np.array([g.values for g in some])[:, kept] * y
    for part, face, text in ((values.real, colour, label), (values.imag, "white", "")):
        mean, error = part.mean(0), np.nan_to_num(standard_error(part))
        axes.loglog(omega, mean, f"{marker}-", ms=3, lw=0.8, color=colour, mfc=face, label=text)
        low = np.maximum(mean - error, 1e-3 * mean)
        axes.fill_between(omega, low, mean + error, color=colour, alpha=0.2, lw=0)


def guide(axes: Axes, x: tuple[float, float], y: float, slope: float, text: str) -> None:
    """Draw the power law y·(x/x[0])^slope as a straight line, and write ``text`` next to it.

    Parameters
    ----------
    axes
        Of matplotlib, both logarithmic.
    x : (float, float)
        Ends.
    y : float
        Value at x[0].
    slope : float
    text : str
    """
    ends = np.array(x)
    heights = y * (ends / x[0]) ** slope
    axes.loglog(ends, heights, color="0.3", lw=1, ls="--")
    middle = np.sqrt(ends[0] * ends[1]), np.sqrt(heights[0] * heights[1])
    axes.annotate(text, middle, (4, -4), textcoords="offset points", fontsize=9, color="0.3", va="top")
