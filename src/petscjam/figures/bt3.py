"""BT Fig. 3: G* under contact damping at several pressures, and its collapse.

Axes: w frequency, k packing, q quantity (G′, G″).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.analysis.scaling import Curve, collapse, critical, local_slope
from petscjam.analysis.statistics import by_pressure
from petscjam.figures.data import FigureData
from petscjam.figures.page import Finding, Page
from petscjam.figures.panels import draw_mean, guide
from petscjam.io.jobs import ModulusAnalysis
from petscjam.parallel.comm import on_root
from petscjam.plots.figure import save
from petscjam.plots.legends import Shades, given, law_text, setting
from petscjam.rows.damping import ContactDamping, DampingLaw

if TYPE_CHECKING:
    from petscjam.response.result import ComplexModulus

AFFINE = 0.05  # τ1 ω above which the response is no longer critical: BT, "for ω < O(1)"


def draw(data: FigureData) -> None:
    """Compute and draw the figure."""
    parameters = data.parameters
    files = data.packings(parameters["particles"], parameters.points("pressure"))
    results = data.results(files, ModulusAnalysis(parameters.points("omega")), [ContactDamping()], (True, False))
    on_root(data.comm, draw_collapse, data.page, data.stable(results, "G*"), ContactDamping(), data.picture)


def draw_collapse(
    page: Page, results: Mapping[str, ComplexModulus], law: DampingLaw, picture: Path, affine: float = AFFINE
) -> None:
    """Draw G* raw and collapsed, top with pre-stress, bottom without; note the exponents (BT fig. 3).

    Parameters
    ----------
    page : Page
    results : mapping of str to ComplexModulus
    law : DampingLaw
    picture : Path
    affine : float
        Frequency above which the response is not critical, 1/τ1.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 9.5), layout="constrained")
    panels = figure.subplots(2, 2)
    for row, prestress in zip(panels, (True, False), strict=True):
        groups = by_pressure(results.values(), prestress=prestress)
        if not groups:
            continue
        exponents(page, groups, given(prestress), affine)
        shades = Shades("pressure", groups)
        for p, some in groups.items():
            look: dict[str, Any] = {"colour": shades(p), "marker": shades.marker(p)}
            draw_mean(row[0], some, label=f"{setting('pressure', p)} ({len(some)})", **look)
            draw_mean(row[1], some, label="", x=1 / p, y=p**-0.5, most=affine, **look)
        guide(row[0], (1e-6, 1e-4), 8e-7, 1, "slope 1")
        guide(row[1], (1e-2, 0.3), 8e-4, 1, "slope 1")
        guide(row[1], (30, 1e3), 0.5, 0.5, "slope ½")
        row[0].set(xlabel=r"$\omega\tau_1$", ylabel=r"$G'$ (●), $G''$ (○)  ($k$)")
        row[0].set_title(f"{law_text(law)}, {given(prestress)}, (number of packings)")
        row[0].legend()
        row[1].set(xlabel=r"$\omega\tau_1/p$  ($1/k$)", ylabel=r"$G'/p^{1/2}$ (●), $G''/p^{1/2}$ (○)  ($k^{1/2}$)")
        row[1].set_title(rf"collapse with the paper's exponents, $\omega\tau_1 \leq$ {affine:g}")
    save(figure, picture)


def exponents(page: Page, groups: Mapping[float, list[ComplexModulus]], how: str, affine: float) -> None:
    """Note μ, λ and Δ from the limits, from the collapse, and from slopes in the middle of the critical regime.

    Parameters
    ----------
    page : Page
    groups : mapping of float to list of ComplexModulus
        By pressure.
    how : str
        With or without pre-stress, for the names.
    affine : float
        Frequency above which the response is not critical, 1/τ1.
    """
    p = np.array(list(groups))
    page.exponent(f"μ, G0 ~ p^μ, {how}", p, [[g.G0 for g in some] for some in groups.values()], "1/2")
    page.exponent(f"η0 ~ p^(μ−λ), {how}", p, [[g.eta0 for g in some] for some in groups.values()], "−1/2")
    times = [[g.eta0 / g.G0 for g in some] for some in groups.values()]
    page.exponent(f"−λ, τ* = η0/G0 ~ p^−λ (medians), {how}", p, times, "−1", estimator="median")
    for name, most_p, most_omega in (("", np.inf, affine), (", p ≤ 1e-3, ω ≤ 0.01", 1.01e-3, 0.01)):
        _collapsed(page, {x: some for x, some in groups.items() if x <= most_p}, most_omega, how + name)
    lowest = groups[p.min()]
    middle = float(np.sqrt(p.min() * affine))
    for name, part in (("G′", np.real), ("G″", np.imag)):
        slopes = [_slope(g.model, part, middle) for g in lowest]
        remark = f"d ln {name}/d ln ω at ω = {middle:.1e}, p = {p.min():.2g}"
        page.mean(f"Δ of {name}, {how}", slopes, "1/2", remark)


def _collapsed(page: Page, groups: Mapping[float, list[ComplexModulus]], most: float, how: str) -> None:
    """Note μ, λ and Δ = μ/λ of the collapse of G′ and G″ below the frequency ``most``."""
    curves = [
        Curve(some[0].omega[kept], np.array([[g.values.real[kept], g.values.imag[kept]] for g in some]), {"p": x})
        for x, some in groups.items()
        if len(some) > 1
        for kept in [some[0].omega <= most]
    ]
    found = page.collapse(
        f"collapse, {how}", lambda: collapse(curves, critical, {"mu": 0.5, "lam": 1.0}), {"mu": "1/2", "lam": "1"}
    )
    if found:
        delta = found.resampled[:, 0] / found.resampled[:, 1]
        value = found.exponents["mu"] / found.exponents["lam"]
        page.findings.append(Finding(f"collapse, {how}: Δ = μ/λ", value, float(delta.std()), "1/2"))


def _slope(model: Any, part: Any, omega: float) -> float:
    return float(local_slope(lambda w: part(model(w)), omega))
