"""BT Fig. 7: correlations of the non-affine displacements, and their length under Stokes drag.

Axes: w frequency, d distance.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from petscjam.analysis.correlations import CorrelationLength, correlation_length, correlations
from petscjam.analysis.scaling import log_corrected
from petscjam.analysis.statistics import by_pressure
from petscjam.base.types import Array
from petscjam.figures.study import Finding, Study
from petscjam.io.jobs import PackingAnalysis
from petscjam.parallel.comm import on_root
from petscjam.plots.figure import pressure_colours as coloured
from petscjam.plots.figure import save
from petscjam.rows.damping import ContactDamping, StokesDrag


class Lengths(NamedTuple):
    """l of each packing at a pressure, (k, w), where it grows."""

    p: float
    omega: Array
    samples: Array


def draw(study: Study, picture: Path) -> None:
    """Make and draw it."""
    contact: dict[str, Any] = {}
    few = {"omegas": study.points("contact_omega")}
    for n in study.points("sizes").astype(int).tolist():
        files = study.packings(n, study.points("contact_pressure"))
        made = study.results(files, PackingAnalysis(correlations, few), [ContactDamping()], tag=f"contact-N{n}")
        contact |= {f"{n} {name}": c for name, c in study.tally(made, f"contact damping, N = {n}").items()}
    lanes: dict[float, dict[str, Any]] = {}
    for width in study.points("widths").tolist():  # of the largest size
        lane = PackingAnalysis(correlations, {**few, "width": width, "bin": width / 2})
        made = study.results(files, lane, [ContactDamping()], tag=f"lane{width:g}")
        lanes[width] = study.tally(made, f"lanes {width:g} d high")
    files = study.packings(study["particles"], study.points("pressure"))
    many = PackingAnalysis(correlations, {"omegas": study.points("omega")})
    stokes = study.results(files, many, [StokesDrag()], tag="stokes")
    on_root(study.comm, _draw, study, contact, lanes, study.tally(stokes, "Stokes drag"), picture)


def _draw(
    study: Study,
    contact: Mapping[str, Any],
    lanes: Mapping[float, Mapping[str, Any]],
    stokes: Mapping[str, Any],
    picture: Path,
) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 9.5), layout="constrained")
    panels = figure.subplots(2, 2)
    _draw_contact(study, panels[0, 0], contact)
    for width, some in lanes.items():
        _note_lengths(study, correlation_length(dict(some)), f"contact damping, lanes {width:g} d high")
    groups = by_pressure(stokes.values())
    lengths = {p: correlation_length(dict(enumerate(some))) for p, some in groups.items()}  # type: ignore[arg-type]
    _draw_stokes(panels[0, 1], groups, lengths, float(study["shown_pressure"]))
    _draw_lengths(study, panels[1], groups, lengths)
    save(figure, picture)


def _draw_contact(study: Study, axes: Any, results: Mapping[str, Any]) -> None:
    """Draw C under contact damping against δ/L, for all sizes and frequencies; note where it crosses zero."""
    sizes = sorted({c.origin.particles for c in results.values()})
    for k, n in enumerate(sizes):
        some = {name: c for name, c in results.items() if c.origin.particles == n}
        mean = correlation_length(some)
        for w, omega in enumerate(mean.omega):
            label = rf"N = {n}, $\omega\tau_1$ = {omega:.0e} ({len(some)})"
            axes.plot(mean.delta / mean.L, mean.C[w], ("-", "--", ":")[k % 3], color=f"C{w}", lw=1.2, label=label)
        _note_lengths(study, mean, f"contact damping, N = {n}")
        zero_stress = correlation_length(some, "imaginary")
        _note_lengths(study, zero_stress, f"contact damping, N = {n}, at zero stress")
    axes.axhline(0, color="0.6", lw=0.8)
    pressure = next(iter(results.values())).origin.pressure
    axes.set(xlabel=r"$\delta/L$", ylabel="$C$", ylim=(-1, 1.02))
    axes.set_title(f"(a) contact damping, p = {pressure:.2g}; (number of packings)", fontsize=10)
    axes.legend(frameon=False, fontsize=8)


def _note_lengths(study: Study, mean: CorrelationLength, what: str) -> None:
    """Note where C crosses zero, at every frequency."""
    for w, omega in enumerate(mean.omega):
        name = f"{what}: l/L at ω = {omega:.0e}"
        study.findings.append(Finding(name, mean.length[w] / mean.L, mean.error[w] / mean.L, "about 1/4"))


def _draw_stokes(
    axes: Any, groups: Mapping[float, list[Any]], lengths: Mapping[float, CorrelationLength], shown: float
) -> None:
    """Draw C under Stokes drag at one pressure, for every second frequency."""
    from matplotlib import colormaps

    p = min(groups, key=lambda p: abs(np.log(p / shown)))
    mean, L = lengths[p], lengths[p].L
    for w in range(0, len(mean.omega), 2):
        colour = colormaps["viridis"](0.9 * w / len(mean.omega))
        label = rf"$\omega\tau_1$ = {mean.omega[w]:.0e}"
        axes.plot(mean.delta / L, mean.C[w], color=colour, lw=1.2, label=label)
    axes.axhline(0, color="0.6", lw=0.8)
    axes.set(xlabel=r"$\delta/L$", ylabel="$C$", ylim=(-1, 1.02))
    particles = groups[p][0].origin.particles
    axes.set_title(f"(b) Stokes drag, p = {p:.2g}, N = {particles} ({len(groups[p])} packings)", fontsize=10)
    axes.legend(frameon=False, fontsize=7)


def _draw_lengths(
    study: Study, panels: Any, groups: Mapping[float, list[Any]], lengths: Mapping[float, CorrelationLength]
) -> None:
    """Draw the length against the frequency for every pressure, raw and rescaled; note the best rescaling."""
    colour = coloured(list(groups))
    curves: list[Lengths] = []
    for p, mean in lengths.items():
        label = f"p = {p:.2g} ({len(groups[p])})"
        panels[0].errorbar(mean.omega, mean.length, mean.error, fmt="o-", ms=4, lw=0.8, color=colour(p), label=label)
        panels[0].axhline(mean.L / 4, color="0.6", lw=0.8, ls="--")
        grows = (mean.length < 0.7 * mean.length[0]) & (mean.omega < 0.02)
        x, y = log_corrected(p=p)
        panels[1].loglog(mean.omega[grows] * x, mean.length[grows] * y, "o", ms=4, color=colour(p))
        plateau, error = mean.length[0] / mean.L, mean.error[0] / mean.L
        name = f"Stokes drag, p = {p:.2g}: plateau l/L at the lowest ω"
        study.findings.append(Finding(name, plateau, error, "about 1/4"))
        own = np.array([c.length[grows] for c in groups[p]])
        own = own[np.isfinite(own).all(1)]
        if grows.sum() > 1 and len(own) > 1:
            curves.append(Lengths(p, mean.omega[grows], own))
    if len(curves) > 1:
        _note_collapse(study, curves)
    panels[0].set(xscale="log", yscale="log", xlabel=r"$\omega\tau_1$", ylabel="$l$  (units of $d$)")
    panels[0].set_title("(c) length where C crosses zero; dashed: L/4", fontsize=10)
    panels[0].legend(frameon=False, fontsize=8)
    panels[1].set(xlabel=r"$\omega\tau_1/p^{1/2}$", ylabel=r"$l\,(-\ln p)^{-0.65}$")
    panels[1].set_title(r"(d) collapse below 0.7 of the plateau, $\omega\tau_1$ < 0.02", fontsize=10)


def _note_collapse(study: Study, curves: list[Lengths]) -> None:
    """Note how far l(−ln p)^−c lies from one curve against ω/p^½, and for which c it lies nearest."""
    what = "Stokes drag, below 0.7 of the plateau and ω < 0.02: scatter of ln l(−ln p)^−c, "
    for c, remark in ((-0.65, "as printed"), (0.0, "no logarithm"), (0.65, "the other sign")):
        study.findings.append(Finding(f"{what}c = {c:g}", scatter(c, curves), np.nan, "—", remark))
    generator = np.random.default_rng(0)
    best = []
    for again in [False] + [True] * 200:
        drawn = curves
        if again:
            rows = [generator.integers(len(curve.samples), size=len(curve.samples) - 1) for curve in curves]
            drawn = [curve._replace(samples=curve.samples[k]) for curve, k in zip(curves, rows, strict=True)]
        best.append(minimize_scalar(scatter, args=(drawn,), bounds=(-3, 3), method="bounded").x)
    study.findings.append(Finding("c of the least scatter", best[0], float(np.std(best[1:])), "−0.65"))


def scatter(c: float, curves: list[Lengths]) -> float:
    """Return the rms distance of ln l(−ln p)^−c from a parabola in ln ω/p^½, over curves at several p."""
    points = []
    for curve in curves:
        X, Y = log_corrected(c, p=curve.p)
        points.append(np.log([curve.omega * X, curve.samples.mean(0) * Y]))
    x, y = np.concatenate(points, axis=1)
    return float(np.sqrt(np.mean((y - np.polyval(np.polyfit(x, y, 2), x)) ** 2)))
