"""Figure of a packing: disks, contact forces, rattlers; and of its preparation.

Axes: i disk, c contact, x Cartesian, l lattice vector.
"""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.base.types import Array
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.packing import Packing
from petscjam.plots.figure import LOSS, STABLE, STORAGE, UNSTABLE, disks, finished, house_style, scale_bar
from petscjam.plots.legends import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase

SMALL, LARGE, RIM, FORCE = "#e9eff6", "#cbd9e8", "#8fa3b8", "#b03a1e"
RATTLER, CAGED = "#7a5c00", "#fbeeb8"
OUTLINED = 20_000  # disks; larger packings are drawn without outlines, and as pixels in vector formats
FORCE_WIDTH = 0.11  # mean diameters, width of the line of the mean contact force
CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
VERDICTS = {None: ("not judged", "0.45"), True: ("proved minimum", STABLE), False: ("not proved", UNSTABLE)}


@house_style()
def plot_packing(packing: Packing, path: str | PathLike[str] | None = None, *, ax: Axes | None = None) -> Figure:
    """Draw one cell of ``packing``, cut at its edges.

    Contact forces are lines from centre to centre, with a width proportional to the force. A contact or a disk
    across an edge is also drawn at the opposite edge. Rattlers are yellow and dashed. The bar is a length in mean
    diameters. With ``history`` in the
    provenance — equally long lists ``evaluations`` (of the forces, so far), ``pressure``, ``force`` (the largest
    on a disk) and ``phi`` — pressure, force and packing fraction are drawn next to it.

    Parameters
    ----------
    packing : Packing
    path : path, optional
        Write the figure; its extension gives the format.
    ax
        Of matplotlib: draw the packing here, without its history.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If two disks have the same position, or the figure cannot be written.
    """
    from matplotlib.figure import Figure

    size = float(np.clip(0.22 * np.sqrt(len(packing)), 6.0, 12.0))  # inches
    width, height = np.ptp(CORNERS @ packing.box.cell, axis=0)
    tall = size * float(min(height / width, 2.0)) + 0.6
    history = _history(packing)
    if ax is not None:
        box = ax.get_window_extent()
        draw_packing(ax, packing, float(box.width) / ax.figure.dpi)
        return finished(ax.figure, path)
    if history is None:
        figure = Figure(figsize=(size, tall), layout="constrained")
        draw_packing(figure.subplots(), packing, size)
    else:
        figure = Figure(figsize=(1.75 * size, max(tall, 5.0)), layout="constrained")
        halves: Any = figure.subfigures(1, 2, width_ratios=[1, 0.75])
        draw_packing(halves[0].subplots(), packing, size)
        _draw_history(halves[1], history, packing.provenance.get("pressure"))
    return finished(figure, path)


def draw_packing(axes: Axes, packing: Packing, size: float, *, caption: bool = True) -> None:
    """Draw a packing.

    Parameters
    ----------
    axes
        Of matplotlib.
    packing : Packing
    size : float
        Width of the axes, inches.
    caption : bool
        Draw the title, the legend and the scale.
    """
    from matplotlib.colors import to_rgba_array
    from matplotlib.patches import Polygon

    network, box, radii = ContactNetwork.of(packing), packing.box, packing.radii
    corners = CORNERS @ box.cell
    low, high = corners.min(0), corners.max(0)
    extent = float(max(high[0] - low[0], (high[1] - low[1]) / 2))
    cut = Polygon(corners, fc="none", ec="0.35", lw=1, zorder=4)
    axes.add_patch(cut)
    many = len(packing) > OUTLINED
    disk, centre = box.images(packing.positions, radii.max())

    def draw(collection: Any) -> None:
        collection.set_rasterized(many)
        axes.add_collection(collection, autolim=False)
        collection.set_clip_path(cut)

    shade = (radii - radii.min()) / max(np.ptp(radii), 1e-12 * radii.max())
    small, large = to_rgba_array([SMALL, LARGE])
    face = small + shade[:, None] * (large - small)
    face[~network.backbone] = to_rgba_array(CAGED)
    pixels = 72 * size / extent * packing.mean_diameter  # width of a disk, points
    thin = min(0.8, 0.04 * pixels)
    for rattlers in (False, True):
        some = network.backbone[disk] != rattlers
        edge, wide = (RATTLER, 1.4 * thin) if rattlers else (RIM, thin)
        style = {
            "facecolors": face[disk[some]],
            "edgecolors": "none" if many else edge,
            "linewidths": 0 if many else wide,
            "linestyles": (0, (3, 2)) if rattlers else "solid",
            "zorder": 1 + rattlers,
        }
        draw(disks(axes, centre[some], radii[disk[some]], **style))
    if len(network):
        draw(_forces(packing, network, pixels))
    margin = 0.01 * extent
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set(aspect="equal", xticks=[], yticks=[])
    axes.set_frame_on(False)
    if caption:
        _caption(axes, packing, network, size + 4)
        scale_bar(axes, packing.mean_diameter)
        _legend(axes, packing, network, pixels)


def _forces(packing: Packing, network: ContactNetwork, pixels: float) -> Any:
    """Return lines from centre to centre, with widths proportional to the force; a disk is ``pixels`` points wide."""
    from matplotlib.collections import LineCollection

    middle = packing.positions[network.i] + network.r / 2
    contact, middle = packing.box.images(middle, 1.5 * packing.radii.max())  # for the width of the lines
    half = network.r[contact] / 2
    strength = network.force / max(network.force.mean(), np.finfo(float).tiny)
    ends: Any = np.stack([middle - half, middle + half], axis=1)
    widths = FORCE_WIDTH * pixels * strength[contact]
    return LineCollection(ends, colors=FORCE, capstyle="round", linewidths=widths, zorder=3)


def _legend(axes: Axes, packing: Packing, network: ContactNetwork, pixels: float) -> None:
    """Draw what the colours and the lines mean, below the cell; the line has the width of the mean force."""
    from matplotlib.lines import Line2D

    def disk(face: str, text: str, **edge: Any) -> Line2D:
        return Line2D([], [], ls="", marker="o", ms=9, mfc=face, label=text, **edge)

    found = []
    if len(network):
        width, mean = min(FORCE_WIDTH * pixels, 10.0), network.force.mean() / (network.pressure * packing.mean_diameter)
        found.append(Line2D([], [], color=FORCE, lw=width, label=f"mean force, {mean:.3g} $pd$"))
    low, high = packing.radii.min() / packing.mean_diameter * 2, packing.radii.max() / packing.mean_diameter * 2
    found.append(disk(SMALL, f"diameter {low:.3g} $d$", mec=RIM))
    if high > low * (1 + 1e-9):
        found.append(disk(LARGE, f"{high:.3g} $d$", mec=RIM))
    if network.rattlers:
        found.append(disk(CAGED, "rattler", mec=RATTLER))
    axes.legend(handles=found, loc="upper right", bbox_to_anchor=(1, 0), ncols=len(found), columnspacing=1.2)


def _caption(axes: Axes, packing: Packing, network: ContactNetwork, fontsize: float) -> None:
    """Write the title: the packing, and whether it is a proved minimum."""
    verdict, colour = VERDICTS[packing.certificate.proved]
    if not network.balanced:
        verdict, colour = f"not in balance: net forces reach {network.net_force:.2g} p·d", UNSTABLE
    count = network.rattlers
    axes.set_title(
        f"$N$ = {len(packing)}, $\\phi$ = {packing.phi:.5f}, $p$ = {number(network.pressure)} $k$, "
        f"$Z$ = {network.Z:.3f}, {count} rattler{'' if count == 1 else 's'}",
        fontsize=fontsize,
        pad=2 * fontsize,
    )
    place: dict[str, Any] = {"xycoords": "axes fraction", "textcoords": "offset points", "ha": "center"}
    axes.annotate(verdict, (0.5, 1), (0, 5), color=colour, fontsize=fontsize, **place)


def _history(packing: Packing) -> dict[str, Array] | None:
    """Return the history of the preparation as arrays; None if there is none or it is invalid."""
    history = packing.provenance.get("history")
    names = ("evaluations", "phi", "pressure", "force")
    if not isinstance(history, Mapping) or not all(name in history for name in names):
        return None
    columns = {name: np.asarray(history[name], dtype=float) for name in names}
    shapes = {column.shape for column in columns.values()}
    return columns if len(shapes) == 1 and columns["phi"].ndim == 1 and columns["phi"].size > 1 else None


def _draw_history(figure: FigureBase, history: Mapping[str, Array], target: float | None) -> None:
    """Draw pressure, largest force and packing fraction against force evaluations."""
    panels = figure.subplots(3, 1, sharex=True)
    evaluations = history["evaluations"]
    for axes, name, label, colour in (
        (panels[0], "pressure", "pressure $p$  ($k$)", STORAGE),
        (panels[1], "force", r"largest net force  ($kd$)", LOSS),
        (panels[2], "phi", r"packing fraction $\phi$", "0.25"),
    ):
        values = history[name]
        positive = values[values > 0]
        if name == "force" or (name == "pressure" and len(positive) and np.ptp(np.log(positive)) > np.log(5)):
            axes.set_yscale("log")
            values = np.where(values > 0, values, np.nan)
        axes.plot(evaluations, values, color=colour, lw=1.2)
        axes.set_ylabel(label)
        axes.spines[["top", "right"]].set_visible(False)
    if target is not None:
        panels[0].axhline(target, color="0.3", lw=0.9, ls="--", zorder=0)
        place: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points", "ha": "right"}
        panels[0].annotate(f"target {number(target)}", (1, target), (0, 4), color="0.3", fontsize=9, **place)
    panels[0].set_title("preparation")
    panels[2].set_xlabel("force evaluations")
    panels[2].ticklabel_format(axis="y", useOffset=False)
