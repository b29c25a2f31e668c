"""Figure of nonlinear drag: G′, G″ and the friction time against frequency, for one time and for many."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import Any

import numpy as np

from petscjam.analysis.drag import NonlinearModulus
from petscjam.plots.figure import UNSTABLE, save

STYLE = {"uniform": "--", "per contact": "-"}


def plot_drag(results: Mapping[str, NonlinearModulus], path: str | PathLike[str]) -> None:
    """Draw G′, G″ and τ of every result: colours tell stress and exponent, dashes the form.

    Raises
    ------
    InputError
        If the figure cannot be written.
    """
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 4.6), layout="constrained")
    panels = figure.subplots(1, 3)
    kinds = sorted({(g.alpha, g.stress) for g in results.values()})
    shades = colormaps["viridis"](np.linspace(0, 0.85, len(kinds)))
    for g in results.values():
        _draw(panels, g, shades[kinds.index((g.alpha, g.stress))])
    for (alpha, stress), shade in zip(kinds, shades, strict=True):
        panels[0].plot([], [], color=shade, label=rf"$\delta\sigma$ = {stress:.3g}, $\alpha$ = {alpha:.3g}")
    for form in sorted({g.form for g in results.values()}):
        panels[0].plot([], [], STYLE[form], color="0.3", label=form)
    if not all(g.converged.all() for g in results.values()):
        panels[0].plot([], [], "x", color=UNSTABLE, label="not converged")
    for alpha in sorted({alpha for alpha, _ in kinds}):
        for slope, name in ((alpha, r"\alpha"), (alpha / 2, r"\alpha/2")):
            _guide(panels[1], [g for g in results.values() if g.alpha == alpha], slope, name)
    panels[0].legend(frameon=False, fontsize=8)
    for axes, name in zip(panels, (r"$G'$  (units of $k$)", r"$G''$  (units of $k$)", r"$\tau/\tau_1$"),
                          strict=True):  # fmt: skip
        axes.set(xlabel=r"angular frequency $\omega\tau_1$", title=name)
    panels[2].set_title(r"friction time $\tau/\tau_1$; band: spread of $\ln\tau_c$")
    first = next(iter(results.values()))
    figure.suptitle(
        f"{first.packing['particles']} disks, p = {first.packing['pressure']:.3g}; {first.strain}; "
        f"{'with' if first.prestress else 'without'} pre-stress", fontsize=10,
    )  # fmt: skip
    save(figure, path)


def _draw(panels: Any, g: NonlinearModulus, shade: Any) -> None:
    rising = np.argsort(g.omega)
    omega, style = g.omega[rising], STYLE[g.form]
    for axes, values in zip(panels, (g.values.real, g.values.imag, g.tau), strict=True):
        axes.loglog(omega, np.where(values > 0, values, np.nan)[rising], style, color=shade, lw=1.3)
        lost = ~g.converged
        axes.loglog(g.omega[lost], values[lost], "x", color=UNSTABLE)
    if g.spread.any():
        factor = np.exp(g.spread[rising])
        panels[2].fill_between(
            omega, g.tau[rising] / factor, g.tau[rising] * factor, color=shade, alpha=0.15, lw=0
        )


def _guide(axes: Any, some: list[NonlinearModulus], slope: float, name: str) -> None:
    """Draw a slope below the lowest G″, over the lower half of the frequencies."""
    low, high = min(g.omega.min() for g in some), max(g.omega.max() for g in some)
    span = np.array([low, np.sqrt(low * high)])
    guide = 0.4 * min(np.abs(g.values.imag).min() for g in some) * (span / span[0]) ** slope
    axes.loglog(span, guide, color="0.5", lw=1)
    axes.annotate(f"slope ${name}$", (span[1], guide[1]), color="0.4", xytext=(4, -3),
                  textcoords="offset points", fontsize=9)  # fmt: skip
