"""Figure of the stress after steps of strain, with the linear relaxation modulus."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from petscjam.analysis.step_strain import StepStrain
from petscjam.plots.figure import LOSS, panel
from petscjam.plots.legends import Shades, heading

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def step_figure(results: Mapping[str, StepStrain], ax: Axes | None = None) -> Figure:
    """Draw [σ(t) − σ(before)]/γ against time for each step, and G(t).

    Parameters
    ----------
    results : mapping of StepStrain
    ax
        Of matplotlib: draw here.
    """
    axes = panel(ax)
    shades = Shades("step", [float(a) for r in results.values() for a in r.step])
    for r in results.values():
        axes.plot(r.time, r.linear, "--", color=LOSS, lw=1, label="linear, $G(t)$")
        for a, row in zip(r.step.tolist(), r.modulus, strict=True):
            axes.plot(r.time, np.where(row > 0, row, np.nan), shades.marker(a), ms=5, color=shades(a))
    axes.set(
        xscale="log",
        yscale="log",
        xlabel=r"time after the step $t/\tau_1$",
        ylabel=r"$\Delta\sigma/\gamma$  ($k$)",
        title=heading(results),
    )
    shades.show(axes, "")
    return axes.figure  # type: ignore[return-value]
