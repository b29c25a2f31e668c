"""Figure of the stress after steps of strain, with the linear relaxation modulus."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from petscjam.analysis.step_strain import StepStrain
from petscjam.plots.figure import MARKERS, STORAGE, heading, legend, place_colour

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def step_figure(results: Mapping[str, StepStrain]) -> Figure:
    """Draw [σ(t) − σ(before)]/γ against time for each step, and G(t)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 5.2), layout="constrained")
    axes = figure.subplots()
    steps = sorted({float(a) for r in results.values() for a in r.step})
    for r in results.values():
        axes.plot(r.time, r.linear, "-", color=STORAGE, lw=1, label="linear, $G(t)$")
        for a, row in zip(r.step, r.modulus, strict=True):
            shown, marker = np.where(row > 0, row, np.nan), MARKERS[steps.index(float(a)) % len(MARKERS)]
            axes.plot(r.time, shown, marker, ms=5, color=place_colour(steps, a), label=rf"$\gamma$ = {a:.2g}")
    axes.set(
        xscale="log",
        yscale="log",
        xlabel=r"time after the step $t/\tau_1$",
        ylabel=r"$\Delta\sigma/\gamma$  (units of $k$)",
    )
    axes.set_title(heading(results), fontsize=10)
    legend(axes)
    return figure
