"""Figure of viscosities: η0 against pressure, for every size and law."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from petscjam.analysis.statistics import alike, means
from petscjam.analysis.viscosity import Viscosity
from petscjam.plots.figure import given, solids

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def viscosity_figure(results: Mapping[str, Viscosity]) -> Figure:
    """Draw the mean of η0 over stable packings (over all if none is stable), with its standard error."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 5.2), layout="constrained")
    axes = figure.subplots()
    kept, title = solids(results)
    curves: dict[tuple[str, int, bool], dict[float, list[float]]] = {}
    for kind, some in sorted(alike(kept).items()):
        curve = curves.setdefault((kind.law, kind.particles, kind.prestress), {})
        curve[kind.pressure] = [r.eta0 for r in some.values()]
    for (law, n, prestress), curve in sorted(curves.items()):
        axes.errorbar(
            list(curve),
            *means(curve.values()),
            fmt="o-" if prestress else "s--",
            mfc=None if prestress else "white",
            ms=5,
            lw=1,
            label=f"{law}, N = {n}, {given(prestress)}",
        )
    axes.set(xscale="log", yscale="log", xlabel="pressure $p$", ylabel=r"$\eta_0$  (units of $k\tau_1$)")
    axes.set_title(title, fontsize=10)
    axes.legend(frameon=False, fontsize=8)
    return figure
