"""How many low modes make up the quasi-static response (BT Fig. 5 seen from the modes), and their kind.

Axes: m mode, c contact, i disk.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from petscjam.analysis.density import density_of_states
from petscjam.analysis.nonaffine import MOTIONS, quasistatic_response
from petscjam.box import Array
from petscjam.figures.panels import errors
from petscjam.figures.study import Study, by_pressure
from petscjam.parallel.comm import on_root
from petscjam.plots.figure import by_pressure as coloured
from petscjam.plots.figure import save
from petscjam.plots.nonaffine import LABELS, STYLES
from petscjam.response.modes import Modes, lowest_modes

WITHIN = 0.1  # of the median of the direct solve: then the modes are enough


def draw(study: Study, picture: Path) -> None:
    """Make and draw it."""
    files = study.packings(study["particles"], study["pressure"])
    without = {"prestress": (False,)}
    direct = study.survey(files, quasistatic_response, {}, tag="direct", **without)
    modes = study.survey(files, lowest_modes, {"count": study["count"]}, tag="lowest", **without)
    density = study.survey(files, density_of_states, {"moments": study["moments"]}, tag="density", **without)
    on_root(study.comm, _draw, study, direct, modes, density, picture)


def _draw(
    study: Study,
    direct: Mapping[str, Any],
    modes: Mapping[str, Any],
    density: Mapping[str, Any],
    picture: Path,
) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 9), layout="constrained")
    panels = figure.subplot_mosaic([[*MOTIONS], ["needed", "floppiness", "density"]])
    groups = by_pressure(modes)
    colour = coloured(list(groups))
    needed: dict[str, list[list[float]]] = {motion: [] for motion in MOTIONS}
    for p, some in groups.items():
        counts = np.unique(np.geomspace(1, min(len(r.eigenvalues) for r in some), 40).astype(int))
        ratios = np.array([rebuilt(r, _direct(direct, r), counts) for r in some])  # packing, motion, count
        for k, motion in enumerate(MOTIONS):
            axes = panels[motion]
            share = counts / np.mean([2 * len(r.disks) for r in some])
            axes.semilogx(share, ratios[:, k].mean(0), color=colour(p), lw=1.2, label=f"p = {p:.2g}")
            needed[motion].append([enough(row, counts) for row in ratios[:, k]])
        _draw_floppiness(panels["floppiness"], some, colour(p), p)
    for motion in MOTIONS:
        ylabel = f"median of {LABELS[motion]}, over the direct one"
        panels[motion].set(xlabel="share of all modes", ylabel=ylabel, yscale="log")
        panels[motion].axhline(1, color="0.6", lw=0.8)
    panels["parallel"].legend(frameon=False, fontsize=8)
    _draw_needed(study, panels["needed"], np.array(list(groups)), needed)
    _draw_density(panels["density"], by_pressure(density), colour)
    ylabel = r"$(\Sigma\Delta u_\perp^2/\Sigma\Delta u_\parallel^2)^{1/2}$ of a mode"
    panels["floppiness"].set(xscale="log", yscale="log", xlabel=r"$\lambda^{1/2}$", ylabel=ylabel)
    particles = {r.packing["particles"] for r in modes.values()}
    figure.suptitle(f"N = {', '.join(map(str, particles))}, without pre-stress", fontsize=11)
    save(figure, picture)


def rebuilt(modes: Modes, direct: Mapping[str, float], counts: Array) -> Array:
    """Return the medians of each motion from the lowest modes over those of the direct solve, (3, counts)."""
    rows = []
    for m in counts:
        parts = modes.response(int(m))
        sizes = (abs(parts.parallel), abs(parts.transverse), np.linalg.norm(parts.nonaffine, axis=1))
        rows.append([np.median(x) / direct[motion] for x, motion in zip(sizes, MOTIONS, strict=True)])
    return np.array(rows).T


def enough(ratios: Array, counts: Array) -> float:
    """Return the least number of modes from which on the ratio stays within ``WITHIN`` of 1; NaN if none."""
    off = np.flatnonzero(abs(ratios - 1) > WITHIN)
    first = off[-1] + 1 if len(off) else 0
    return float(counts[first]) if first < len(counts) else np.nan


def _direct(direct: Mapping[str, Any], modes: Modes) -> dict[str, float]:
    (one,) = (r for r in direct.values() if r.packing["checksum"] == modes.packing["checksum"])
    return {motion: float(np.median(one.sizes(motion))) for motion in MOTIONS}


def _draw_floppiness(axes: Any, some: list[Modes], colour: Any, p: float) -> None:
    frequency = np.concatenate([r.frequencies for r in some])
    floppiness = np.concatenate([r.floppiness for r in some])
    edges = np.geomspace(frequency.min(), frequency.max() * 1.001, 40)
    which = np.digitize(frequency, edges)
    bins = [k for k in range(1, len(edges)) if (which == k).any()]
    middle = [np.exp(np.log(frequency[which == k]).mean()) for k in bins]
    axes.plot(middle, [np.median(floppiness[which == k]) for k in bins], color=colour, lw=1.2)


def _draw_needed(study: Study, axes: Any, p: Array, needed: Mapping[str, list[list[float]]]) -> None:
    """Draw how many modes it takes, and note how that number depends on p."""
    for motion in MOTIONS:
        colour, marker = STYLES[motion]
        known = [k for k, some in enumerate(needed[motion]) if np.isfinite(some).all()]
        samples = [needed[motion][k] for k in known]
        if not known:
            continue
        mean, error = errors(samples)
        axes.errorbar(p[known], mean, error, fmt=marker, color=colour, label=LABELS[motion])
        study.exponent(f"modes needed for the median of {motion} motion ~ p^x", p[known], samples, "—")
    axes.set(
        xscale="log", yscale="log", xlabel="pressure $p$", ylabel=f"modes for a median within {WITHIN:.0%}"
    )
    axes.legend(frameon=False, fontsize=8)


def _draw_density(axes: Any, groups: Mapping[float, list[Any]], colour: Any) -> None:
    """Draw the mean density of states over packings."""
    for p, some in groups.items():
        omega = np.geomspace(1e-3, min(r.edge for r in some) * 0.999, 400)
        axes.loglog(omega, np.mean([r.at(omega).density for r in some], axis=0), color=colour(p), lw=1.2)
    axes.set(xlabel=r"$\omega$, unit masses", ylabel=r"$D(\omega)$", ylim=(1e-2, 2))
