"""Pieces of pictures that several figures share.

Axes: w frequency, k packing.
"""

from __future__ import annotations

from typing import Any

import numpy as np


def draw_mean(
    axes: Any, some: list[Any], colour: Any, label: str, *, x: float = 1.0, y: float = 1.0, most: float = np.inf
) -> None:
    """Draw the means of G′ (filled) and G″ (open) over packings, and their standard errors, rescaled."""
    omega = some[0].omega
    kept = omega <= most
    values = np.array([g.values for g in some])[:, kept] * y
    error = np.sqrt(max(len(some) - 1, 1) * len(some))
    for part, filled in ((values.real, True), (values.imag, False)):
        mean, deviation = part.mean(0), np.sqrt(((part - part.mean(0)) ** 2).sum(0)) / error
        axes.loglog(
            omega[kept] * x,
            mean,
            "o-",
            ms=3,
            lw=0.8,
            color=colour,
            mfc=colour if filled else "white",
            label=label if filled else "",
        )
        low = np.maximum(mean - deviation, 1e-3 * mean)
        axes.fill_between(omega[kept] * x, low, mean + deviation, color=colour, alpha=0.2, lw=0)


def guide(axes: Any, x: tuple[float, float], y: float, slope: float, text: str) -> None:
    """Draw a straight line that starts at (x[0], y), and say its slope."""
    ends = np.array(x)
    heights = y * (ends / x[0]) ** slope
    axes.loglog(ends, heights, color="0.3", lw=1, ls="--")
    middle = np.sqrt(ends[0] * ends[1]), np.sqrt(heights[0] * heights[1])
    axes.annotate(text, middle, (4, -4), textcoords="offset points", fontsize=9, color="0.3", va="top")
