"""Σ against γ̇ at one packing fraction: steady shear, and ramps up and down (VOT figs. 30, 31)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from petscjam.analysis.coexistence import jump, jumps, loop
from petscjam.analysis.statistics import standard_error
from petscjam.analysis.transitions import Located
from petscjam.base.types import Array
from petscjam.figures.flows import Drawing, Ramp
from petscjam.figures.large import Large
from petscjam.figures.vot import AXES, Quantity, canvas, draw_lines, finish
from petscjam.figures.vot_diagrams import STARTS
from petscjam.md.grid import Point
from petscjam.md.result import Run
from petscjam.plots.figure import PALETTE
from petscjam.plots.legends import MARKERS
from petscjam.plots.shear import draw_slopes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STRESS = Quantity(r"$\Sigma$  ($m/\tau_e^2$)", "Σ", "stress")
ROW_TIME, FINEST = 1e3, 0.01  # of a row: τe (VOT sec. III D), and decades of γ̇ at most
WINDOW = 0.1  # decades of γ̇ in which Σ of a ramp is averaged


def _steady(scan: Large) -> dict[str, list[Point]]:
    """Return the runs at one φ, by start, as :attr:`Large.scan`. Collective."""
    rates = scan.parameters.points("ramp_rates").tolist()
    branches = scan.branches(scan.points([scan.parameters["ramp_phi"]], rates))
    scan.make([p for points in branches.values() for p in points])
    return branches


def _boundaries(scan: Large, branches: dict[str, list[Point]]) -> list[float]:
    """Note γ̇B and γ̇N, where Rv rises and falls, and return those that are found."""
    found, threshold = [], float(scan.parameters["threshold"])
    for start, points in branches.items():
        rates, Rv, _ = scan.table(points, "rate", "banding")
        for side, at in zip(("B", "N"), jumps(np.log(rates), Rv, threshold), strict=True):
            value = float(np.exp(at.value))
            remark = f"Rv does not exceed {threshold:g} inside the range of γ̇" if np.isnan(value) else ""
            scan.data.page.found(f"γ̇{side} from Rv, {start}", value, value * at.error, "", remark)
            found += [value] * bool(np.isfinite(value))
    return found


def steady(scan: Large) -> Drawing:
    """Steady Σ(γ̇) at one packing fraction (VOT fig. 30)."""
    branches = _steady(scan)
    yield
    figure, panels = canvas(1, 1)
    axes = panels[0, 0]
    for start, points in branches.items():
        filled = start == "random start"
        draw_lines(scan.data, axes, points, scan.runs, STRESS, "rate", "phi", note=start, filled=filled)
    for rate in _boundaries(scan, branches):
        axes.axvline(rate, ls="--", color="0.6", lw=0.8)
    rates, values, _ = scan.table(branches["random start"], "rate", "stress")
    axes.set(xscale="log", yscale="log", title=STARTS)
    draw_slopes(axes, rates, values.mean(0))
    finish(scan.flows, figure, panels)


def ramps(scan: Large) -> Drawing:
    """Σ in ramps of γ̇ up and down, jumps, and width of the hysteresis against κ̃ (VOT fig. 31)."""
    p = scan.parameters
    kappas = sorted(p.points("kappas").tolist())
    rate, to, phi = (float(p[name]) for name in ("ramp_from", "ramp_to", "ramp_phi"))
    n, seeds = int(p["particles"]), range(1, int(p["ramps"]) + 1)
    points = {
        kappa: [
            Ramp("CD_rot", n, phi, 1.0, rate, seed, to=to, kappa=kappa, row_time=min(ROW_TIME, FINEST / kappa))
            for seed in seeds
        ]
        for kappa in kappas
    }
    branches = _steady(scan)
    scan.flows.make([point for some in points.values() for point in some])
    yield
    edges = _boundaries(scan, branches)
    figure, panels = canvas(1, len(kappas) + 1)
    found = []
    for kappa, axes in zip(kappas, panels[0], strict=False):
        found.append(_draw_ramps(scan, axes, kappa, [scan.runs[point] for point in points[kappa]]))
        for edge in edges:
            axes.axvline(edge, ls="--", color="0.6", lw=0.8)
        title = rf"$\tilde\kappa$ = {kappa:g}; filled: up, open: down"
        axes.set(xlabel=AXES["rate"], ylabel=STRESS.symbol, title=title)
    for (y, error), label in zip(
        np.moveaxis(np.array(found), 0, -1), ("width, decades", "area, decades²"), strict=True
    ):
        panels[0, -1].errorbar(kappas, y, np.nan_to_num(error), fmt="o-", label=label)
    panels[0, -1].set(xscale="log", xlabel=r"$\tilde\kappa$  (decades/$\tau_e$)")
    panels[0, -1].set_ylabel("hysteresis  (decades, decades²)")
    finish(scan.flows, figure, panels)


def _draw_ramps(scan: Large, axes: Axes, kappa: float, runs: Sequence[Run]) -> list[Located]:
    """Draw the ramps of one κ̃, note their jumps, and return the width of the hysteresis and the area of the loop."""
    row = runs[0].settings.row_steps * runs[0].settings.dt * kappa
    rows, numbers, areas = max(round(WINDOW / row), 1), [], []
    for k, run in enumerate(runs):
        half, marker = int(run.rate.argmax()) + 1, MARKERS[k % len(MARKERS)]
        ways = [(run.rate[some], run.stress[some]) for some in (slice(0, half), slice(half, None))]
        for name, (rate, stress), face in zip(("up", "down"), ways, (PALETTE[k % len(PALETTE)], "white"), strict=True):
            good = stress > 0
            axes.loglog(rate[good], stress[good], marker, ms=4, mew=0.7, color=PALETTE[k % len(PALETTE)], mfc=face)
            for at, value in zip(rate, stress, strict=True):
                scan.data.page.number(f"Σ, {name}, κ̃ = {kappa:g}, start {k + 1}", float(at), float(value), np.nan)
        numbers.append([jump(*way, rows) for way in ways])
        areas.append(loop(*ways))
    rate, stress = (np.concatenate([getattr(run, name) for run in runs]) for name in ("rate", "stress"))
    draw_slopes(axes, rate, np.where(stress > 0, stress, np.nan))
    at, size = np.moveaxis(np.array(numbers), -1, 0)  # start, up and down
    remark = f"step over {rows} rows of {row:.2g} decades of γ̇"
    for k, name in enumerate(("up", "down")):
        _found(scan, f"γ̇ of the jump {name}, κ̃ = {kappa:g}", at[:, k], remark)
        _found(scan, f"decades of Σ in the jump {name}, κ̃ = {kappa:g}", size[:, k], remark)
    width = np.log10(at[:, 0] / at[:, 1])
    return [
        _found(scan, f"hysteresis in decades of γ̇, κ̃ = {kappa:g}", width, remark, "narrower for slower ramps"),
        _found(scan, f"area of the loop, decades of Σ × decades of γ̇, κ̃ = {kappa:g}", np.array(areas), ""),
    ]


def _found(scan: Large, name: str, samples: Array, remark: str, paper: str = "") -> Located:
    """Note the mean over starts and its error."""
    known = samples[np.isfinite(samples)]
    value = float(known.mean()) if len(known) else np.nan
    error = float(standard_error(known))
    scan.data.page.found(name, value, error, paper, remark if len(known) else "fewer rows with Σ > 0 than needed")
    return Located(value, error)
