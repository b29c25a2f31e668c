"""Figure of the quasi-static response: relative displacements at contacts, non-affine displacements (BT Fig. 5).

Axes: i disk of the backbone, c contact, m pressure.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.analysis.nonaffine import MOTIONS, QuasistaticResponse
from petscjam.analysis.statistics import by_pressure, grouped, means, nominal
from petscjam.plots.figure import LOSS, STORAGE, arrows, draw_cell, given, pressure_colours, solids

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LABELS = {
    "parallel": r"$|\Delta u^\parallel|/\gamma$",
    "transverse": r"$|\Delta u^\perp|/\gamma$",
    "nonaffine": r"$|u_\mathrm{na}|/\gamma$",
}
STYLES = dict(zip(MOTIONS, ((STORAGE, "s"), (LOSS, "o"), ("#2e6b34", "^")), strict=True))


def nonaffine_figure(results: Mapping[str, QuasistaticResponse]) -> Figure:
    """Draw the distributions, medians and means against pressure, and the motion of the first packing.

    Distributions pool the packings of one pressure. Filled symbols and solid lines are with pre-stress, open ones
    and dashed lines without. Unstable packings are left out, unless all are unstable.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 8), layout="constrained")
    panels = figure.subplot_mosaic([["parallel", "transverse", "nonaffine"], ["scaling", "scaling", "field"]])
    kept, title = solids(results)
    colours = pressure_colours([r.origin.pressure for r in results.values()])
    for motion in MOTIONS:
        draw_distribution(panels[motion], list(kept.values()), motion, colours)
    _draw_scaling(panels["scaling"], list(kept.values()))
    draw_field(panels["field"], next(iter(results.values())))
    figure.suptitle(f"Quasi-static response, {next(iter(results.values())).strain}: {title}", fontsize=11)
    return figure


def draw_distribution(axes: Axes, results: list[QuasistaticResponse], motion: str, colours: Any) -> None:
    """Draw the probability density of the logarithm of a motion, one line for each pressure.

    Parameters
    ----------
    axes
        Of matplotlib.
    results : list of QuasistaticResponse
    motion : str
        One of :data:`petscjam.analysis.nonaffine.MOTIONS`.
    colours : callable
        Returns the colour of a pressure.
    """
    groups = grouped(results, lambda r: (nominal(r.origin.pressure), r.prestress))
    for (pressure, prestress), some in groups.items():
        sizes = np.concatenate([r.sizes(motion) for r in some])
        if not sizes.any():
            continue
        density, edges = np.histogram(np.log10(sizes[sizes > 0]), bins=60, density=True)
        middle, style = (edges[1:] + edges[:-1]) / 2, "-" if prestress else "--"
        axes.semilogx(10**middle, density, style, color=colours(pressure), lw=1.2, label=f"p = {pressure:.2g}")
    axes.set(xlabel=LABELS[motion], ylabel=r"density of $\log_{10}$")
    if len(handles := dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))) <= 8:
        axes.legend(handles.values(), handles.keys(), frameon=False, fontsize=8)


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
    axes.set(xscale="log", yscale="log", xlabel="pressure $p$ (units of $k$)", ylabel="motion per unit strain")
    axes.legend(frameon=False, fontsize=8)


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
    axes.set_title(f"non-affine motion, p = {r.origin.pressure:.2g}, {given(r.prestress)}", fontsize=9)
