"""Figure of viscosities: η0 against pressure, for every size and law."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from petscjam.analysis.statistics import by_pressure, means
from petscjam.analysis.viscosity import Viscosity
from petscjam.plots.figure import panel, solids
from petscjam.plots.legends import Families, axis_label, heading

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def viscosity_figure(results: Mapping[str, Viscosity], ax: Axes | None = None) -> Figure:
    """Draw the mean of η0 over stable packings (over all if none is stable), with its standard error.

    Parameters
    ----------
    results : mapping of Viscosity
    ax
        Of matplotlib: draw here.
    """
    axes = panel(ax)
    kept, note = solids(results)
    families = Families(kept, x="pressure")
    for family in families.members:
        points = by_pressure(family.results.values())
        values = means([r.eta0 for r in some] for some in points.values())
        axes.errorbar(list(points), *values, ms=5, lw=1, capsize=2, **family.look)
    axes.set(xscale="log", yscale="log", xlabel=f"pressure {axis_label('pressure')}")
    axes.set(ylabel=r"viscosity $\eta_0$  ($k\tau_1$)", title=heading(kept) + note)
    families.show(axes)
    return axes.figure  # type: ignore[return-value]
