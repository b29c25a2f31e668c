"""Figure of nonlinear drag: G′, G″ and the friction time against frequency, for one time, for many and without."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.analysis.drag import NonlinearModulus
from petscjam.plots.figure import UNSTABLE, given

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STYLE = {"uniform": "--", "per contact": "-", "direct": ":"}
CRITICAL: dict[str, tuple[Callable[[float], float], str]] = {
    "uniform": (lambda alpha: alpha / 2, r"\alpha/2"),
    **dict.fromkeys(("per contact", "direct"), (lambda alpha: 2 * alpha / (1 + 3 * alpha), r"2\alpha/(1+3\alpha)")),
}  # of G* against ω in the critical regime: docs/howto/drag.md


def drag_figure(results: Mapping[str, NonlinearModulus]) -> Figure:
    """Draw G′, G″ and τ of every result: colours for stress and exponent, dashes for the form."""
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
    for form, alpha in sorted({(g.form, g.alpha) for g in results.values()}):
        _guides(panels[1], [g for g in results.values() if (g.form, g.alpha) == (form, alpha)])
    panels[0].legend(frameon=False, fontsize=8)
    for axes, name in zip(panels, (r"$G'$  (units of $k$)", r"$G''$  (units of $k$)", r"$\tau/\tau_1$"), strict=True):
        axes.set(xlabel=r"angular frequency $\omega\tau_1$", title=name)
    panels[2].set_title(r"friction time $\tau/\tau_1$; band: spread of $\ln\tau_c$")
    first = next(iter(results.values()))
    figure.suptitle(
        f"{first.origin.particles} disks, p = {first.origin.pressure:.3g}; {first.strain}; {given(first.prestress)}",
        fontsize=10,
    )
    return figure


def _draw(panels: Sequence[Axes], g: NonlinearModulus, shade: Any) -> None:
    rising = np.argsort(g.omega)
    omega, style = g.omega[rising], STYLE[g.form]
    for axes, values in zip(panels, (g.values.real, g.values.imag, g.tau), strict=True):
        axes.loglog(omega, np.where(values > 0, values, np.nan)[rising], style, color=shade, lw=1.3)
        lost = ~g.converged
        axes.loglog(g.omega[lost], values[lost], "x", color=UNSTABLE)
    if g.spread.any():
        factor = np.exp(g.spread[rising])
        panels[2].fill_between(omega, g.tau[rising] / factor, g.tau[rising] * factor, color=shade, alpha=0.15, lw=0)


def _guides(axes: Axes, alike: list[NonlinearModulus]) -> None:
    """Draw the expected slopes next to G″: quasi-static, and for G′ ≈ G″."""
    first, last = min(alike, key=lambda g: g.stress), max(alike, key=lambda g: g.stress)
    if len(first.omega) < 3 or first.alpha == 1:
        return
    power, name = CRITICAL[first.form]
    g, above = (first, 2.0) if first.form == "uniform" else (last, 0.5)
    middle = int(np.argmin(abs(np.log(abs(g.values.imag / g.values.real)))))
    low = int(np.argmin(g.omega))
    for at, reach, slope, text in ((low, 1e3, g.alpha, r"\alpha"), (middle, 1e2, power(g.alpha), name)):
        span = g.omega[at] * np.array([1, reach])
        guide = above * abs(g.values.imag[at]) * (span / span[0]) ** slope
        axes.loglog(span, guide, STYLE[g.form], color="0.5", lw=1)
        end, shift, side = (1, (-4, 0), "right") if above > 1 else (0, (6, -10), "left")
        style: dict[str, Any] = {"color": "0.4", "fontsize": 8, "textcoords": "offset points", "ha": side}
        axes.annotate(f"slope ${text}$", (span[end], guide[end]), shift, **style)
