"""Figure of correlations: C(δ) at some frequencies, and the correlation length against frequency (BT Fig. 7).

Axes: w frequency.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from petscjam.analysis.correlations import Correlations, correlation_length
from petscjam.analysis.statistics import Kind, alike
from petscjam.plots.figure import given, solids

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

    kept, title = solids(results)
    kinds = alike(kept)
    first = {kind.law: (kind, some) for kind, some in reversed(kinds.items())}
    figure = Figure(figsize=(4.6 * len(first) + 5.8, 4.6), layout="constrained")
    panels = figure.subplots(1, 1 + len(first), width_ratios=[4.6] * len(first) + [5.8])
    for axes, (kind, some) in zip(panels, reversed(first.values()), strict=False):
        _draw_curves(axes, some)
        what = f"N = {kind.particles}, p = {kind.pressure:g}, {len(some)} packings"
        axes.set_title(f"{kind.law}, {given(kind.prestress)}\n{what}", fontsize=9)
    _draw_lengths(panels[-1], kinds)
    figure.suptitle(title, fontsize=10)
    return figure


def _draw_curves(axes: Axes, some: Mapping[str, Correlations]) -> None:
    """Draw the mean of C at evenly spaced frequencies of the result, from the lowest (dark) on."""
    from matplotlib import colormaps

    for part, style in (("real", "-"), ("imaginary", "--")):
        mean = correlation_length(some, part, unstable=True)
        rising = np.argsort(mean.omega)
        shown = rising[np.unique(np.linspace(0, len(rising) - 1, CURVES).round().astype(int))]
        for k, w in enumerate(shown):
            axes.plot(
                mean.delta[1:] / mean.L,
                mean.C[w][1:],
                style,
                lw=1.1 if style == "-" else 0.7,
                color=colormaps["viridis"](0.9 * k / max(len(shown) - 1, 1)),
                label=f"{mean.omega[w]:.1e}" if style == "-" else None,
            )
    axes.axhline(0, color="0.6", lw=0.8, zorder=0)
    axes.set(xlabel=r"$\delta/L$", ylabel=r"$C$  (solid: peak stress, dashed: zero stress)", xlim=(0, 0.5))
    axes.legend(title=r"$\omega\tau_1$", frameon=False, fontsize=8)


def _draw_lengths(axes: Axes, kinds: Mapping[Kind, Mapping[str, Correlations]]) -> None:
    """Draw the zero of the mean of C at peak stress, with its error."""
    for (law, prestress, n, p, _), some in kinds.items():
        mean = correlation_length(some, unstable=True)
        rising = np.argsort(mean.omega)
        axes.errorbar(
            mean.omega[rising],
            mean.length[rising] / mean.L,
            np.nan_to_num(mean.error[rising]) / mean.L,
            fmt="o-",
            ms=4,
            lw=1,
            mfc=None if prestress else "white",
            label=f"{law}, N = {n}, p = {p:g}, {given(prestress)}",
        )
    axes.axhline(0.25, color="0.6", ls=":", lw=0.8, zorder=0)
    axes.set(xscale="log", yscale="log", xlabel=r"$\omega\tau_1$", ylabel=r"$l/L$  (dotted: ¼)")
    axes.set_ylim(bottom=axes.get_ylim()[0] / 3)  # room for the legend
    axes.legend(frameon=False, fontsize=7, loc="lower left")
