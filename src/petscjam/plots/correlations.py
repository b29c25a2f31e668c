"""Figure of correlations: C(δ) at some frequencies, and the correlation length against frequency (BT Fig. 7).

Axes: w frequency.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from petscjam.analysis.correlations import Correlations, correlation_length
from petscjam.plots.figure import solids
from petscjam.plots.legends import Families, Family, Shades, heading, law_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CURVES = 7  # largest number of curves in a panel


def correlations_figure(results: Mapping[str, Correlations]) -> Figure:
    """Draw C against δ/L, solid at peak stress and dashed at zero stress, and the correlation length l(ω).

    Packings of one size, pressure and law are averaged, without unstable ones unless all are unstable. C has a
    panel for each law with the first such mean; l is drawn for all means, with filled symbols for pre-stress.
    """
    from matplotlib.figure import Figure

    kept, note = solids(results)
    families = Families(kept, grid=lambda r: r.omega.tolist())
    first: dict[str, Family[Correlations]] = {}
    for family in families.members:
        first.setdefault(law_text(next(iter(family.results.values())).damping), family)
    figure = Figure(figsize=(4.8 * len(first) + 5.8, 4.6), layout="constrained")
    panels = figure.subplots(1, 1 + len(first), width_ratios=[4.8] * len(first) + [5.8])
    for axes, family in zip(panels, first.values(), strict=False):
        _draw_curves(axes, family.results)
        axes.set_title(heading(family.results) if len(families.members) > 1 else "")
    _draw_lengths(panels[-1], families)
    figure.suptitle(heading(kept) + note)
    return figure


def _draw_curves(axes: Axes, some: Mapping[str, Correlations]) -> None:
    """Draw the mean of C ± its standard error at evenly spaced frequencies of the result, from the lowest (dark) on."""
    omega = np.sort(next(iter(some.values())).omega)
    shown = omega[np.unique(np.linspace(0, len(omega) - 1, CURVES).round().astype(int))].tolist()
    shades = Shades("omega", shown)
    for part, style in (("real", "-"), ("imaginary", "--")):
        mean = correlation_length(some, part, unstable=True)
        x = mean.delta[1:] / mean.L
        for w in shown:
            k, colour = int(np.flatnonzero(mean.omega == w)[0]), shades(w)
            C, error = mean.C[k][1:], np.nan_to_num(mean.C_error[k][1:])
            face = colour if style == "-" else "white"
            axes.plot(x, C, style, lw=1.1, color=colour, marker=shades.marker(w), ms=3.5, mfc=face, markevery=0.1)
            axes.fill_between(x, C - error, C + error, color=colour, alpha=0.15, lw=0)
    axes.axhline(0, color="0.6", lw=0.8, zorder=0)
    axes.set(xlabel=r"$\delta/L$", ylabel="correlation $C$", xlim=(0, 0.5))
    for style, text in (("-", "peak stress"), ("--", "zero stress")):
        axes.plot([], [], style, color="0.3", label=text)
    shades.show(axes)


def _draw_lengths(axes: Axes, families: Families[Correlations]) -> None:
    """Draw the zero of the mean of C at peak stress, with its error."""
    for family in families.members:
        mean = correlation_length(family.results, unstable=True)
        rising = np.argsort(mean.omega)
        y, error = mean.length[rising] / mean.L, np.nan_to_num(mean.error[rising]) / mean.L
        axes.errorbar(mean.omega[rising], y, error, ms=5, lw=1, capsize=2, **family.look)
    axes.axhline(0.25, color="0.6", ls=":", lw=0.8, zorder=0, label="¼")
    axes.set(xscale="log", yscale="log", xlabel=r"$\omega\tau_1$", ylabel="correlation length $l/L$")
    families.show(axes)
