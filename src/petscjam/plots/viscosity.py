"""Figure of viscosities: η0 against pressure, for every size and law."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike

import numpy as np

from petscjam.analysis.viscosity import Viscosity
from petscjam.plots.figure import errors, given, save, solids


def plot_viscosity(results: Mapping[str, Viscosity], path: str | PathLike[str]) -> None:
    """Draw the mean of η0 over stable packings (over all where none is), with its standard error.

    Raises
    ------
    InputError
        If the figure cannot be written.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 5.2), layout="constrained")
    axes = figure.subplots()
    curves: dict[tuple[str, int, bool], dict[float, list[float]]] = {}
    kept, title = solids(results)
    for r in kept.values():
        curve = curves.setdefault((str(r.damping), r.packing["particles"], r.prestress), {})
        curve.setdefault(float(f"{r.packing['pressure']:.1e}"), []).append(r.eta0)
    for (law, n, prestress), curve in sorted(curves.items()):
        p = np.array(sorted(curve))
        axes.errorbar(
            p,
            *errors([curve[x] for x in p]),
            fmt="o-" if prestress else "s--",
            mfc=None if prestress else "white",
            ms=5,
            lw=1,
            label=f"{law}, N = {n}, {given(prestress)}",
        )
    axes.set(xscale="log", yscale="log", xlabel="pressure $p$", ylabel=r"$\eta_0$  (units of $k\tau_1$)")
    axes.set_title(title, fontsize=10)
    axes.legend(frameon=False, fontsize=8)
    save(figure, path, results)
