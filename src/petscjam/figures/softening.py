"""Where linear response ends in quasi-static shear, against pressure (Boschan et al., Soft Matter 12, 5450: γ† ~ p)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from petscjam.analysis.aqs import ShearPath, aqs
from petscjam.analysis.statistics import by_pressure, standard_error
from petscjam.figures.data import FigureData
from petscjam.figures.page import Page
from petscjam.figures.panels import guide
from petscjam.io.jobs import PackingAnalysis
from petscjam.parallel.comm import on_root
from petscjam.plots.figure import save
from petscjam.plots.legends import Shades, setting


def draw(data: FigureData) -> None:
    """Compute and draw the figure."""
    p = data.parameters
    paths: dict[str, ShearPath] = {}
    for pressure in p.points("pressure").tolist():
        files = data.packings(p["particles"], [pressure])
        strain = p["span"] * pressure
        analysis = PackingAnalysis(aqs, {"strain": strain, "step": strain / 100, "locate": False})
        found = data.results(files, analysis, tag=f"p{pressure:.3g}")
        paths |= data.stable(found, "secant modulus")
    on_root(data.comm, _draw, data.page, paths, p.points("parts").tolist(), data.picture)


def _draw(page: Page, paths: Mapping[str, ShearPath], parts: list[float], picture: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.5, 5.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    groups = by_pressure(paths.values())
    shades = Shades("pressure", groups)
    for pressure, some in groups.items():
        ends = min(float(np.abs(path.gamma[-1])) for path in some)
        grid = np.linspace(0, ends, 101)[1:]
        ratios = np.array([np.interp(grid, np.abs(path.gamma), path.secant / path.G0) for path in some])
        middle, error = np.median(ratios, axis=0), np.nan_to_num(standard_error(ratios))
        look = {"markevery": 20, "ms": 4, **shades.look(pressure)}
        left.semilogx(grid / pressure, middle, "-", label=f"{setting('pressure', pressure)} ({len(some)})", **look)
        left.fill_between(grid / pressure, middle - error, middle + error, color=shades(pressure), alpha=0.2, lw=0)
    left.set(xlabel=r"$\gamma/p$  ($1/k$)", ylabel=r"$[\sigma(\gamma)-\sigma(0)]/(\gamma G_0)$, median", ylim=(0, 2))
    left.legend()
    pressures = list(groups)
    for part, marker in zip(parts, "os^D", strict=False):
        onsets = [np.array([path.onset(part) for path in some]) for some in groups.values()]
        known = [values[np.isfinite(values)] for values in onsets]
        for pressure, values, found in zip(pressures, onsets, known, strict=True):
            if len(found) < len(values):
                count = f"{len(found)} of {len(values)} packings"
                page.tallies.append(f"p = {pressure:.3g}: the secant modulus departs by {part:g} in {count}.")
        fit = page.exponent(f"γ† ~ p^x, departure {part:g}", pressures, known, "1", estimator="median")
        there = [len(some) > 0 for some in known]
        y = np.array([np.median(some) for some in known if len(some)])
        errors = np.array([standard_error(some) if len(some) > 1 else 0.0 for some in known if len(some)])
        x = np.array(pressures)[there]
        right.errorbar(x, y, np.minimum(errors, 0.9 * y), fmt=marker, ms=5, label=f"departure {part:g}")
        for row in zip(x, y, errors, strict=True):
            page.number(f"γ†, departure {part:g}, against p", *row)
        if fit is not None:
            right.plot(x, fit.prefactor * x**fit.exponent, "-", lw=0.8, color="0.5")
    guide(right, (min(pressures), max(pressures)), min(pressures), 1, r"$\gamma^\dagger = p$")
    right.set(xscale="log", yscale="log", xlabel="pressure $p$  ($k$)")
    right.set_ylabel(r"$\gamma^\dagger$, median over packings")
    right.legend()
    save(figure, picture)
