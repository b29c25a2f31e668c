"""Figure of the stress after steps of strain, with the linear relaxation modulus."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from petscjam.analysis.step_strain import StepStrain
from petscjam.plots.figure import STORAGE, heading, legend

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARKERS = "osD^vP"


def step_figure(results: Mapping[str, StepStrain]) -> Figure:
    """Draw [σ(t) − σ(before)]/γ against time for each step, and G(t)."""
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 5.2), layout="constrained")
    axes = figure.subplots()
    steps = sorted({float(a) for r in results.values() for a in r.step})
    for r in results.values():
        axes.plot(r.time, r.linear, "-", color=STORAGE, lw=1, label="linear, $G(t)$")
        for a, row in zip(r.step, r.modulus, strict=True):
            place = steps.index(float(a))
            colour = colormaps["viridis"](0.9 * place / max(len(steps) - 1, 1))
            shown, marker = np.where(row > 0, row, np.nan), MARKERS[place % len(MARKERS)]
            axes.plot(r.time, shown, marker, ms=5, color=colour, label=rf"$\gamma$ = {a:.2g}")
    axes.set(
        xscale="log",
        yscale="log",
        xlabel=r"time after the step $t/\tau_1$",
        ylabel=r"$\Delta\sigma/\gamma$  (units of $k$)",
    )
    axes.set_title(heading(results), fontsize=10)
    legend(axes)
    return figure
