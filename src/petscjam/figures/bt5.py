"""BT Fig. 5: relative normal, relative transverse and non-affine motion against pressure."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.analysis.nonaffine import MOTIONS, quasistatic_response
from petscjam.analysis.statistics import by_pressure, means, nominal
from petscjam.figures.data import FigureData
from petscjam.figures.page import Page
from petscjam.io.jobs import PackingAnalysis
from petscjam.parallel.comm import on_root
from petscjam.plots.figure import save
from petscjam.plots.legends import Shades, axis_label, given
from petscjam.plots.nonaffine import LABELS, STYLES, draw_distribution

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from petscjam.analysis.nonaffine import QuasistaticResponse

LOW = 1e-3  # where corrections to scaling are smaller
PAPER = {"parallel": "1/4", "transverse": "−1/4", "nonaffine": "−1/4"}


def draw(data: FigureData) -> None:
    """Compute and draw the figure."""
    parameters = data.parameters
    files = data.packings(parameters["particles"], parameters.points("pressure"))
    results = data.results(files, PackingAnalysis(quasistatic_response), prestress=(True, False))
    on_root(data.comm, _draw, data.page, data.stable(results, "quasi-static responses"), data.picture)


def _draw(page: Page, results: Mapping[str, QuasistaticResponse], picture: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 9), layout="constrained")
    panels = figure.subplot_mosaic([["median", "mean", "energy"], [*MOTIONS]])
    for prestress in (False, True):
        groups = by_pressure(results.values(), prestress=prestress)
        if not groups:
            continue
        p = np.array(list(groups))
        for motion in MOTIONS:
            colour, marker = STYLES[motion]
            for name, take in (("median", np.median), ("mean", np.mean)):
                samples = [[float(take(r.sizes(motion))) for r in some] for some in groups.values()]
                mean, error = means(samples)
                what = f"{name} of {motion} motion, {given(prestress)}"
                fit = page.exponent(what, p, samples, PAPER[motion])
                page.exponent(f"{what}, p ≤ {LOW:g}", p, samples, PAPER[motion], (float(p.min()), 1.01 * LOW))
                slope = f": {fit.exponent:+.3f} ± {fit.error:.3f}" if fit else ""
                label = f"{LABELS[motion]}, {given(prestress)}{slope}"
                panels[name].errorbar(
                    p, mean, error, fmt=marker, color=colour, ms=5, label=label, mfc=colour if prestress else "white"
                )
                if fit and not prestress:
                    panels[name].plot(p, fit.prefactor * p**fit.exponent, "--", color=colour, lw=1)
        _draw_energy(panels["energy"], p, groups, prestress)
    for name in ("median", "mean"):
        panels[name].set(xscale="log", yscale="log", xlabel=axis_label("pressure"))
        panels[name].set_ylabel(f"{name}, per unit strain  ($d$)")
        panels[name].legend()
    stable = list(results.values())
    shades = Shades("pressure", [nominal(r.origin.pressure) for r in stable])
    for motion in MOTIONS:
        draw_distribution(panels[motion], stable, motion, shades)
    shades.show(panels[MOTIONS[-1]], markers=False)
    save(figure, picture)


def _draw_energy(axes: Axes, p: Any, groups: Mapping[float, list[QuasistaticResponse]], prestress: bool) -> None:
    """Draw the two terms of BT eq. 4: stretching, and the negative term of the pre-stress."""
    for name, sign, marker in (("stretching", 1, "o"), ("pre_stress", -1, "v"), ("shear_modulus", 1, "s")):
        mean, error = means([[sign * getattr(r, name) for r in some] for some in groups.values()])
        if (mean > 0).all():
            text = {"stretching": "stretching", "pre_stress": "− pre-stress term", "shear_modulus": "$G_0$"}[name]
            face, label = None if prestress else "white", f"{text}, {given(prestress)}"
            axes.errorbar(p, mean, error, fmt=marker, ms=5, mfc=face, label=label)
    axes.set(
        xscale="log", yscale="log", xlabel=axis_label("pressure"), ylabel="energy per area and $\\gamma^2/2$  ($k$)"
    )
    axes.legend()
