"""BT Fig. 7: correlations of the non-affine displacements, and their length under Stokes drag.

Axes: w frequency, d distance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.analysis.correlations import CorrelationLength, correlation_length, correlations
from petscjam.analysis.scaling import Curve, log_corrected, nearest_parabola, parabola_distance
from petscjam.analysis.statistics import by_pressure
from petscjam.figures.data import FigureData
from petscjam.figures.page import Finding, Page
from petscjam.io.jobs import PackingAnalysis
from petscjam.parallel.comm import on_root
from petscjam.plots.figure import save
from petscjam.plots.legends import Shades, setting
from petscjam.rows.damping import ContactDamping, StokesDrag

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LINES = "-", "--", ":"  # of each number of disks


def draw(data: FigureData) -> None:
    """Compute and draw the figure."""
    parameters = data.parameters
    contact: dict[str, Any] = {}
    few = {"omegas": parameters.points("contact_omega")}
    for n in parameters.points("sizes").astype(int).tolist():
        files = data.packings(n, parameters.points("contact_pressure"))
        made = data.results(files, PackingAnalysis(correlations, few), [ContactDamping()], tag=f"contact-N{n}")
        contact |= {f"{n} {name}": c for name, c in data.stable(made, f"contact damping, N = {n}").items()}
    lanes: dict[float, dict[str, Any]] = {}
    for width in parameters.points("widths").tolist():  # of the largest size
        lane = PackingAnalysis(correlations, {**few, "width": width, "bin": width / 2})
        made = data.results(files, lane, [ContactDamping()], tag=f"lane{width:g}")
        lanes[width] = data.stable(made, f"lanes {width:g} d high")
    files = data.packings(parameters["particles"], parameters.points("pressure"))
    many = PackingAnalysis(correlations, {"omegas": parameters.points("omega")})
    stokes = data.results(files, many, [StokesDrag()], tag="stokes")
    solid, shown = data.stable(stokes, "Stokes drag"), float(parameters["shown_pressure"])
    on_root(data.comm, _draw, data.page, contact, lanes, solid, shown, data.picture)


def _draw(
    page: Page,
    contact: Mapping[str, Any],
    lanes: Mapping[float, Mapping[str, Any]],
    stokes: Mapping[str, Any],
    shown: float,
    picture: Path,
) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 9.5), layout="constrained")
    panels = figure.subplots(2, 2)
    _draw_contact(page, panels[0, 0], contact)
    for width, some in lanes.items():
        _note_lengths(page, correlation_length(dict(some)), f"contact damping, lanes {width:g} d high")
    groups = by_pressure(stokes.values())
    lengths = {p: correlation_length(dict(enumerate(some))) for p, some in groups.items()}  # type: ignore[arg-type]
    _draw_stokes(panels[0, 1], groups, lengths, shown)
    _draw_lengths(page, panels[1], groups, lengths)
    save(figure, picture)


def _draw_contact(page: Page, axes: Axes, results: Mapping[str, Any]) -> None:
    """Draw C under contact damping against δ/L, for all sizes and frequencies; note its zero."""
    sizes = sorted({c.origin.particles for c in results.values()})
    for k, n in enumerate(sizes):
        some = {name: c for name, c in results.items() if c.origin.particles == n}
        mean = correlation_length(some)
        shades, line = Shades("omega", mean.omega.tolist()), LINES[k % len(LINES)]
        for w in range(len(mean.omega)):
            _draw_band(axes, mean, w, line, shades)
        axes.plot([], [], line, color="0.3", label=f"{setting('particles', n)} ({len(some)})")
        _note_lengths(page, mean, f"contact damping, N = {n}")
        zero_stress = correlation_length(some, "imaginary")
        _note_lengths(page, zero_stress, f"contact damping, N = {n}, at zero stress")
    axes.axhline(0, color="0.6", lw=0.8)
    pressure = next(iter(results.values())).origin.pressure
    axes.set(xlabel=r"$\delta/L$", ylabel="$C$", ylim=(-1, 1.02))
    axes.set_title(f"(a) contact damping, {setting('pressure', pressure)}, (number of packings)")
    shades.show(axes)


def _draw_band(axes: Axes, mean: CorrelationLength, w: int, line: str, shades: Shades) -> None:
    """Draw the mean of C at a frequency ± its standard error."""
    x, omega = mean.delta / mean.L, float(mean.omega[w])
    C, error = mean.C[w], np.nan_to_num(mean.C_error[w])
    axes.plot(x, C, line, color=shades(omega), lw=1.2, marker=shades.marker(omega), ms=3.5, markevery=0.1)
    axes.fill_between(x, C - error, C + error, color=shades(omega), alpha=0.15, lw=0)


def _note_lengths(page: Page, mean: CorrelationLength, what: str) -> None:
    """Note the zero of C at every frequency."""
    for w, omega in enumerate(mean.omega):
        name = f"{what}: l/L at ω = {omega:.0e}"
        page.findings.append(Finding(name, mean.length[w] / mean.L, mean.error[w] / mean.L, "about 1/4"))


def _draw_stokes(
    axes: Axes, groups: Mapping[float, list[Any]], lengths: Mapping[float, CorrelationLength], shown: float
) -> None:
    """Draw C under Stokes drag at one pressure, for every second frequency."""
    p = min(groups, key=lambda p: abs(np.log(p / shown)))
    mean = lengths[p]
    shades = Shades("omega", mean.omega[::2].tolist())
    for w in range(0, len(mean.omega), 2):
        _draw_band(axes, mean, w, "-", shades)
    shades.show(axes)
    axes.axhline(0, color="0.6", lw=0.8)
    axes.set(xlabel=r"$\delta/L$", ylabel="$C$", ylim=(-1, 1.02))
    particles = groups[p][0].origin.particles
    axes.set_title(f"(b) Stokes drag, p = {p:.2g}, N = {particles} ({len(groups[p])} packings)")
    axes.legend()


def _draw_lengths(
    page: Page, panels: Sequence[Axes], groups: Mapping[float, list[Any]], lengths: Mapping[float, CorrelationLength]
) -> None:
    """Draw the length against the frequency for every pressure, raw and rescaled; note the best rescaling."""
    shades = Shades("pressure", groups)
    curves: list[Curve] = []
    for p, mean in lengths.items():
        label = f"{setting('pressure', p)} ({len(groups[p])})"
        look = shades.look(p)
        panels[0].errorbar(mean.omega, mean.length, mean.error, ms=4, lw=0.8, label=label, **look)
        panels[0].axhline(mean.L / 4, color="0.6", lw=0.8, ls="--")
        grows = (mean.length < 0.7 * mean.length[0]) & (mean.omega < 0.02)
        x, y = log_corrected(p=p)
        panels[1].loglog(mean.omega[grows] * x, mean.length[grows] * y, ls="", ms=4, **look)
        plateau, error = mean.length[0] / mean.L, mean.error[0] / mean.L
        name = f"Stokes drag, p = {p:.2g}: plateau l/L at the lowest ω"
        page.findings.append(Finding(name, plateau, error, "about 1/4"))
        own = np.array([c.length[grows] for c in groups[p]])
        own = own[np.isfinite(own).all(1)]
        if grows.sum() > 1 and len(own) > 1:
            curves.append(Curve(mean.omega[grows], own, {"p": p}))
    if len(curves) > 1:
        _note_collapse(page, curves)
    panels[0].set(xscale="log", yscale="log", xlabel=r"$\omega\tau_1$", ylabel="$l$  ($d$)")
    panels[0].set_title("(c) length where C crosses zero; dashed: L/4")
    panels[0].legend()
    panels[1].set(xlabel=r"$\omega\tau_1/p^{1/2}$  ($k^{-1/2}$)", ylabel=r"$l\,(-\ln p)^{-0.65}$  ($d$)")
    panels[1].set_title(r"(d) collapse below 0.7 of the plateau, $\omega\tau_1$ < 0.02")


def _note_collapse(page: Page, curves: list[Curve]) -> None:
    """Note the scatter of l(−ln p)^−c about one curve against ω/p^½, and the c with the smallest scatter."""
    what = "Stokes drag, below 0.7 of the plateau and ω < 0.02: scatter of ln l(−ln p)^−c, "
    for c, remark in ((-0.65, "as printed"), (0.0, "no logarithm"), (0.65, "the other sign")):
        distance = parabola_distance(curves, log_corrected, c=c)
        page.findings.append(Finding(f"{what}c = {c:g}", distance, np.nan, "—", remark))
    page.findings.append(
        Finding("c of the least scatter", *nearest_parabola(curves, log_corrected, "c", (-3, 3)), "−0.65")
    )
