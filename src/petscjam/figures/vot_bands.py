"""Two shear bands on the contour of constant P: maps, profiles, friction, lever rule (VOT figs. 27, 28, 34)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from petscjam.analysis.statistics import standard_error
from petscjam.analysis.transitions import Located
from petscjam.base.errors import InputError
from petscjam.figures.flows import Drawing
from petscjam.figures.large import Crossing, Large, coexisting, half
from petscjam.figures.vot import AXES, canvas, finish
from petscjam.md.banding import Bands
from petscjam.md.fields import local_maps, profile
from petscjam.md.grid import Point
from petscjam.md.result import blocked_error
from petscjam.plots.figure import LOSS
from petscjam.plots.shear import draw_profiles, plot_maps

LAYERS = 20  # of the table of a map
STATES = {"B": ("o", "Bagnoldian"), "N": ("^", "Newtonian"), "bands": ("s", "bands")}
BAGNOLDIAN = 1.5  # d ln P/d ln γ̇ above it
PAPER = {  # of both bands at P = 2e-5
    "φB*": "0.7880",
    "φN*": "0.8090",
    "γ̇B*": "6.2e-5",
    "γ̇N*": "4.2e-6",
    "P": "2e-5",
    "μ": "0.346",
}


def maps(scan: Large) -> Drawing:
    """Local packing fraction and strain rate at the end of the run in the middle of the contour (VOT fig. 27)."""
    point = scan.contour[len(scan.contour) // 2]
    yield
    state = scan.runs[point].state
    _note_bands(scan, point)
    phi, rate = local_maps(state)
    y = state.positions[:, 1] % state.height
    layer = (y / state.height * LAYERS).astype(int)
    for name, values in (("local φ", phi), ("local γ̇", rate)):
        for m in range(LAYERS):
            some = values[(layer == m) & np.isfinite(values)]
            if len(some) > 1:
                middle, error = (m + 0.5) * state.height / LAYERS, float(standard_error(some))
                scan.data.page.number(
                    f"{name}, mean over disks of a layer, against y", middle, float(some.mean()), error
                )
    scan.data.page.tallies.append(scan.flows.tally)
    plot_maps(state, scan.data.picture)


def profiles(scan: Large) -> Drawing:
    """vx(y), γ̇(y) and φ(y) at the points of the contour, with f and f′, of the second half of a run (VOT fig. 28)."""
    points = scan.contour
    yield
    figure, panels = canvas(3, len(points))
    for point, column in zip(points, panels.T, strict=True):
        run, at = scan.runs[point], f"φ = {point.phi:g}, γ̇ = {point.rate:g}"
        found = _note_bands(scan, point)
        draw_profiles(column, run, found)
        column[0].set_title(at)
        p = found.profile if found else profile(run)
        for name, values, errors in (("vx", p.vx, p.vx_error), ("γ̇", p.rate, p.rate_error), ("φ", p.phi, p.phi_error)):
            for row in zip(p.y.tolist(), values.tolist(), errors.tolist(), strict=True):
                scan.data.page.number(f"{name}(y) at {at}", *row)
    finish(scan.flows, figure, panels)


def _note_bands(scan: Large, point: Point) -> Bands | None:
    """Note the numbers of both bands of a run, f and f′, or why there are none."""
    page, run, at = scan.data.page, scan.runs[point], f"at φ = {point.phi:g}, γ̇ = {point.rate:g}"
    try:
        found = coexisting(run)
    except InputError as problem:
        page.found(f"bands {at}", np.nan, np.nan, "", str(problem))
        return None
    e = found.errors
    numbers = {
        "φB*": (found.phi[0], e.phi[0]),
        "φN*": (found.phi[1], e.phi[1]),
        "γ̇B*": (found.rate[0], e.rate[0]),
        "γ̇N*": (found.rate[1], e.rate[1]),
        "P": (found.pressure, e.pressure),
        "μ": (found.friction, e.friction),
        "f, from φ": (found.share_phi[0], e.share_phi[0]),
        "f′, from γ̇": (found.share[0], e.share[0]),
        "width of an interface": (found.width, e.width),
    }
    for name, (value, error) in numbers.items():
        page.found(f"{name} {at}", float(value), float(error), scan.paper(PAPER.get(name, "")))
    before, after = np.array_split(run.pressure, 4)[2:]
    ratio = float(after.mean() / before.mean())
    error = ratio * float(np.hypot(blocked_error(after) / after.mean(), blocked_error(before) / before.mean()))
    page.found(f"P of the last quarter / P of the third {at}", ratio, error, "1", "in the steady state")
    return found


def lever_rule(found: Bands) -> Located:
    """Return f′φB* + (1 − f′)φN* with the share f′ from the strain rates (VOT Appendix B).

    It is φ, if the width of the interfaces is negligible.
    """
    share, (low, high) = found.share[0], found.phi
    e = found.errors
    parts = ((high - low) * e.share[0], share * e.phi[0], (1 - share) * e.phi[1])
    return Located(float(share * low + (1 - share) * high), float(np.linalg.norm(parts)))


def friction(scan: Large) -> Drawing:
    """μ against φ and γ̇ at constant P, and the lever rule (VOT fig. 34).

    At each φ, γ̇ and μ are interpolated between two runs: linearly in ln γ̇ and ln P.
    """
    branches, contour = scan.scan, scan.contour
    yield
    page, level = scan.data.page, scan.parameters["pressure"]
    figure, panels = canvas(1, 2)
    for start, points in branches.items():
        some = scan.crossings(points)
        if not some:
            reason = f"P = {level:g} is not passed between two rates at any φ"
            page.found(f"μ on the contour, {start}", np.nan, np.nan, scan.paper("0.346"), reason)
        _note_ends(scan, start, some)
        for crossing in some:
            marker, label = STATES[_state(scan, crossing)]
            face = {} if start == "random start" else {"mfc": "white"}
            rate, mu = crossing.rate, crossing.friction
            style = {"fmt": marker, "color": "k", "ms": 6, "lw": 0.8, **face}
            panels[0, 0].errorbar(crossing.phi, *mu, **style)
            panels[0, 1].errorbar(rate.value, mu.value, mu.error, rate.error, label=f"{label}, {start}", **style)
            page.number(f"μ, {label}, {start}, against φ", crossing.phi, *mu)
            page.number(f"γ̇, {label}, {start}, against φ", crossing.phi, *rate)
    for phi, point in zip(scan.parameters.points("contour_phi").tolist(), contour, strict=True):
        run = scan.runs[point]
        P, measured = (run.mean(what, half(run)) for what in ("pressure", "friction"))
        at = f"φ = {phi:g}, γ̇ = {point.rate:g}, where P = {P.value:.3g}"
        page.found(f"μ at {at}", *measured, scan.paper("0.346"))
        page.number("μ of the runs of fig. 28 against φ", phi, *measured)
        for axes, x in zip(panels[0], (phi, point.rate), strict=True):
            axes.errorbar(x, *measured, fmt="*", ms=10, color=LOSS, label="runs of fig. 28")
        try:
            found = lever_rule(coexisting(run))
        except InputError as problem:
            page.found(f"lever rule at {at}", np.nan, np.nan, f"{phi:g}", str(problem))
        else:
            page.found(f"f′φB* + (1 − f′)φN* at {at}", *found, f"{phi:g}", "φ, for interfaces without width")
    for axes in panels[0]:
        axes.set(ylabel=r"$\mu$", title=f"P = {level:g}, interpolated between runs")
    panels[0, 0].set(xlabel=AXES["phi"])
    panels[0, 1].set(xlabel=AXES["rate"], xscale="log")
    page.tallies.append(
        "γ̇ at which P passes the contour, and μ there, are interpolated linearly in ln P and ln γ̇ between two runs."
    )
    finish(scan.flows, figure, panels)


def _note_ends(scan: Large, start: str, crossings: Sequence[Crossing]) -> None:
    """Note where the contour leaves homogeneous Bagnoldian flow (largest φ) and reaches Newtonian flow (smallest φ)."""
    for side, pick, phi, rate in (("B", max, "0.790", "5.06e-5"), ("N", min, "0.8062", "5.2e-6")):
        homogeneous = [c for c in crossings if _state(scan, c) == side]
        if homogeneous:
            end = pick(homogeneous, key=lambda c: c.phi)
            scan.data.page.found(f"φ{side} on the contour, {start}", end.phi, np.nan, scan.paper(phi))
            scan.data.page.found(f"γ̇{side} on the contour, {start}", *end.rate, scan.paper(rate))


def _state(scan: Large, crossing: Crossing) -> str:
    if crossing.banding > scan.parameters["threshold"]:
        return "bands"
    return "B" if crossing.slope > BAGNOLDIAN else "N"
