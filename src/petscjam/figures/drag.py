"""Nonlinear drag (BT eqs. 27–29): the method of equivalent damping in two forms.

Axes: w frequency, k packing.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.analysis.contact_drag import self_consistent_drag
from petscjam.analysis.drag import NonlinearModulus, equivalent_drag
from petscjam.analysis.scaling import log_slope
from petscjam.analysis.statistics import by_pressure
from petscjam.figures.data import FigureData
from petscjam.figures.page import Page
from petscjam.figures.panels import guide
from petscjam.io.jobs import ModulusAnalysis, PackingAnalysis
from petscjam.parallel.comm import on_root
from petscjam.plots.figure import save
from petscjam.plots.legends import Shades, setting
from petscjam.rows.damping import ContactDamping

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AFFINE = 0.05  # ωτα above which the response is not critical


def draw(data: FigureData) -> None:
    """Compute and draw the figure."""
    parameters = data.parameters
    files = data.packings(parameters["particles"], parameters.points("pressure"))
    analysis: Any = ModulusAnalysis(parameters.points("linear_omega"))
    linear = data.results(files, analysis, [ContactDamping()], (False,), tag="linear")
    contacts = {}
    for alpha in parameters.points("alphas").tolist():
        settings = {"omegas": parameters.points("omega"), "stress": parameters["stress"], "alpha": alpha}
        analysis = PackingAnalysis(self_consistent_drag, settings)
        contacts[alpha] = data.results(files, analysis, prestress=(False,), tag=f"alpha{alpha:.3f}")
    on_root(data.comm, _draw, data.page, linear, contacts, data.picture)


def _draw(page: Page, linear: Mapping[str, Any], contacts: Mapping[float, Any], picture: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 5.2 * len(contacts)), layout="constrained")
    panels = figure.subplots(len(contacts), 2, squeeze=False)
    for row, (alpha, results) in zip(panels, contacts.items(), strict=True):
        groups, first = by_pressure(results.values()), next(iter(results.values()))
        uniform = {
            p: [equivalent_drag(g.model, first.omega, first.stress, alpha) for g in some]
            for p, some in by_pressure(linear.values()).items()
        }
        shades = Shades("pressure", groups)
        for form, found in (("one time", uniform), ("per contact", groups)):
            for p, some in found.items():
                _draw_mean(row[0], some, form, p, shades)
            note_exponents(page, alpha, form, found)
        _draw_ratio(row[1], uniform, groups, shades)
        low, height = first.omega.min(), abs(uniform[max(uniform)][0].values.imag).min()
        guide(row[0], (3 * low, 300 * low), float(height), alpha, f"slope {alpha:.2g}")
        guide(row[0], (1e-3, 1e-1), 3e-3, alpha / 2, f"slope {alpha / 2:.2g}")
        row[0].set(xlabel=r"$\omega\tau_1$", ylabel=r"$G'$ (●), $G''$ (○)  ($k$)")
        what = rf"α = {alpha:.3g}, $\delta\sigma$ = {first.stress:.0e}, without pre-stress"
        row[0].set_title(f"{what}; symbols: per contact, lines: one time")
        row[0].legend()
    save(figure, picture)


def _draw_mean(axes: Axes, some: list[NonlinearModulus], form: str, p: float, shades: Shades) -> None:
    omega, mean = some[0].omega, np.mean([g.values for g in some], axis=0)
    colour, label = shades(p), f"{setting('pressure', p)} ({len(some)})"
    for part, face, line in ((mean.real, colour, "-"), (mean.imag, "white", "--")):
        if form == "per contact":
            shown = label if face == colour else ""
            axes.loglog(omega, part, shades.marker(p), ms=4, color=colour, mfc=face, label=shown)
        else:
            axes.loglog(omega, part, line, lw=1.2, color=colour)


def _draw_ratio(axes: Axes, uniform: Mapping[float, Any], contacts: Mapping[float, Any], shades: Shades) -> None:
    """Draw the moduli with one time for all contacts, divided by those with a time for each contact."""
    for p, some in contacts.items():
        ours, theirs = (np.mean([g.values for g in found], axis=0) for found in (some, uniform[p]))
        look: dict[str, Any] = {"ms": 3, **shades.look(p)}
        axes.semilogx(some[0].omega, theirs.real / ours.real, "-", label=setting("pressure", p), **look)
        axes.semilogx(some[0].omega, theirs.imag / ours.imag, "--", mfc="white", **look)
    axes.axhline(1, color="0.6", lw=0.8)
    axes.set(xlabel=r"$\omega\tau_1$", ylabel="one time / per contact: $G'$ (●), $G''$ (○)", yscale="log")
    axes.legend()


def note_exponents(page: Page, alpha: float, form: str, groups: Mapping[float, list[NonlinearModulus]]) -> None:
    """Note the slopes of eqs. 27–29 and the dependence of G″ on p at the lowest frequency.

    Parameters
    ----------
    page : Page
    alpha : float
    form : str
        ``one time``, ``per contact`` or ``direct``.
    groups : dict
        Results on one grid of frequencies, by pressure.
    """
    name = f"α = {alpha:.3g}, {form}"
    lowest = groups[min(groups)]
    own = form != "one time"  # docs/howto/drag.md derives the expected exponents
    critical = f"{alpha / 2:.3g}" + f"; per contact {2 * alpha / (1 + 3 * alpha):.3g} expected" * own
    for what, choose, part, paper in (
        ("quasi-static G″ ~ ω^x", "quasi-static", np.imag, f"{alpha:.3g}"),
        ("critical G′ ~ ω^x", "critical", np.real, critical),
        ("critical G″ ~ ω^x", "critical", np.imag, critical),
    ):
        some = groups[max(groups)] if choose == "quasi-static" else lowest
        slopes = [_slope(g, part, choose) for g in some]
        page.mean(f"{name}: {what}", slopes, paper, f"p = {some[0].origin.pressure:.2g}")
    p = np.array(list(groups))
    samples = [[float(g.values.imag[0]) for g in some] for some in groups.values()]
    expected = "−1/2" + f"; per contact {(1 - 3 * alpha) / 4:.3g} expected" * own
    page.exponent(f"{name}: quasi-static G″ ~ p^x", p, samples, expected)
    every = [g for some in groups.values() for g in some]
    lost, most = sum(int((~g.converged).sum()) for g in every), max(int(g.iterations.max()) for g in every)
    page.tallies.append(f"{name}: {lost} points did not converge; at most {most} iterations.")


def _slope(g: NonlinearModulus, part: Any, choose: str) -> float:
    """Return the slope for ωτ below a tenth of the crossover p, or between ten p and ``AFFINE``."""
    rate, p = g.omega * g.tau, g.origin.pressure
    kept = rate < 0.1 * p if choose == "quasi-static" else (rate > 10 * p) & (rate < AFFINE)
    return log_slope(g.omega[kept], part(g.values[kept]))
