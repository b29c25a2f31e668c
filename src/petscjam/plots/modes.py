"""Figure: the lowest modes, drawn, and frequency, participation and floppiness of all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.plots.figure import STORAGE, UNSTABLE, arrows, draw_cell, given
from petscjam.response.modes import Modes
from petscjam.response.relaxations import RelaxationModes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase

DRAWN = 4
NAMED = 6  # largest number of packings in a legend


def modes_figure(results: Mapping[str, Modes]) -> Figure:
    """Draw the lowest four modes of the first packing, and the spectra of all packings."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.6, 8.0), layout="constrained")
    halves: Any = figure.subfigures(1, 2, width_ratios=[1.75, 1])
    left, right = halves
    name, first = next(iter(results.items()))
    titles = [
        f"mode {k + 1}: λ = {first.eigenvalues[k]:.2e}\n"
        f"participation {first.participation[k]:.2f}, floppiness {first.floppiness[k]:.1f}"
        for k in range(min(DRAWN, len(first.eigenvalues)))
    ]
    _draw_vectors(left, first, titles)
    title = f"{first.origin.particles} disks, p = {first.origin.pressure:.3g}; {given(first.prestress)}"
    left.suptitle(f"{name}: {title}" if len(results) > 1 else title, fontsize=10)
    panels = right.subplots(3, 1)
    _draw_spectra(panels, results)
    return figure


def relaxations_figure(results: Mapping[str, RelaxationModes]) -> Figure:
    """Draw the four slowest relaxations of the first packing, and the weights of all against their times."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.6, 7.0), layout="constrained")
    halves: Any = figure.subfigures(1, 2, width_ratios=[1.75, 1.2])
    left, right = halves
    first = next(iter(results.values()))
    titles = [f"τ = {tau:.3g} τ₁, weight {g:.1e} k" for tau, g in zip(first.times, first.weights, strict=True)]
    _draw_vectors(left, first, titles)
    left.suptitle(f"{first.origin.particles} disks, p = {first.origin.pressure:.3g}, {first.damping}")
    axes = right.subplots()
    for name, r in results.items():
        axes.loglog(r.times, r.weights, "o", ms=3, label=name if len(results) <= NAMED else None)
    axes.set(xlabel=r"relaxation time $\tau/\tau_1$", ylabel="weight (units of $k$)")
    axes.legend(frameon=False, fontsize=7)
    return figure


def _draw_vectors(figure: FigureBase, m: Modes | RelaxationModes, titles: Sequence[str]) -> None:
    """Draw modes as arrows, with the same mean length in each panel unless the longest is too long."""
    packing, panels = m.geometry, figure.subplots(2, DRAWN // 2)
    x = packing.box.wrap(packing.positions)[m.disks]
    spacing = np.sqrt(packing.box.area / len(packing))
    for axes in panels.flat:
        axes.set_axis_off()
    for v, title, axes in zip(m.vectors, titles, panels.flat, strict=False):
        length = np.hypot(*v.T)
        u = v * spacing * min(1.6 / np.sqrt(np.mean(length**2)), 5 / length.max())
        arrows(axes, x, u, width=0.0035, color=STORAGE)
        draw_cell(axes, packing.box)
        axes.set_aspect("equal")
        axes.set_title(title, fontsize=9)


def _draw_spectra(panels: Sequence[Axes], results: Mapping[str, Modes]) -> None:
    from matplotlib import colormaps

    few = len(results) <= NAMED
    colours = [STORAGE] if len(results) == 1 else colormaps["viridis"](np.linspace(0, 0.9, len(results)))
    for (name, m), colour in zip(results.items(), colours, strict=True):
        index, omega = np.arange(1, len(m.eigenvalues) + 1), np.abs(m.frequencies)
        stable = m.eigenvalues >= 0
        style = {"color": colour, "ms": 4 if few else 2.5, "alpha": 0.9 if few else 0.6}
        for axes, across, up in (
            (panels[0], index, omega),
            (panels[1], omega, m.participation),
            (panels[2], omega, m.floppiness),
        ):
            axes.plot(across[stable], up[stable], "o", mew=0, label=name, **style)
            axes.plot(across[~stable], up[~stable], "x", **{**style, "color": UNSTABLE})
    frequency = r"frequency $\sqrt{\lambda}$"
    panels[0].set(xscale="log", yscale="log", xlabel="index of the mode", ylabel=frequency)
    panels[1].set(xscale="log", xlabel=frequency, ylabel="participation ratio")
    panels[1].set_ylim(bottom=0)
    panels[2].set(xscale="log", yscale="log", xlabel=frequency)
    panels[2].set_ylabel(r"floppiness $(\Sigma\,\Delta u_\perp^2/\Sigma\,\Delta u_\parallel^2)^{1/2}$")
    if any((m.eigenvalues < 0).any() for m in results.values()):
        panels[0].plot([], [], "x", color=UNSTABLE, label=r"$\lambda < 0$, drawn at $\sqrt{|\lambda|}$")
    if 1 < len(results) <= NAMED or len(panels[0].get_legend_handles_labels()[0]) > len(results):
        panels[0].legend(frameon=False, fontsize=8)
