"""BT Fig. 4: contact damping without and with little friction of sliding, and without rotations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.analysis.statistics import by_pressure, grouped, means
from petscjam.analysis.viscosity import viscosity
from petscjam.figures.data import FigureData
from petscjam.figures.page import Page
from petscjam.figures.panels import draw_mean, guide
from petscjam.io.jobs import ModulusAnalysis, PackingAnalysis
from petscjam.parallel.comm import on_root
from petscjam.plots.figure import save
from petscjam.plots.legends import Shades, given, setting
from petscjam.rows.damping import ContactDamping

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from petscjam.analysis.viscosity import Viscosity
    from petscjam.response.result import ComplexModulus

UNDAMPED, CENTRES = ContactDamping(0.0), ContactDamping(1.0, rotations=False)


def draw(data: FigureData) -> None:
    """Compute and draw the figure."""
    parameters = data.parameters
    omega, betas = parameters.points("omega"), list(map(ContactDamping, parameters.points("betas").tolist()))
    files = data.packings(parameters["particles"], parameters.points("pressure"))
    both, G = (True, False), ModulusAnalysis(omega)
    undamped = data.results(files, G, [UNDAMPED], both, tag="undamped")
    centres = data.results(files, G, [CENTRES], (False,), tag="centres")
    eta0 = data.results(files, PackingAnalysis(viscosity), [UNDAMPED, ContactDamping()], both, tag="viscosity")
    one = data.packings(parameters["particles"], [parameters["beta_pressure"]])
    weak = data.results(one, ModulusAnalysis(omega, family=True), betas, tag="betas")
    on_root(
        data.comm,
        _draw,
        data.page,
        {
            "undamped": data.stable(undamped, "β = 0"),
            "centres": data.stable(centres, "β = 1 at the centres"),
            "weak": data.stable(weak, "varying β"),
            "eta0": data.stable(eta0, "η0"),
        },
        data.picture,
    )


def _draw(page: Page, results: Mapping[str, Mapping[str, Any]], picture: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 10.5), layout="constrained")
    panels = figure.subplots(2, 2)
    _draw_undamped(page, panels[0], results["undamped"])
    _draw_betas(panels[1, 0], results["weak"], results["eta0"])
    _draw_centres(page, panels[1, 1], results["centres"])
    _crossover(page, results["eta0"])
    save(figure, picture)


def _draw_undamped(page: Page, panels: Sequence[Axes], results: Mapping[str, ComplexModulus]) -> None:
    """Draw β = 0 with pre-stress (circles) and without (lines), raw and collapsed by p^½."""
    for prestress in (True, False):
        groups = by_pressure(results.values(), prestress=prestress)
        if not groups:
            continue
        shades, p, how = Shades("pressure", groups), np.array(list(groups)), given(prestress)
        for x, some in groups.items():
            for axes, y in ((panels[0], 1.0), (panels[1], x**-0.5)):
                if prestress:
                    draw_mean(axes, some, shades(x), setting("pressure", x), marker=shades.marker(x), y=y)
                else:
                    mean = np.mean([g.values for g in some], axis=0) * y
                    axes.loglog(some[0].omega, mean.real, "-", color=shades(x), lw=1.5)
                    axes.loglog(some[0].omega, mean.imag, "--", color=shades(x), lw=1.5)
        for name, limit, paper in (
            ("G0 ~ p^μ", "G0", "1/2"),
            ("η0 ~ p^x", "eta0", "1/2"),
            ("G∞ ~ p^x", "G_inf", "1/2"),
        ):
            samples = [[getattr(g, limit) for g in some] for some in groups.values()]
            page.exponent(f"β = 0, {name}, {how}", p, samples, paper)
    panels[0].set(xlabel=r"$\omega\tau_1$", ylabel=r"$G'$ (●, line), $G''$ (○, dashed)  ($k$)")
    panels[0].set_title("(a) β = 0: with pre-stress (symbols), without (lines)")
    panels[0].legend()
    panels[1].set(xlabel=r"$\omega\tau_1$", ylabel=r"$G'/p^{1/2}$, $G''/p^{1/2}$  ($k^{1/2}$)")
    panels[1].set_title("(a) collapse by $p^{1/2}$, no rescaling of the frequency")


def _draw_betas(axes: Axes, results: Mapping[str, Any], eta0: Mapping[str, Viscosity]) -> None:
    """Draw G* at one pressure for every β, and the viscosities at both ends against β.

    η0 = η0(0) + sβ is exact, and is computed from two direct solves, because at large β the range of frequencies
    ends too early.
    """
    groups = grouped(results.values(), lambda g: g.damping.beta)
    shades = Shades("beta", groups)
    inset = axes.inset_axes((0.1, 0.68, 0.36, 0.3))
    inset.set(xscale="log", yscale="log", xlabel=r"$\beta$", ylabel=r"$\eta$  ($k\tau_1$)")
    for beta, some in groups.items():
        draw_mean(axes, some, shades(beta), setting("beta", beta), marker=shades.marker(beta))
    axes.set_ylim(top=1e7)
    betas = np.array(list(groups))
    none, full = (_by_packing(eta0, law) for law in (UNDAMPED, ContactDamping()))
    there = {g.origin.checksum for g in results.values()} & set(none) & set(full)
    low_end = [[none[key] + beta * (full[key] - none[key]) for key in there] for beta in betas]
    high_end = [[g.eta_inf for g in some] for some in groups.values()]
    for samples, marker, label in ((low_end, "o", r"$\eta_0$"), (high_end, "s", r"$\eta_\infty$")):
        if not samples[0]:  # there is no direct solve for η0 at this pressure
            continue
        inset.errorbar(betas, *means(samples), fmt=f"{marker}-", ms=3, lw=0.8, label=label)
    inset.legend()
    inset.tick_params(labelsize=7)
    pressure = next(iter(results.values())).origin.pressure
    axes.set(xlabel=r"$\omega\tau_1$", ylabel=r"$G'$ (●), $G''$ (○)  ($k$)")
    axes.set_title(f"(b) {setting('pressure', pressure)}, with pre-stress, varying β")
    axes.legend(loc="lower right")


def _draw_centres(page: Page, axes: Axes, results: Mapping[str, ComplexModulus]) -> None:
    """Draw β = 1 with friction at the centres, scaled as with rotations."""
    groups = by_pressure(results.values(), prestress=False)
    shades = Shades("pressure", groups)
    for x, some in groups.items():
        look: dict[str, Any] = {"colour": shades(x), "marker": shades.marker(x)}
        draw_mean(axes, some, label=setting("pressure", x), x=1 / x, y=x**-0.5, most=0.05, **look)
    guide(axes, (30, 1e3), 0.5, 0.5, "slope ½")
    p = np.array(list(groups))
    for name, limit, paper in (("G0 ~ p^μ", "G0", "1/2"), ("η0 ~ p^(μ−λ)", "eta0", "−1/2")):
        samples = [[getattr(g, limit) for g in some] for some in groups.values()]
        page.exponent(f"β = 1 at the centres, {name}, without pre-stress", p, samples, paper)
    axes.set(xlabel=r"$\omega\tau_1/p$  ($1/k$)", ylabel=r"$G'/p^{1/2}$ (●), $G''/p^{1/2}$ (○)  ($k^{1/2}$)")
    axes.set_title("β = 1 at the centres (no rolling), without pre-stress: collapse")
    axes.legend()


def _by_packing(results: Mapping[str, Viscosity], law: ContactDamping) -> dict[str, float]:
    """Return η0 with pre-stress by the checksum of the packing."""
    return {v.origin.checksum: v.eta0 for v in results.values() if v.damping == law and v.prestress}


def _crossover(page: Page, results: Mapping[str, Viscosity]) -> None:
    """Note β* ~ p: η0 = η0(0) + sβ is exact, because θ is the same at every β; at β* both terms are equal."""
    for prestress in (True, False):
        laws = UNDAMPED, ContactDamping()
        none, full = (by_pressure(results.values(), prestress=prestress, damping=law) for law in laws)
        samples = []
        for p in none:
            with_friction = {v.origin.checksum: v.eta0 for v in full[p]}
            samples.append([v.eta0 / (with_friction[v.origin.checksum] - v.eta0) for v in none[p]])
        page.exponent(f"β* ~ p^x, {given(prestress)}", np.array(list(none)), samples, "1")
