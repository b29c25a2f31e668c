"""BT Fig. 1: G* of packings close to jamming over fourteen decades, and how the disks move."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from petscjam.figures.panels import draw_mean, guide
from petscjam.figures.study import Finding, Study
from petscjam.io.jobs import ModulusAnalysis
from petscjam.parallel.comm import on_root
from petscjam.plots.figure import STORAGE, save
from petscjam.plots.modulus import draw_fields
from petscjam.plots.packing import draw_packing
from petscjam.rows.damping import ContactDamping


def draw(study: Study, picture: Path) -> None:
    """Make and draw it."""
    files = study.packings(study["particles"], study.points("pressure"))
    analysis = ModulusAnalysis(study.points("omega"), fields_at=study.points("fields"))
    results = study.results(files, analysis, [ContactDamping()])
    on_root(study.comm, _draw, study, study.tally(results, "G*"), picture)


def _draw(study: Study, results: Mapping[str, Any], picture: Path) -> None:
    from matplotlib.figure import Figure

    some = list(results.values())
    figure = Figure(figsize=(11, 14), layout="constrained")
    halves: Any = figure.subfigures(2, 1, height_ratios=[1, 1.35])
    above, below = halves
    axes = above.subplots()
    pressure = some[0].origin.pressure
    draw_mean(axes, some, STORAGE, f"mean of {len(some)} packings, p = {pressure:.2g}")
    guide(axes, (1e-9, 1e-7), 1e-9, 1, "slope 1")
    guide(axes, (1e-3, 1e-1), 2.5e-3, 0.5, "slope ½")
    axes.set(xlabel=r"$\omega\tau_1$", ylabel=r"$G'$ (●), $G''$ (○)  (units of $k$)")
    axes.set_ylim(top=1e7)
    axes.legend(frameon=False, loc="lower right")
    inset = axes.inset_axes((0.02, 0.56, 0.3, 0.42))
    draw_packing(inset, some[0].geometry, size=3.0)
    inset.set_title("")
    for text in list(inset.texts):
        text.remove()
    draw_fields(below, some[0])
    save(figure, picture)
    omega = some[0].omega
    middle = (omega > 3 * pressure) & (omega < 0.1)
    for name, part in (("G′", np.real), ("G″", np.imag)):
        slopes = [np.polyfit(np.log(omega[middle]), np.log(part(g.values[middle])), 1)[0] for g in some]
        error = np.std(slopes, ddof=1) / len(slopes) ** 0.5 if len(slopes) > 1 else np.nan
        remark = f"ω from {omega[middle][0]:.1e} to {omega[middle][-1]:.1e}"
        study.findings.append(Finding(f"{name} ~ ω^Δ", float(np.mean(slopes)), float(error), "1/2", remark))
