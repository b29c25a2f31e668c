"""Figure of the quasi-static response: relative displacements at contacts, non-affine displacements (BT Fig. 5).

Axes: i disk of the backbone, c contact, m pressure.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from petscjam.analysis.nonaffine import MOTIONS, QuasistaticResponse
from petscjam.analysis.statistics import by_pressure, grouped, means, nominal
from petscjam.plots.figure import LOSS, STABLE, STORAGE, arrows, draw_cell, scale_bar, solids
from petscjam.plots.legends import Shades, given, heading, setting

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LABELS = {
    "parallel": r"$|\Delta u^\parallel|/\gamma$",
    "transverse": r"$|\Delta u^\perp|/\gamma$",
    "nonaffine": r"$|u_\mathrm{na}|/\gamma$",
}
STYLES = dict(zip(MOTIONS, ((STORAGE, "s"), (LOSS, "o"), (STABLE, "^")), strict=True))


def nonaffine_figure(results: Mapping[str, QuasistaticResponse]) -> Figure:
    """Draw the distributions, medians and means against pressure, and the motion of the first packing.

    Distributions pool the packings of one pressure. Filled symbols and solid lines are with pre-stress, open ones
    and dashed lines without. Unstable packings are left out, unless all are unstable.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 8), layout="constrained")
    panels = figure.subplot_mosaic([["parallel", "transverse", "nonaffine"], ["scaling", "scaling", "field"]])
    kept, note = solids(results)
    shades = Shades("pressure", [nominal(r.origin.pressure) for r in results.values()])
    for motion in MOTIONS:
        draw_distribution(panels[motion], list(kept.values()), motion, shades)
    for prestress in sorted({r.prestress for r in kept.values()}, reverse=True):
        panels[MOTIONS[-1]].plot([], [], "-" if prestress else "--", color="0.4", label=given(prestress))
    shades.show(panels[MOTIONS[-1]], markers=False)
    _draw_scaling(panels["scaling"], list(kept.values()))
    draw_field(panels["field"], next(iter(results.values())))
    figure.suptitle(f"quasi-static response: {heading(kept)}{note}")
    return figure


def draw_distribution(axes: Axes, results: list[QuasistaticResponse], motion: str, shades: Shades) -> None:
    """Draw the probability density of the logarithm of a motion, one line for each pressure.

    Parameters
    ----------
    axes
        Of matplotlib.
    results : list of QuasistaticResponse
    motion : str
        One of :data:`petscjam.analysis.nonaffine.MOTIONS`.
    shades : Shades
        Of the pressures.
    """
    groups = grouped(results, lambda r: (nominal(r.origin.pressure), r.prestress))
    for (pressure, prestress), some in groups.items():
        sizes = np.concatenate([r.sizes(motion) for r in some])
        if not sizes.any():
            continue
        there = np.log10(sizes[sizes > 0])
        density, edges = np.histogram(there, bins=int(np.clip(len(there) ** (1 / 2), 4, 60)), density=True)
        middle, style = (edges[1:] + edges[:-1]) / 2, "-" if prestress else "--"
        axes.semilogx(10**middle, density, style, color=shades(pressure), lw=1.2)
    axes.set(xlabel=f"{LABELS[motion]}  ($d$)", ylabel=r"density of $\log_{10}$")


def _draw_scaling(axes: Axes, results: list[QuasistaticResponse]) -> None:
    for motion in MOTIONS:
        colour, marker = STYLES[motion]
        for prestress in (True, False):
            groups = by_pressure(results, prestress=prestress)
            if not groups:
                continue
            label, face = f"median {LABELS[motion]}, {given(prestress)}", colour if prestress else "white"
            medians = means([np.median(r.sizes(motion)) for r in some] for some in groups.values())
            axes.errorbar(list(groups), *medians, fmt=marker, color=colour, mfc=face, ms=6, label=label)
            mean, _ = means([r.sizes(motion).mean() for r in some] for some in groups.values())
            axes.plot(list(groups), mean, ":" if prestress else "-.", color=colour, lw=1)
    axes.plot([], [], "k:", lw=1, label="means (dash-dotted: without pre-stress)")
    axes.set(xscale="log", yscale="log", xlabel="pressure $p$  ($k$)", ylabel="motion per unit strain  ($d$)")
    axes.legend()


def draw_field(axes: Axes, r: QuasistaticResponse) -> None:
    """Draw u_na as arrows; the root mean square has the length of 1.6 spacings of disks.

    Parameters
    ----------
    axes
        Of matplotlib.
    r : QuasistaticResponse
    """
    box = r.geometry.box
    x = box.wrap(r.geometry.positions)[r.disks]
    spacing = np.sqrt(box.area / len(r.geometry))
    size = np.sqrt((r.nonaffine**2).sum(1).mean()) or 1.0
    arrows(axes, x, r.nonaffine * 1.6 * spacing / size, width=0.0035, color=STORAGE)
    draw_cell(axes, box)
    axes.set(aspect="equal", xticks=[], yticks=[])
    axes.set_frame_on(False)
    axes.set_title(f"non-affine motion, {setting('pressure', nominal(r.origin.pressure))}, {given(r.prestress)}")
    scale_bar(axes, r.geometry.mean_diameter)
