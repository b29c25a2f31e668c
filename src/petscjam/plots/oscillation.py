"""Figure of oscillations at finite amplitude, with the linear response."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from petscjam.analysis.oscillation import DEPARTS, Oscillations
from petscjam.plots.figure import LOSS, MARKERS, STORAGE, heading, legend, place_colour

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def oscillation_figure(results: Mapping[str, Oscillations]) -> Figure:
    """Draw G* against ω, its ratio to the linear response, harmonics, and contact changes and return, against γ0."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.5, 9.0), layout="constrained")
    (moduli, ratio), (higher, motion) = figure.subplots(2, 2)
    gammas = sorted({float(a) for r in results.values() for a in r.amplitude})
    omegas = sorted({float(w) for r in results.values() for w in r.omega})

    for r in results.values():
        for values, style, name in ((r.linear.real, STORAGE, "$G'$"), (r.linear.imag, LOSS, "$G''$")):
            moduli.plot(r.omega, values, "-", color=style, lw=1, label=f"{name}, linear")
        for a, row in zip(r.amplitude, r.values, strict=True):
            shade = place_colour(gammas, a)
            moduli.plot(r.omega, row.real, "o", ms=5, color=shade, label=rf"$\gamma_0$ = {a:.2g}")
            moduli.plot(r.omega, row.imag, "s", ms=5, color=shade, mfc="white")
        for w, omega in enumerate(r.omega):
            shade, marker = place_colour(omegas, omega), MARKERS[omegas.index(omega) % len(MARKERS)]
            x, line = r.amplitude, {"color": shade, "lw": 0.8, "ms": 5}
            label = rf"$\omega\tau_1$ = {omega:.2g}"
            ratio.plot(x, (r.values[:, w] / r.linear[w]).real, f"{marker}-", label=label, **line)
            for axes, pair in ((higher, np.abs(r.higher / r.values)), (motion, (r.contact_events, r.returns))):
                full, open_ = (np.where(y[:, w] > 0, y[:, w], np.nan) for y in pair)
                axes.plot(x, full, f"{marker}-", **line)
                axes.plot(x, open_, f"{marker}--", mfc="white", **line)
    moduli.set(
        xscale="log", yscale="log", xlabel=r"angular frequency $\omega\tau_1$", ylabel=r"$G',\;G''$  (units of $k$)"
    )
    moduli.set_title("filled: $G'$, open: $G''$", fontsize=10)
    for level in (1 - DEPARTS, 1 + DEPARTS):
        ratio.axhline(level, color="0.7", lw=0.8, ls="--")
    ratio.set(xscale="log", xlabel=r"amplitude $\gamma_0$", ylabel=r"Re [$G^*(\gamma_0)/G^*_{\rm linear}$]")
    higher.set(xscale="log", yscale="log", xlabel=r"amplitude $\gamma_0$", ylabel=r"$|G_n|/|G^*|$")
    higher.set_title("filled: n = 3, open: n = 5", fontsize=10)
    motion.set(xscale="log", yscale="log", xlabel=r"amplitude $\gamma_0$", ylabel="in the last cycle, if not 0")
    motion.set_title(r"filled: contact changes/contacts, open: displacement/($\gamma_0 d$)", fontsize=10)
    legend(moduli)
    legend(ratio)
    masses = ", ".join(dict.fromkeys(f"{r.mass:g}" for r in results.values()))
    figure.suptitle(f"{heading(results)}; mass {masses} $k\\tau_1^2$", fontsize=11)
    return figure
