"""BT Fig. 1: G* of packings close to jamming over fourteen decades, and displacements of the disks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from petscjam.analysis.scaling import log_slope
from petscjam.figures.data import FigureData
from petscjam.figures.page import Page
from petscjam.figures.panels import draw_mean, guide
from petscjam.io.jobs import ModulusAnalysis
from petscjam.parallel.comm import on_root
from petscjam.plots.figure import STORAGE, save
from petscjam.plots.legends import setting
from petscjam.plots.modulus import draw_fields
from petscjam.plots.packing import draw_packing
from petscjam.rows.damping import ContactDamping


def draw(data: FigureData) -> None:
    """Compute and draw the figure."""
    parameters = data.parameters
    files = data.packings(parameters["particles"], parameters.points("pressure"))
    analysis = ModulusAnalysis(parameters.points("omega"), fields_at=parameters.points("fields"))
    results = data.results(files, analysis, [ContactDamping()])
    on_root(data.comm, _draw, data.page, data.stable(results, "G*"), data.picture)


def _draw(page: Page, results: Mapping[str, Any], picture: Path) -> None:
    from matplotlib.figure import Figure

    some = list(results.values())
    figure = Figure(figsize=(11, 14), layout="constrained")
    halves: Any = figure.subfigures(2, 1, height_ratios=[1, 1.35])
    above, below = halves
    axes = above.subplots()
    pressure = some[0].origin.pressure
    draw_mean(axes, some, STORAGE, f"mean of {len(some)} packings, {setting('pressure', pressure)}")
    guide(axes, (1e-9, 1e-7), 1e-9, 1, "slope 1")
    guide(axes, (1e-3, 1e-1), 2.5e-3, 0.5, "slope ½")
    axes.set(xlabel=r"$\omega\tau_1$", ylabel=r"$G'$ (●), $G''$ (○)  ($k$)")
    axes.set_ylim(top=1e7)
    axes.legend(loc="lower right")
    inset = axes.inset_axes((0.02, 0.56, 0.3, 0.42))
    draw_packing(inset, some[0].geometry, size=3.0, caption=False)
    draw_fields(below, some[0])
    save(figure, picture)
    omega = some[0].omega
    middle = (omega > 3 * pressure) & (omega < 0.1)
    for name, part in (("G′", np.real), ("G″", np.imag)):
        slopes = [log_slope(omega[middle], part(g.values[middle])) for g in some]
        page.mean(f"{name} ~ ω^Δ", slopes, "1/2", f"ω from {omega[middle][0]:.1e} to {omega[middle][-1]:.1e}")
