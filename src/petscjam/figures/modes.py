"""The number of low modes in the quasi-static response (BT Fig. 5 from modes), and their properties.

Axes: m mode or pressure, k motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.analysis.density import density_of_states, plateau, smoothed
from petscjam.analysis.mode_sum import ModeSum, mode_sum, modes_needed
from petscjam.analysis.nonaffine import MOTIONS
from petscjam.analysis.statistics import binned_medians, by_pressure, means
from petscjam.figures.data import FigureData
from petscjam.figures.page import Page
from petscjam.io.jobs import PackingAnalysis
from petscjam.parallel.comm import on_root
from petscjam.plots.figure import save
from petscjam.plots.legends import Shades, setting
from petscjam.plots.nonaffine import LABELS, STYLES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WITHIN = 0.1  # relative difference from the median of the direct solve for which modes are sufficient


def draw(data: FigureData) -> None:
    """Compute and draw the figure."""
    parameters = data.parameters
    files = data.packings(parameters["particles"], parameters.points("pressure"))
    low = PackingAnalysis(mode_sum, {"count": parameters["count"]})
    modes = data.results(files, low, prestress=(False,), tag="rebuilt")
    every = PackingAnalysis(density_of_states, {"moments": parameters["moments"]})
    density = data.results(files, every, prestress=(False,), tag="density")
    on_root(data.comm, _draw, data.page, modes, density, data.picture)


def _draw(page: Page, modes: Mapping[str, Any], density: Mapping[str, Any], picture: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 9), layout="constrained")
    panels = figure.subplot_mosaic([[*MOTIONS], ["needed", "floppiness", "density"]])
    groups = by_pressure(modes.values())
    shades = Shades("pressure", groups)
    for p, some in groups.items():
        for k, motion in enumerate(MOTIONS):
            count = min(len(r.counts) for r in some)
            share = np.mean([r.counts[:count] / r.modes for r in some], axis=0)
            ratio = np.mean([r.ratios[k, :count] for r in some], axis=0)
            label = f"{setting('pressure', p)} ({len(some)})"
            panels[motion].loglog(share, ratio, color=shades(p), lw=1.2, label=label)
        frequency, floppiness = (np.concatenate([getattr(r, x) for r in some]) for x in ("frequencies", "floppiness"))
        panels["floppiness"].plot(*binned_medians(frequency, floppiness, 39), color=shades(p), lw=1.2)
    for motion in MOTIONS:
        ylabel = f"median of {LABELS[motion]}, over the direct one"
        panels[motion].set(xlabel="share of all modes", ylabel=ylabel)
        panels[motion].axhline(1, color="0.6", lw=0.8)
    panels["nonaffine"].legend(loc="lower right")
    _draw_needed(page, panels["needed"], groups)
    _draw_density(page, panels["density"], by_pressure(density.values()), shades)
    ylabel = r"$(\Sigma\Delta u_\perp^2/\Sigma\Delta u_\parallel^2)^{1/2}$ of a mode"
    panels["floppiness"].set(xscale="log", yscale="log", xlabel=r"$\sqrt{\lambda}$  ($\sqrt{k/m}$)", ylabel=ylabel)
    particles = {r.origin.particles for r in modes.values()}
    figure.suptitle(f"N = {', '.join(map(str, particles))}, without pre-stress; (number of packings)")
    save(figure, picture)


def _draw_needed(page: Page, axes: Axes, groups: Mapping[float, list[ModeSum]]) -> None:
    """Draw the number of modes that is needed, and note its dependence on p."""
    p = np.array(list(groups))
    for k, motion in enumerate(MOTIONS):
        colour, marker = STYLES[motion]
        needed = [[modes_needed(r.ratios[k], r.counts, WITHIN) for r in some] for some in groups.values()]
        known = [m for m, some in enumerate(needed) if np.isfinite(some).all()]
        if not known:
            continue
        samples = [needed[m] for m in known]
        mean, error = means(samples)
        axes.errorbar(p[known], mean, error, fmt=marker, color=colour, label=LABELS[motion])
        page.exponent(f"modes needed for the median of {motion} motion ~ p^x", p[known], samples, "—")
    axes.set(xscale="log", yscale="log", xlabel="pressure $p$  ($k$)", ylabel=f"modes for a median within {WITHIN:.0%}")
    axes.legend()


def _draw_density(page: Page, axes: Axes, groups: Mapping[float, list[Any]], shades: Shades) -> None:
    """Draw the mean density of states over packings; note its plateau, and the onset ω* of the plateau."""
    found = {p: [plateau(r) for r in some] for p, some in groups.items()}
    known = {p: [x.onset for x in some] for p, some in found.items() if np.isfinite([x.onset for x in some]).all()}
    page.exponent("onset ω* of the plateau of D(ω) ~ p^x", list(known), list(known.values()), "1/2")
    for p, plateaus in found.items():
        page.mean(f"plateau of D(ω), p = {p:.2g}", [x.height for x in plateaus], "the same for all p")
    for p, some in groups.items():
        omega = np.geomspace(1e-3, min(r.edge for r in some) * 0.999, 400)
        D, error = smoothed(some, omega)
        axes.loglog(omega, D, color=shades(p), lw=1.2)
        axes.fill_between(omega, np.maximum(D - error, 1e-9), D + error, color=shades(p), alpha=0.2, lw=0)
    axes.set(xlabel=r"$\omega$  ($\sqrt{k/m}$)", ylabel=r"$D(\omega)$  ($\sqrt{m/k}$)", ylim=(1e-2, 2))
