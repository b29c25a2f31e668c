"""Figure of quasi-static shear: stress, contacts and lowest eigenvalue along the path, with the events."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from petscjam.analysis.aqs import ShearPath
from petscjam.plots.figure import LOSS, STABLE, STORAGE, UNSTABLE
from petscjam.plots.legends import Families, heading

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARKS = {"made": ("^", STABLE), "lost": ("v", LOSS), "made and lost": ("d", STORAGE), "instability": ("x", UNSTABLE)}
MOST = 8  # paths with marks


def path_figure(results: Mapping[str, ShearPath]) -> Figure:
    """Draw σ_xy, Z and the lowest eigenvalue against strain; up to eight paths have marks at their events."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 7.6), layout="constrained")
    panels = figure.subplots(3, sharex=True, height_ratios=(2, 1, 1))
    few, families = len(results) <= MOST, Families(results)
    for family in families.members:
        for path in family.results.values():
            for axes, y in zip(panels, (path.stress, path.Z, path.eigenvalue), strict=True):
                axes.plot(path.gamma, y, color=family.colour, lw=1 if few else 0.5)
    for kind, (mark, colour) in MARKS.items() if few else ():
        at = [
            (path.gamma[k], path.stress[k])
            for path in results.values()
            for e, k in enumerate(path.events)
            if path.kind(e) == kind
        ]
        if at:
            label = kind if kind == "instability" else f"contacts {kind}"
            panels[0].plot(*np.transpose(at), mark, color=colour, ms=5, mfc="none", label=label)
    labels = r"stress $\sigma_{xy}$  ($k$)", "contacts $Z$", r"lowest eigenvalue $\lambda$  ($k$)"
    for axes, label in zip(panels, labels, strict=True):
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
    panels[2].set(xlabel=r"strain $\gamma$", yscale="log")
    events = sum(len(path.events) for path in results.values())
    unstable = sum(int((~path.reversible).sum()) for path in results.values())
    title = f"{len(results)} path{'s' * (len(results) != 1)}, {events} events, {unstable} instabilities"
    panels[0].set_title(f"{title}: {heading(results)}")
    families.show(panels[0])
    return figure
