"""Figure: densities of states D(ω), with their errors, resolution and plateau."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from petscjam.analysis.density import DensityOfStates, plateau, smoothed
from petscjam.analysis.statistics import means
from petscjam.plots.figure import panel
from petscjam.plots.legends import Families, heading

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def density_figure(results: Mapping[str, DensityOfStates], ax: Axes | None = None) -> Figure:
    """Draw the mean of D(ω) over the packings of each kind ± its standard error, smooth.

    The onset ω* of the plateau is marked at half of its height, and frequencies below the resolution are shaded.

    Parameters
    ----------
    results : mapping of DensityOfStates
    ax
        Of matplotlib: draw here.
    """
    axes, families = panel(ax), Families(results)
    blind = min(float(d.resolution.max()) for d in results.values())
    lowest, top = np.inf, 0.0
    curves = []
    for family in families.members:
        some = list(family.results.values())
        omega = np.geomspace(blind / 3, 0.999 * min(d.edge for d in some), 400)
        curves.append((family, omega, *smoothed(some, omega)))
        top = max(top, float(curves[-1][2].max()))
    for family, omega, D, error in curves:
        lowest = min(lowest, float(omega[D > 3e-3 * top].min()))
        axes.loglog(omega, D, lw=1.3, markevery=40, ms=4, **family.look)
        axes.fill_between(omega, np.maximum(D - error, 1e-9 * top), D + error, color=family.colour, alpha=0.25, lw=0)
        flats = [plateau(d) for d in family.results.values()]
        onsets = [flat.onset for flat in flats if np.isfinite(flat.onset)]
        if onsets:
            (onset,), (scatter,) = means([onsets])
            half = float(np.mean([flat.height for flat in flats])) / 2
            axes.errorbar(onset, half, xerr=np.nan_to_num(scatter), fmt="*", color=family.colour, ms=11, mec="white")
    axes.plot([], [], "*", color="0.4", ms=9, label=r"onset $\omega^*$ of the plateau")
    if lowest < blind:
        axes.axvspan(lowest / 2, blind, color="0.5", alpha=0.18, lw=0, label="below the resolution")
    axes.set(
        xlim=(lowest / 1.2, None),
        ylim=(3e-3 * top, 2 * top),
        xlabel=r"frequency $\omega = \sqrt{\lambda}$  ($\sqrt{k/m}$)",
        ylabel=r"density of states $D(\omega)$  ($\sqrt{m/k}$)",
        title=heading(results),
    )
    families.show(axes)
    return axes.figure  # type: ignore[return-value]
