"""Figure: densities of states D(ω), with their errors, resolution and plateau."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from petscjam.analysis.density import DensityOfStates, plateau
from petscjam.analysis.statistics import nominal

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def density_figure(results: Mapping[str, DensityOfStates]) -> Figure:
    """Draw every D(ω) ± its standard error; ω* is marked, and frequencies below the resolution are shaded."""
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 5.2), layout="constrained")
    axes = figure.subplots()
    pressure = {name: nominal(d.origin.pressure) for name, d in results.items()}
    known = sorted(set(pressure.values()), reverse=True)
    shades = colormaps["viridis"](np.linspace(0, 0.85, len(known)))
    blind = min(float(d.resolution.max()) for d in results.values())
    top = max(float(d.density.max()) for d in results.values())
    labels = set()
    for name, d in results.items():
        colour = shades[known.index(pressure[name])]
        label = f"p = {pressure[name]:.3g}" + ("" if d.prestress else ", no pre-stress")
        omega = np.geomspace(blind / 3, 0.999 * d.edge, 800)
        curve, flat = d.at(omega), plateau(d)
        axes.loglog(
            omega,
            curve.density,
            "-" if d.prestress else "--",
            color=colour,
            lw=1.1,
            label=None if label in labels else label,
        )
        labels.add(label)
        low = np.maximum(curve.density - curve.error, 1e-9 * top)
        axes.fill_between(omega, low, curve.density + curve.error, color=colour, alpha=0.25, lw=0)
        axes.plot(flat.onset, flat.height / 2, "o", color=colour, ms=6, mec="white", zorder=3)
    axes.plot([], [], "o", color="0.4", label=r"$\omega^*$")
    axes.axvspan(blind / 3, blind, color="0.5", alpha=0.18, lw=0, label="below the resolution")
    axes.set(
        xlim=(blind / 3, None),
        ylim=(3e-3 * top, 2 * top),
        xlabel=r"frequency $\omega$, unit masses",
        ylabel=r"$D(\omega)$",
    )
    axes.legend(loc="lower right", bbox_to_anchor=(0.88, 0), frameon=False, fontsize=8)
    return figure
