"""BT Fig. 8: finite-size scaling of the viscosity η0."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.analysis.scaling import Curve, collapse, finite_size
from petscjam.analysis.statistics import by_pressure, means
from petscjam.analysis.viscosity import viscosity
from petscjam.figures.data import FigureData
from petscjam.figures.page import Page
from petscjam.io.jobs import PackingAnalysis
from petscjam.parallel.comm import on_root
from petscjam.plots.figure import save
from petscjam.plots.legends import Shades, given, law_text
from petscjam.rows.damping import ContactDamping, DampingLaw, StokesDrag

if TYPE_CHECKING:
    from petscjam.analysis.viscosity import Viscosity

EXPONENTS = {ContactDamping(): 1.0, StokesDrag(): 1.09}  # the exponent a of the paper for each law
LOW = 1e-3  # pressure below which corrections to scaling are smaller
BULK = 100.0  # pN² above which the number of disks should not matter
LARGE = 50.0  # smallest pN² for the fit of η0 against N


def draw(data: FigureData) -> None:
    """Compute and draw the figure."""
    parameters = data.parameters
    results: dict[str, Any] = {}
    pressures, fewer = parameters.points("pressure"), parameters.points("large_pressure")
    for n in parameters.points("particles").astype(int).tolist():
        files = data.packings(n, fewer if n >= parameters["large"] else pressures)
        made = data.results(files, PackingAnalysis(viscosity), list(EXPONENTS), (True, False), tag=f"N{n}")
        results |= {f"{n} {name}": v for name, v in data.stable(made, f"η0, N = {n}").items()}
    on_root(data.comm, _draw, data.page, results, data.picture)


def _draw(page: Page, results: Mapping[str, Viscosity], picture: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 5.6), layout="constrained")
    for axes, (law, a) in zip(figure.subplots(1, 2), EXPONENTS.items(), strict=True):
        for prestress in (False, True):
            curves = _curves(results, law, prestress)
            _find(page, curves, law, a, prestress)
            if not prestress:
                _intensive(page, curves, law)
            shades = Shades("particles", curves)
            for n, groups in curves.items():
                p = np.array(list(groups))
                y, error = np.array(means(groups.values())) / n**a
                face, label = shades(n) if prestress else "white", f"N = {n}, {given(prestress)}"
                axes.errorbar(p * n**2, y, error, ls="", ms=5, mfc=face, label=label, **shades.look(n))
        x = np.array([1e2, 1e5])
        axes.plot(x, 1.2 * x ** (-a / 2), "k--", lw=1, label=f"slope −a/2, a = {a:g}")
        axes.set(xscale="log", yscale="log", xlabel="$pN^2$  ($k$)", ylabel=rf"$\eta_0/N^a$, a = {a:g}  ($k\tau_1$)")
        axes.set_title(law_text(law))
        axes.legend(ncols=2)
    save(figure, picture)


def _curves(results: Mapping[str, Viscosity], law: DampingLaw, prestress: bool) -> dict[int, dict[float, list[float]]]:
    """Return η0 of the packings by number of disks and pressure, with at least two packings."""
    sizes = sorted({v.origin.particles for v in results.values()})
    curves = {}
    for n in sizes:
        own = [v for v in results.values() if v.origin.particles == n]
        groups = by_pressure(own, prestress=prestress, damping=law)
        curves[n] = {p: [v.eta0 for v in some] for p, some in groups.items() if len(some) > 1}
    return curves


def _intensive(page: Page, curves: Mapping[int, Any], law: DampingLaw) -> None:
    """Note the dependence of η0 on the number of disks at large pN²: x = 0 if η0 is intensive."""
    for p in sorted({p for groups in curves.values() for p in groups}):
        sizes = [n for n, groups in curves.items() if p in groups and p * n**2 >= LARGE]
        if len(sizes) > 2:
            samples = [curves[n][p] for n in sizes]
            page.exponent(f"η0 ~ N^x, {law}, without pre-stress, p = {p:.2g}", sizes, samples, "0, or a − 1")


def _find(page: Page, curves: Mapping[int, Any], law: DampingLaw, a: float, prestress: bool) -> None:
    """Note a of the best collapse, and the exponent of the largest size alone, for two windows of p."""
    for most, window in ((np.inf, ""), (1.01 * LOW, f", p ≤ {LOW:g}")):
        how = f"{law}, {given(prestress)}{window}"
        kept = {n: {p: some for p, some in groups.items() if p <= most} for n, groups in curves.items()}
        some = []
        for n, groups in kept.items():
            if len(groups) < 2:
                continue
            count = min(map(len, groups.values()))
            page.tallies.append(f"Collapse, {how}, N = {n}: {count} stable packings of each pressure.")
            samples = np.array([values[:count] for values in groups.values()]).T
            some.append(Curve(np.array(list(groups)), samples, {"N": float(n)}))
        page.collapse(how, partial(collapse, some, finite_size, {"a": 1.0}), {"a": f"{a:g}"})
        n = max(kept, default=0)
        if not kept.get(n):
            continue
        p = np.array(list(kept[n]))
        bulk = BULK / n**2, float(p.max())
        page.exponent(f"η0 ~ p^x, {how}, N = {n}", p, list(kept[n].values()), "−1/2", bulk)
