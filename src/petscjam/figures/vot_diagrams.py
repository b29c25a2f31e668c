"""P^el, μ and Rv against φ at several strain rates, and the phase diagrams from them (VOT figs. 22–26, 29, 35, 36)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from petscjam.analysis.transitions import JAMMING, Located
from petscjam.figures.flows import Drawing
from petscjam.figures.large import MISSING, SIDES, Edge, Large, half
from petscjam.figures.vot import AXES, P_EL, Quantity, canvas, draw_lines, finish
from petscjam.plots.figure import LOSS, STORAGE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MU = Quantity(r"$\mu = \Sigma/P$", "μ", "friction")
RV = Quantity(r"$R_v$", "Rv", "banding")
QUANTITIES = {"P_el": P_EL, "μ": MU, "Rv": RV}
MARKERS = {"P_el": "s", "μ": "o", "Rv": "D", "bands": "*"}
COLOURS = {"B": STORAGE, "N": LOSS}
PLANES = {  # axes of a diagram: labels, by name of the attribute of an edge
    "phi": AXES["phi"],
    "rate": AXES["rate"],
    "pressure": r"$P$  ($m/\tau_e^2$)",
    "stress": r"$\Sigma$  ($m/\tau_e^2$)",
}
SYMBOLS = {"phi": "φ", "rate": "γ̇", "pressure": "P", "stress": "Σ"}
STARTS = "filled: random start, open: two-phase start"
YIELD = 0.1  # μJ of VOT
LIMIT = "< 5e-4"  # γ̇ of the critical end point (VOT sec. III C)
NO_END = "not determined: fewer than three runs with bands, or φN* − φB* does not decrease by two standard errors"


def against_phi(scan: Large, how: str) -> Drawing:
    """A quantity against φ at all rates, and the boundaries of coexistence from it (VOT figs. 22–24).

    Random starts have filled symbols, two-phase starts open ones; large open symbols are boundaries.

    Parameters
    ----------
    scan : Large
    how : str
        ``P_el``, ``μ`` or ``Rv``.
    """
    branches, quantity = scan.scan, QUANTITIES[how]
    yield
    figure, panels = canvas(1, 1)
    axes = panels[0, 0]
    random = branches["random start"]
    for start, points in (("random start", random), ("two-phase start", scan.two_phase(random))):
        filled = start == "random start"
        draw_lines(scan.data, axes, points, scan.runs, quantity, "phi", "rate", note=start, filled=filled)
    axes.set(yscale="linear" if how == "μ" else "log", title=STARTS)
    if how == "μ":
        runs = [scan.runs[p] for points in branches.values() for p in points]
        shares = [-run.mean("dissipative_xy").value / run.mean("stress").value for run in runs]
        remark = f"from {min(shares):.2g} to {max(shares):.2g} in single runs"
        scan.data.page.mean("σ^dis/σ, mean over runs", shares, "0.1 to 0.2", remark)
    edges = scan.edges([how])
    note(scan, edges)
    scan.tally_lost()
    for edge in edges:
        if np.isfinite(edge.phi.value):
            points = [p for p in branches[edge.start] if p.rate == edge.rate.value]
            x, values, _ = scan.table(points, "phi", quantity.what)
            at = np.exp(np.interp(edge.phi.value, x, np.log(values.mean(0))))
            axes.plot(edge.phi.value, at, MARKERS[how], ms=11, mfc="none", mec=COLOURS[edge.side])
    finish(scan.flows, figure, panels)


def note(scan: Large, edges: Sequence[Edge]) -> None:
    """Note φ of the boundaries, in pairs (B, N), or why they are not determined.

    Parameters
    ----------
    scan : Large
    edges : sequence of Edge
    """
    for low, high in zip(edges[::2], edges[1::2], strict=True):
        at = f"at γ̇ = {low.rate.value:g} from {low.how}, {low.start}"
        if np.isnan([low.phi.value, high.phi.value]).all():
            scan.data.page.found(f"φB and φN {at}", np.nan, np.nan, "", MISSING[low.how])
            continue
        for edge in (low, high):
            remark = "" if np.isfinite(edge.phi.value) else f"at the end of the range: {MISSING[edge.how]}"
            if (
                edge.start == "two-phase start"
                and np.isfinite(edge.phi.value)
                and not scan.guess.contains(edge.phi.value)
            ):
                remark = "beyond the two-phase starts: coexistence may extend further"
            scan.data.page.found(f"φ{edge.side} {at}", *edge.phi, "", remark)


def draw_edges(scan: Large, axes: Axes, edges: Sequence[Edge], x: str, y: str) -> None:
    """Draw boundaries in a plane, filled for random starts and open for two-phase starts, and add them to the table.

    Parameters
    ----------
    scan : Large
    axes
        Of matplotlib.
    edges : sequence of Edge
        Those that are not determined are left out.
    x, y : str
        ``phi``, ``rate``, ``pressure`` or ``stress``.
    """
    for edge in edges:
        here, there = getattr(edge, x), getattr(edge, y)
        if not np.isfinite([here.value, there.value]).all():
            continue
        random, colour, star = edge.start == "random start", COLOURS[edge.side], "*" * (edge.how == "bands")
        what = f"{SIDES[edge.side]}, {edge.how}"
        axes.errorbar(
            here.value,
            there.value,
            np.minimum(np.nan_to_num(there.error), 0.9 * abs(there.value)),
            np.nan_to_num(here.error),
            fmt=MARKERS[edge.how],
            ms=9 if star else 6,
            lw=0.8,
            color=colour,
            mfc=colour if random else "white",
            label=what,
        )
        name, one, other = (SYMBOLS[x], there, here) if y == "rate" else (SYMBOLS[y], here, there)
        label = f"{name}{edge.side}{star} from {edge.how}, {edge.start}"
        scan.data.page.number(label, one.value, *other)
    axes.set(xlabel=PLANES[x], ylabel=PLANES[y])


def diagram(scan: Large, x: str, y: str) -> Drawing:
    """Draw all boundaries in a plane, the binodal from coexisting bands, and its end point (VOT figs. 25, 26, 29).

    Parameters
    ----------
    scan : Large
    x, y : str
        Attributes of :class:`Edge`.
    """
    branches, _ = scan.scan, scan.contour
    yield
    page, level = scan.data.page, scan.parameters["pressure"]
    figure, panels = canvas(1, 1)
    axes = panels[0, 0]
    edges, binodal = scan.edges(list(QUANTITIES)), scan.binodal()
    pairs = [edge for pair in binodal for edge in pair[1:]]
    draw_edges(scan, axes, [*edges, *pairs], x, y)
    end = scan.end_points(binodal)
    _note_end(scan, end)
    scan.tally_lost()
    if x == "phi":
        note(scan, edges)
        _shade(axes, edges)
        _note_limit(scan, edges)
        axes.axvline(JAMMING, ls="--", color="0.5", lw=0.8)
        line = np.array([(c.phi, c.rate.value) for c in scan.crossings(list(branches.values())[-1])])
        axes.plot(*line.reshape(-1, 2).T, "k--", lw=1, label=f"P = {level:g}")
    if x == "pressure" and y == "rate":
        axes.axvline(level, ls="--", color="k", lw=1, label=f"P = {level:g}")
    if y == "stress":
        ends = np.array([0.5, 2.0]) * np.array(_range([*edges, *pairs], level))
        axes.plot(ends, YIELD * ends, "-", color="0.5", lw=1, label=r"$\Sigma = 0.1 P$")
        for point, edge, _ in binodal:
            mu = scan.runs[point].mean("friction", half(scan.runs[point]))
            page.found(f"Σ/P of the bands at P = {edge.pressure.value:.3g}", *mu, scan.paper("0.346"))
    if x == "pressure" and np.isfinite(end[0].value):
        axes.axvline(end[0].value, color="0.7", lw=0.8)
    axes.set(yscale="log", xscale="linear" if x == "phi" else "log", title=STARTS)
    finish(scan.flows, figure, panels)


def _range(edges: Sequence[Edge], level: float) -> tuple[float, float]:
    """Return the lowest and the highest P of boundaries, or of the contour."""
    P = [edge.pressure.value for edge in edges if np.isfinite(edge.phi.value)] or [level]
    return min(P), max(P)


def _note_end(scan: Large, end: tuple[Located, Located]) -> None:
    """Note the end point of coexistence, from φN* − φB* → 0."""
    for name, found, paper in (("P", end[0], ""), ("γ̇", end[1], LIMIT)):
        remark = "" if np.isfinite(found.value) else NO_END
        scan.data.page.found(f"{name} at the critical end point, from φN* − φB*", *found, paper, remark)


def _note_limit(scan: Large, edges: Sequence[Edge]) -> None:
    """Note the middle of the coexistence at the lowest rate, for φc(γ̇ → 0)."""
    rate = scan.rates[0]
    for start in scan.scan:
        phi = [edge.phi for edge in edges if edge.how == "Rv" and edge.start == start and edge.rate.value == rate]
        value, error = sum(one.value for one in phi) / 2, float(np.linalg.norm([one.error for one in phi])) / 2
        remark = f"at γ̇ = {rate:g}" + (f"; {MISSING['Rv']}" if np.isnan(value) else "; the paper's is for γ̇ → 0")
        scan.data.page.found(f"middle of φB and φN from Rv, {start}", value, error, "0.807", remark)


def _shade(axes: Axes, edges: Sequence[Edge]) -> None:
    """Shade the coexistence between the boundaries from Rv."""
    for start in {edge.start for edge in edges}:
        sides = [
            {
                edge.rate.value: edge.phi.value
                for edge in edges
                if (edge.how, edge.side, edge.start) == ("Rv", side, start)
            }
            for side in SIDES
        ]
        rates = [rate for rate in sides[0] if np.isfinite([side[rate] for side in sides]).all()]
        low, high = ([side[rate] for rate in rates] for side in sides)
        axes.fill_betweenx(rates, low, high, color="0.9", lw=0, zorder=0)


def binodal(scan: Large) -> Drawing:
    """The boundaries from Rv, and (φ, γ̇) inside coexisting bands (VOT fig. 35)."""
    _ = scan.scan, scan.contour
    yield
    figure, panels = canvas(1, 1)
    edges, found = scan.edges(["Rv"]), scan.binodal()
    draw_edges(scan, panels[0, 0], [*edges, *(edge for pair in found for edge in pair[1:])], "phi", "rate")
    note(scan, edges)
    for point, bagnoldian, newtonian in found:
        at = f"in the bands at φ = {point.phi:g}, γ̇ = {point.rate:g}, {bagnoldian.start}"
        for edge in (bagnoldian, newtonian):
            scan.data.page.found(f"φ{edge.side}* {at}", *edge.phi, "")
            scan.data.page.found(f"γ̇{edge.side}* {at}", *edge.rate, "")
        scan.data.page.found(f"P {at}", *bagnoldian.pressure, "")
    _note_end(scan, scan.end_points(found))
    if not found:
        scan.data.page.tallies.append("No run has two bands.")
    scan.tally_lost()
    panels[0, 0].set(yscale="log", title=STARTS)
    finish(scan.flows, figure, panels)


def two_sizes(scan: Large) -> Drawing:
    """Rv against φ for two numbers of disks, random starts (VOT fig. 36)."""
    sizes = [int(scan.parameters[name]) for name in ("particles", "smaller")]
    rates = sorted(scan.parameters.points("size_rates").tolist())
    points = {n: scan.points(scan.phis, rates, n) for n in sizes}
    scan.flows.make([p for some in points.values() for p in some])
    yield
    figure, panels = canvas(1, 1)
    axes = panels[0, 0]
    for n, some in points.items():
        draw_lines(scan.data, axes, some, scan.runs, RV, "phi", "rate", note=f"N = {n}", filled=n == sizes[0])
    for rate in rates:
        for n, some in points.items():
            found = scan.boundaries([p for p in some if p.rate == rate], "Rv")
            width = found.newtonian.value - found.bagnoldian.value
            error = float(np.hypot(found.newtonian.error, found.bagnoldian.error))
            remark = MISSING["Rv"] if np.isnan(width) else ""
            scan.data.page.found(f"φN − φB at γ̇ = {rate:g}, N = {n}", width, error, "", remark)
    axes.set(yscale="log", title=f"filled: N = {sizes[0]}, open: N = {sizes[1]}")
    finish(scan.flows, figure, panels)
