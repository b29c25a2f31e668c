"""Figures: G′ and G″ against frequency, and displacements of disks (BT Fig. 1)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.analysis.statistics import average
from petscjam.base.errors import InputError, SolverError
from petscjam.plots.figure import LOSS, STORAGE, UNSTABLE, Colour, arrows, draw_cell, panel, scale_bar
from petscjam.plots.legends import Families, heading, number
from petscjam.response.result import ComplexModulus
from petscjam.response.spectrum import Spectrum
from petscjam.rows.kinematics import strain_mode

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase


def moduli_figure(results: Mapping[str, ComplexModulus], ax: Axes | None = None) -> Figure:
    """Draw every result of a file, and below the displacement fields of the first result that has them.

    Parameters
    ----------
    results : mapping of ComplexModulus
    ax
        Of matplotlib: draw only the moduli, here.
    """
    from matplotlib.figure import Figure

    pictured = None if ax else next((g for g in results.values() if len(g.field_omega)), None)
    only = next(iter(results.values())) if len(results) == 1 else None
    model = only.model if only and not ax else None
    if not pictured and not model:
        axes = panel(ax)
        _draw_moduli(axes, results)
        return axes.figure  # type: ignore[return-value]
    wide, tall = 11.5 if model else 7.2, 5.2
    columns = max(3, len(pictured.field_omega)) if pictured else 1
    if pictured:
        figure = Figure(figsize=(max(3.4 * columns, wide), tall + 6.6), layout="constrained")
        halves: Any = figure.subfigures(2, 1, height_ratios=[tall, 6.6])
        draw_fields(halves[1], pictured)
    else:
        figure = Figure(figsize=(wide, tall), layout="constrained")
        halves = [figure]
    if model:
        right = ["error"] if model.inertia else ["error", "time"]
        panels = halves[0].subplot_mosaic([["G", name] for name in right], width_ratios=[1.7, 1])
        _draw_moduli(panels["G"], results)
        _draw_errors(panels["error"], model)
        if "time" in panels:
            _draw_time(panels["time"], model)
    else:
        _draw_moduli(halves[0].subplots(), results)
    return figure


def _draw_moduli(axes: Axes, results: Mapping[str, ComplexModulus]) -> None:
    """Draw G′ (solid) and G″ (dashed) of each family: the mean over stable packings ± its error, and the others."""
    families, first = Families(results, grid=lambda g: g.omega.tolist()), next(iter(results.values()))
    for family in families.members:
        colours = (family.colour,) * 2 if len(families.members) > 1 else (STORAGE, LOSS)
        stable = {name: g for name, g in family.results.items() if g.stable}
        if len(stable) > 1:
            _draw_mean(axes, stable, colours, family.marker)
        one = len(family.results) == 1
        for g in family.results.values():
            _draw_one(axes, g, colours, family.marker if one else "", faint=not one)
    if len(results) == 1:
        _draw_limits(axes, first)
    _guides(axes, first)
    bad = [g for g in results.values() if not g.stable]
    axes.set(xlabel=r"angular frequency $\omega\tau_1$", ylabel=r"$G',\;G''$  ($k$)")
    several = len(families.members) > 1
    for style, colour, face, text in (
        ("-", STORAGE, STORAGE, "storage modulus $G'$"),
        ("--", LOSS, "white", "loss modulus $G''$"),
    ):
        look: dict[str, Any] = (
            {"color": "0.3", "label": text} if several else {"color": colour, "mfc": face, "label": text}
        )
        axes.plot([], [], style if several else f"o{style}", **look)
    if any(len(family.results) > 1 for family in families.members):
        axes.fill_between([], [], [], color="0.5", alpha=0.35, lw=0, label="mean of stable packings ± its error")
    if bad:
        axes.plot([], [], ":", color="0.3", label="not stable")
    if any((g.values.real < 0).any() for g in results.values()):
        axes.plot([], [], "x", color=UNSTABLE, label="negative values, drawn at their magnitude")
    families.show(axes, loc="upper left")
    axes.set_title(heading(results))
    if bad:
        count = len({g.origin.checksum for g in results.values()})
        text = (
            bad[0].state
            if len(results) == 1
            else f"{len({g.origin.checksum for g in bad})} of {count} packings not stable"
        )
        axes.text(0.98, 0.04, text, transform=axes.transAxes, ha="right", color=UNSTABLE, weight="bold")


def _draw_one(axes: Axes, g: ComplexModulus, colours: tuple[Colour, ...], marker: str, *, faint: bool) -> None:
    rising = np.argsort(g.omega)
    omega, G = g.omega[rising], g.values[rising]
    for values, colour, style, face in ((G.real, colours[0], "-", colours[0]), (G.imag, colours[1], "--", "white")):
        positive = np.where(values > 0, values, np.nan)
        look = {"lw": 0.6, "alpha": 0.35} if faint else {"lw": 1, "marker": marker, "ms": 4, "mfc": face}
        axes.loglog(omega, positive, style if g.stable else ":", color=colour, **look)
        axes.loglog(omega, np.where(values < 0, -values, np.nan), "x", color=UNSTABLE, ms=5)


def _draw_mean(axes: Axes, some: Mapping[str, ComplexModulus], colours: tuple[Colour, ...], marker: str) -> None:
    """Draw mean ± standard error over stable packings of one kind."""
    mean = average(some)
    rising = np.argsort(mean.omega)
    for part, colour, style, face in ((np.real, colours[0], "-", colours[0]), (np.imag, colours[1], "--", "white")):
        centre, error = part(mean.mean)[rising], part(mean.error)[rising]
        axes.loglog(mean.omega[rising], centre, style, color=colour, lw=1.4, marker=marker, ms=4, mfc=face)
        low = np.maximum(centre - error, 1e-3 * centre)
        axes.fill_between(mean.omega[rising], low, centre + error, color=colour, alpha=0.25, lw=0)


def _draw_limits(axes: Axes, g: ComplexModulus) -> None:
    """Draw the limits of G′ and G″ at ω → 0 and ω → ∞."""
    low, high = g.omega.min(), g.omega.max()
    for limit, slope, end, colour, text, shift in (
        (g.G0, 0, low, STORAGE, r"$G_0$", (0, 7)),
        (g.eta0, 1, low, LOSS, r"$\eta_0\omega$", (12, -3)),
        (g.G_inf, 0, high, STORAGE, r"$G_\infty$", (0, 7)),
        (g.eta_inf, 1, high, LOSS, r"$\eta_\infty\omega$", (0, 7)),
    ):
        if limit > 0:
            span = np.array([end, end * (1e3 if end == low else 1e-2)])
            values, side = limit * span**slope, "left" if end == low else "right"
            axes.loglog(span, values, "--", color=colour, lw=0.9, zorder=0)
            axes.annotate(text, (span[0], values[0]), shift, color=colour, textcoords="offset points", ha=side)


def _draw_errors(axes: Axes, model: Spectrum) -> None:
    """Draw the bounds on the errors of G*, G′ and G″, and the frequencies of the factorisations."""
    omega = np.geomspace(*model.span, 801)
    storage, loss = model.part_errors(omega)
    axes.loglog(omega, storage, color=STORAGE, lw=0.8, label="$G'$")
    axes.loglog(omega, loss, "--", color=LOSS, lw=0.8, label="$G''$")
    axes.loglog(omega, model.error(omega), color="0.2", lw=1.2, label="$|G^*|$")
    axes.axhline(model.rtol, color="0.5", ls="--", lw=0.8)
    bottom, place = np.full(len(model.nodes), 0.03), axes.get_xaxis_transform()
    axes.plot(model.nodes, bottom, "|", color="0.2", ms=9, clip_on=False, transform=place)
    what = "bound" if model.definite else "estimate"
    axes.set(xlabel=r"$\omega\tau_1$", ylabel=f"{what} on relative error")
    axes.set_title(f"{model.factorisations} factorisations (ticks)")
    axes.legend()


def _draw_time(axes: Axes, model: Spectrum) -> None:
    """Draw the relaxation modulus G(t) and the creep compliance J(t)."""
    t = np.geomspace(1 / model.span[1], 1 / model.span[0], 401)
    axes.set_title("after a step of strain, of stress")
    try:
        G, J = model.G(t), model.J(t)
    except SolverError as error:
        axes.text(0.5, 0.5, str(error), transform=axes.transAxes, ha="center", wrap=True, color=UNSTABLE)
        return
    axes.loglog(t, np.where(G > 0, G, np.nan), color=STORAGE, lw=1.2, label="$G(t)$")
    axes.loglog(t, np.where(J > 0, J, np.nan), "--", color=LOSS, lw=1.2, label="$J(t)$")
    axes.set(xlabel=r"time $t/\tau_1$", ylabel="$G(t)$  ($k$),  $J(t)$  ($1/k$)")
    axes.legend()


def _guides(axes: Axes, g: ComplexModulus) -> None:
    """Draw slopes 1 and ½ next to G″."""
    spans = {1.0: g.omega.min() * np.array([30, 3e3]), 0.5: np.array([3e-3, 0.3])}
    for slope, span in spans.items():
        inside = span[1] < g.omega.max() and span[0] >= g.omega.min()
        rising = np.argsort(g.omega)
        height = np.interp(np.log(span[0]), np.log(g.omega[rising]), np.log(np.abs(g.values.imag[rising])))
        if inside and len(g.omega) > 2:
            guide = 0.35 * np.exp(height) * (span / span[0]) ** slope
            axes.loglog(span, guide, color="0.4", lw=1)
            text, end = "slope 1" if slope == 1 else "slope ½", (span[1], guide[1])
            axes.annotate(text, end, (4, -8), color="0.4", textcoords="offset points", fontsize=9)


def draw_fields(figure: FigureBase, g: ComplexModulus, most: int = 2500) -> None:
    """Draw Im Q* (zero stress) above Re Q* (peak stress), Q* = (δσ/G*)(q, 1); each panel on its own scale.

    Parameters
    ----------
    figure
        Of matplotlib.
    g : ComplexModulus
        With fields.
    most : int
        Largest number of disks; of a larger packing, the central part is drawn.
    """
    panels = figure.subplots(2, len(g.field_omega), squeeze=False)
    packing = g.geometry
    if packing is None:
        raise InputError("the result has displacements, but not the packing they belong to")
    x = packing.box.wrap(packing.positions)
    centre = packing.box.cell.sum(0) / 2
    affine = (x - centre) @ strain_mode(g.strain).gradient.T
    spacing = np.sqrt(packing.box.area / len(packing))
    half = np.sqrt(most / len(packing)) / 2
    shown = (abs(packing.box.fractional(x) - 0.5) < half).all(1)
    for w, omega in enumerate(g.field_omega):
        total = (g.fields[w] + affine) / g.values[np.argmin(np.abs(g.omega - omega))]
        for row, (motion, name) in enumerate(((total.imag, "zero stress"), (total.real, "peak stress"))):
            axes = panels[row, w]
            motion = motion - np.nanmean(motion, axis=0)
            size = np.sqrt(np.nanmean((motion**2).sum(1)))
            u = motion[shown] * 1.6 * spacing / size
            arrows(axes, x[shown], u, width=0.0035, color=STORAGE if row else LOSS)
            draw_cell(axes, packing.box, 1.0 if shown.all() else 2 * float(half))
            rms = rf"rms displacement {number(float(f'{size:.2g}'))} $\delta\sigma d/k$"
            axes.set_title(rf"{name}, $\omega\tau_1$ = {number(float(omega))}" + f"\n{rms}", fontsize=9)
            axes.set(aspect="equal", xticks=[], yticks=[])
            axes.set_frame_on(False)
            scale_bar(axes, packing.mean_diameter)
