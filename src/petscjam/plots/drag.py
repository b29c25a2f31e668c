"""Figure of nonlinear drag: G′, G″ and the friction time against frequency, for one time, for many and without."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.analysis.drag import NonlinearModulus
from petscjam.plots.figure import UNSTABLE, Colour
from petscjam.plots.legends import Shades, heading, number

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
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 4.6), layout="constrained")
    panels = figure.subplots(1, 3)
    kinds = sorted({(g.alpha, g.stress) for g in results.values()})
    places = Shades("kinds", range(len(kinds)))
    for g in results.values():
        k = kinds.index((g.alpha, g.stress))
        _draw(panels, g, places(k), places.marker(k))
    for k, (alpha, stress) in enumerate(kinds):
        label = rf"$\delta\sigma$ = {number(stress)} $k$, $\alpha$ = {number(alpha)}"
        panels[0].plot([], [], color=places(k), marker=places.marker(k), ms=4, label=label)
    for form in sorted({g.form for g in results.values()}):
        panels[0].plot([], [], STYLE[form], color="0.3", label=form)
    if not all(g.converged.all() for g in results.values()):
        panels[0].plot([], [], "x", color=UNSTABLE, label="not converged")
    for form, alpha in sorted({(g.form, g.alpha) for g in results.values()}):
        _guides(panels[1], [g for g in results.values() if (g.form, g.alpha) == (form, alpha)])
    panels[0].legend()
    labels = r"storage modulus $G'$  ($k$)", r"loss modulus $G''$  ($k$)", r"friction time $\tau/\tau_1$"
    for axes, label in zip(panels, labels, strict=True):
        axes.set(xlabel=r"angular frequency $\omega\tau_1$", ylabel=label)
    if any(g.spread.any() for g in results.values()):
        panels[2].set_title(r"band: spread of $\ln\tau_c$ over contacts")
    figure.suptitle(heading(results))
    return figure


def _draw(panels: Sequence[Axes], g: NonlinearModulus, shade: Colour, marker: str) -> None:
    rising = np.argsort(g.omega)
    omega, style = g.omega[rising], STYLE[g.form]
    for axes, values in zip(panels, (g.values.real, g.values.imag, g.tau), strict=True):
        shown = np.where(values > 0, values, np.nan)[rising]
        axes.loglog(omega, shown, style, color=shade, lw=1.3, marker=marker, ms=4)
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
        if at == middle == low and slope != g.alpha:
            continue
        span = g.omega[at] * np.array([1, min(reach, g.omega.max() / g.omega[at])])
        guide = above * abs(g.values.imag[at]) * (span / span[0]) ** slope
        axes.loglog(span, guide, STYLE[g.form], color="0.5", lw=1)
        end, shift, side = (1, (-4, 0), "right") if above > 1 else (0, (6, -10), "left")
        style: dict[str, Any] = {"color": "0.4", "fontsize": 8, "textcoords": "offset points", "ha": side}
        axes.annotate(f"slope ${text}$", (span[end], guide[end]), shift, **style)
