"""Figure: the lowest modes, drawn, and frequency, participation and floppiness of all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.plots.figure import STORAGE, UNSTABLE, arrows, draw_cell, scale_bar
from petscjam.plots.legends import Families, heading, number
from petscjam.response.modes import Modes
from petscjam.response.relaxations import RelaxationModes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase

DRAWN = 4
FEW = 6  # packings with large symbols


def modes_figure(results: Mapping[str, Modes]) -> Figure:
    """Draw the lowest four modes of the first packing, and the spectra of all packings."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.6, 8.0), layout="constrained")
    halves: Any = figure.subfigures(1, 2, width_ratios=[1.75, 1])
    left, right = halves
    name, first = next(iter(results.items()))
    titles = [
        f"mode {k + 1}: $\\lambda$ = {number(first.eigenvalues[k])} $k$\n"
        f"participation {first.participation[k]:.2f}, floppiness {first.floppiness[k]:.1f}"
        for k in range(min(DRAWN, len(first.eigenvalues)))
    ]
    _draw_vectors(left, first, titles)
    left.suptitle(f"{name}\n" * (len(results) > 1) + heading({name: first}))
    panels = right.subplots(3, 1)
    _draw_spectra(panels, results)
    return figure


def relaxations_figure(results: Mapping[str, RelaxationModes]) -> Figure:
    """Draw the four slowest relaxations of the first packing, and the weights of all against their times."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.6, 7.0), layout="constrained")
    halves: Any = figure.subfigures(1, 2, width_ratios=[1.75, 1.2])
    left, right = halves
    name, first = next(iter(results.items()))
    titles = [
        rf"$\tau$ = {number(tau)} $\tau_1$, weight {number(float(f'{g:.2g}'))} $k$"
        for tau, g in zip(first.times.tolist(), first.weights.tolist(), strict=True)
    ]
    _draw_vectors(left, first, titles)
    left.suptitle(f"{name}\n" * (len(results) > 1) + heading({name: first}))
    axes, families = right.subplots(), Families(results)
    for family in families.members:
        for r in family.results.values():
            axes.loglog(r.times, r.weights, family.marker or "o", color=family.colour, ms=4)
    axes.set(xlabel=r"relaxation time $\tau/\tau_1$", ylabel="weight  ($k$)")
    axes.set_title(heading(results) if len(results) > 1 else "")
    families.show(axes)
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
        scale_bar(axes, packing.mean_diameter)


def _draw_spectra(panels: Sequence[Axes], results: Mapping[str, Modes]) -> None:
    families = Families(results)
    few = len(results) <= FEW
    drawn = [(family, m) for family in families.members for m in family.results.values()]
    for family, m in drawn:
        index, omega = np.arange(1, len(m.eigenvalues) + 1), np.abs(m.frequencies)
        stable = m.eigenvalues >= 0
        style: dict[str, Any] = {"color": family.colour, "ms": 4 if few else 2.5, "alpha": 0.9 if few else 0.6}
        for axes, across, up in (
            (panels[0], index, omega),
            (panels[1], omega, m.participation),
            (panels[2], omega, m.floppiness),
        ):
            axes.plot(across[stable], up[stable], family.marker or "o", mew=0, **style)
            axes.plot(across[~stable], up[~stable], "x", **{**style, "color": UNSTABLE})
    frequency = r"frequency $\sqrt{\lambda}$  ($\sqrt{k/m}$)"
    panels[0].set(xscale="log", yscale="log", xlabel="index of the mode", ylabel=frequency)
    panels[1].set(xscale="log", xlabel=frequency, ylabel="participation ratio")
    panels[1].set_ylim(bottom=0)
    panels[2].set(xscale="log", yscale="log", xlabel=frequency)
    panels[2].set_ylabel(r"floppiness $(\Sigma\,\Delta u_\perp^2/\Sigma\,\Delta u_\parallel^2)^{1/2}$")
    if any((m.eigenvalues < 0).any() for m in results.values()):
        panels[0].plot([], [], "x", color=UNSTABLE, label=r"$\lambda < 0$, drawn at $\sqrt{|\lambda|}$")
    families.show(panels[0])
