"""Figure of oscillations at finite amplitude, with the linear response."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from petscjam.analysis.oscillation import DEPARTS, Oscillations
from petscjam.base.types import Array
from petscjam.plots.figure import LOSS, STORAGE
from petscjam.plots.legends import Shades, heading, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROUNDING = 1e-8  # of G″, relative to |G*|
LOOPS = 6  # largest number of amplitudes with loops


def oscillation_figure(results: Mapping[str, Oscillations]) -> Figure:
    """Draw G* against ω; against γ0 its ratio to the linear response, harmonics, contact changes and return; loops.

    The quasi-static limit ω = 0 is a decade below the lowest other frequency.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(16.0, 9.0), layout="constrained")
    (moduli, ratio, slow), (higher, motion, fast) = figure.subplots(2, 3)
    gammas = Shades("amplitude", [float(a) for r in results.values() for a in r.amplitude])
    omegas = Shades("omega", [float(w) for r in results.values() for w in r.omega])
    left = min((w for w in omegas.values if w > 0), default=1.0) / 10

    for r in results.values():
        x = np.where(r.omega > 0, r.omega, left)
        moduli.plot(x, r.linear.real, "-", color=STORAGE, lw=1, label="$G'$, linear")
        moduli.plot(x, _loss(r.linear), "--", color=LOSS, lw=1, label="$G''$, linear")
        for a, row in zip(r.amplitude.tolist(), r.values, strict=True):
            look = {"ms": 5, "ls": "", **gammas.look(a)}
            moduli.plot(x, row.real, **look)
            moduli.plot(x, _loss(row), mfc="white", **look)
        for w, omega in enumerate(r.omega.tolist()):
            gamma, line = r.amplitude, {"lw": 0.8, "ms": 5, **omegas.look(omega)}
            ratio.plot(gamma, (r.values[:, w] / r.linear[w]).real, **line)
            for axes, pair in ((higher, np.abs(r.higher / r.values)), (motion, (r.contact_events, r.returns))):
                full, open_ = (np.where(y[:, w] > 0, y[:, w], np.nan) for y in pair)
                axes.plot(gamma, full, **line)
                axes.plot(gamma, open_, ls="--", mfc="white", **line)
    frequency, amplitude = r"angular frequency $\omega\tau_1$", r"amplitude $\gamma_0$"
    moduli.set(xscale="log", yscale="log", xlabel=frequency, ylabel=r"$G',\;G''$  ($k$)")
    quasistatic = r", leftmost: $\omega = 0$" if omegas.values[0] == 0 else ""
    moduli.set_title(f"filled: $G'$, open: $G''${quasistatic}")
    for level in (1 - DEPARTS, 1 + DEPARTS):
        ratio.axhline(level, color="0.7", lw=0.8, ls="--")
    ratio.set(xscale="log", xlabel=amplitude, ylabel=r"Re [$G^*(\gamma_0)/G^*_{\rm linear}$]")
    higher.set(xscale="log", yscale="log", xlabel=amplitude, ylabel=r"harmonics $|G_n|/|G^*|$")
    higher.set_title("filled: n = 3, open: n = 5")
    motion.set(xscale="log", yscale="log", xlabel=amplitude, ylabel="in the last cycle, if not 0")
    motion.set_title(r"filled: contact changes/contacts, open: displacement/($\gamma_0 d$)")
    gammas.show(moduli, "")
    omegas.show(ratio)
    first = next(iter(results.values()))
    _draw_loops(slow, first, int(np.argmin(first.omega)), gammas)
    _draw_loops(fast, first, int(np.argmax(first.omega)), gammas)
    masses = ", ".join(dict.fromkeys(f"{r.mass:g}" for r in results.values()))
    figure.suptitle(rf"{heading(results)}, mass {masses} $k\tau_1^2$")
    return figure


def _loss(moduli: NDArray[np.complex128]) -> Array:
    """Return G″; NaN where it is a rounding error."""
    return np.where(moduli.imag > ROUNDING * abs(moduli), moduli.imag, np.nan)


def loop(r: Oscillations, a: int, w: int) -> tuple[Array, Array]:
    """Return γ/γ0 and σ/(γ0|G*|) over a cycle, with the harmonics 1, 3 and 5, closed.

    Parameters
    ----------
    r : Oscillations
    a, w : int
        Amplitude and frequency.
    """
    phase = np.linspace(0, 2 * np.pi, 401)
    moduli = r.values[a, w], *r.higher[:, a, w]
    stress = np.sum([(G * np.exp(1j * n * phase)).imag for n, G in zip((1, 3, 5), moduli, strict=True)], axis=0)
    return np.sin(phase), stress / abs(r.values[a, w])


def _draw_loops(axes: Axes, r: Oscillations, w: int, gammas: Shades) -> None:
    """Draw stress against strain at some amplitudes, the smallest (dark) and the largest among them."""
    for a in np.unique(np.linspace(0, len(r.amplitude) - 1, LOOPS).round().astype(int)).tolist():
        gamma = float(r.amplitude[a])
        axes.plot(*loop(r, a, w), lw=1.2, ms=4, **gammas.look(gamma), markevery=50)
    axes.set(xlabel=r"strain $\gamma/\gamma_0$", ylabel=r"stress $\sigma/(\gamma_0|G^*|)$")
    axes.set_title(rf"loops (n = 1, 3, 5), $\omega\tau_1$ = {number(float(r.omega[w]))}")
