"""BT Fig. 7: correlations of the non-affine displacements, and their length under Stokes drag.

Axes: w frequency, d distance.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from petscjam.analysis.correlations import (
    CorrelationLength,
    collapse_length,
    correlation_length,
    correlations,
)
from petscjam.damping import ContactDamping, StokesDrag
from petscjam.figures.study import Finding, Study, by_pressure
from petscjam.parallel.comm import on_root
from petscjam.plots.figure import by_pressure as coloured
from petscjam.plots.figure import save


def draw(study: Study, picture: Path) -> None:
    """Make and draw it."""
    contact: dict[str, Any] = {}
    few = {"omegas": study["contact_omega"]}
    for n in study["sizes"]:
        files = study.packings(n, study["contact_pressure"])
        made = study.survey(files, correlations, few, tag=f"contact-N{n}", laws=[ContactDamping()])
        contact |= {f"{n} {name}": c for name, c in study.tally(made, f"contact damping, N = {n}").items()}
    files = study.packings(study["particles"], study["pressure"])
    stokes = study.survey(files, correlations, {"omegas": study["omega"]}, tag="stokes", laws=[StokesDrag()])
    on_root(study.comm, _draw, study, contact, study.tally(stokes, "Stokes drag"), picture)


def _draw(study: Study, contact: Mapping[str, Any], stokes: Mapping[str, Any], picture: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 9.5), layout="constrained")
    panels = figure.subplots(2, 2)
    _draw_contact(study, panels[0, 0], contact)
    groups = by_pressure(stokes)
    lengths = {p: correlation_length(dict(enumerate(some))) for p, some in groups.items()}  # type: ignore[arg-type]
    _draw_stokes(panels[0, 1], groups, lengths, float(study["shown_pressure"]))
    _draw_lengths(study, panels[1], groups, lengths)
    save(figure, picture)


def _draw_contact(study: Study, axes: Any, results: Mapping[str, Any]) -> None:
    """Draw C under contact damping against δ/L, for all sizes and frequencies; note where it crosses zero."""
    sizes = sorted({c.packing["particles"] for c in results.values()})
    for k, n in enumerate(sizes):
        some = {name: c for name, c in results.items() if c.packing["particles"] == n}
        mean, L = correlation_length(some), np.mean([c.L for c in some.values()])
        for w, omega in enumerate(mean.omega):
            label = rf"N = {n}, $\omega\tau_1$ = {omega:.0e} ({len(some)})"
            axes.plot(mean.delta / L, mean.C[w], ("-", "--", ":")[k % 3], color=f"C{w}", lw=1.2, label=label)
            found = Finding(f"contact damping, N = {n}: l/L at ω = {omega:.0e}", mean.length[w] / L,
                            mean.error[w] / L, "about 1/4")  # fmt: skip
            study.findings.append(found)
    axes.axhline(0, color="0.6", lw=0.8)
    pressure = next(iter(results.values())).packing["pressure"]
    axes.set(xlabel=r"$\delta/L$", ylabel="$C$", ylim=(-1, 1.02))
    axes.set_title(f"(a) contact damping, p = {pressure:.2g}; (number of packings)", fontsize=10)
    axes.legend(frameon=False, fontsize=8)


def _draw_stokes(
    axes: Any, groups: Mapping[float, list[Any]], lengths: Mapping[float, CorrelationLength], shown: float
) -> None:
    """Draw C under Stokes drag at one pressure, for every second frequency."""
    from matplotlib import colormaps

    p = min(groups, key=lambda p: abs(np.log(p / shown)))
    mean, L = lengths[p], np.mean([c.L for c in groups[p]])
    for w in range(0, len(mean.omega), 2):
        colour = colormaps["viridis"](0.9 * w / len(mean.omega))
        label = rf"$\omega\tau_1$ = {mean.omega[w]:.0e}"
        axes.plot(mean.delta / L, mean.C[w], color=colour, lw=1.2, label=label)
    axes.axhline(0, color="0.6", lw=0.8)
    axes.set(xlabel=r"$\delta/L$", ylabel="$C$", ylim=(-1, 1.02))
    particles = groups[p][0].packing["particles"]
    axes.set_title(f"(b) Stokes drag, p = {p:.2g}, N = {particles} ({len(groups[p])} packings)", fontsize=10)
    axes.legend(frameon=False, fontsize=7)


def _draw_lengths(
    study: Study, panels: Any, groups: Mapping[float, list[Any]], lengths: Mapping[float, CorrelationLength]
) -> None:
    """Draw the length against the frequency for every pressure, raw and with the paper's rescaling."""
    colour = coloured(list(groups))
    for p, mean in lengths.items():
        L = np.mean([c.L for c in groups[p]])
        panels[0].errorbar(mean.omega, mean.length, mean.error, fmt="o-", ms=4, lw=0.8, color=colour(p),
                           label=f"p = {p:.2g} ({len(groups[p])})")  # fmt: skip
        panels[0].axhline(L / 4, color="0.6", lw=0.8, ls="--")
        x, y = collapse_length(mean.omega, mean.length, np.full(len(mean.omega), p))
        below = mean.length < 0.8 * L / 4
        panels[1].plot(x[below], y[below], "o", ms=4, color=colour(p))
        low = Finding(f"Stokes drag, p = {p:.2g}: plateau l/L at the lowest ω", mean.length[0] / L,
                      mean.error[0] / L, "about 1/4")  # fmt: skip
        study.findings.append(low)
        growing = below & (mean.omega < 0.1 * np.sqrt(p)) & np.isfinite(mean.length)
        if growing.sum() > 2:
            slope, _ = np.polyfit(np.log(mean.omega[growing]), np.log(mean.length[growing]), 1)
            remark = (
                f"ω from {mean.omega[growing][0]:.0e} to {mean.omega[growing][-1]:.0e}, no error estimated"
            )
            study.findings.append(Finding(f"Stokes drag, p = {p:.2g}: l ~ ω^x", slope, np.nan, "—", remark))
    panels[0].set(xscale="log", yscale="log", xlabel=r"$\omega\tau_1$", ylabel="$l$  (units of $d$)")
    panels[0].set_title("(c) length where C crosses zero; dashed: L/4", fontsize=10)
    panels[0].legend(frameon=False, fontsize=8)
    panels[1].set(xscale="log", yscale="log", xlabel=r"$\omega\tau_1/p^{1/2}$",
                  ylabel=r"$l\,(-\ln p)^{0.65}$")  # fmt: skip
    panels[1].set_title("(d) collapse as in the paper, below 0.8 of the plateau", fontsize=10)
