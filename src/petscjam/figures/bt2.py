"""BT Fig. 2: the velocities that viscous forces resist, in a packing at ω → 0.

Axes: i disk, c contact, x Cartesian, d (ux, uy, θ).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.figures.data import FigureData
from petscjam.geometry.packing import Packing
from petscjam.io.importers import import_packing
from petscjam.parallel.comm import on_root
from petscjam.plots.figure import LOSS, STORAGE, arrows, disks, save
from petscjam.response.limits import quasistatic, relax_dissipation
from petscjam.response.problem import LinearProblem
from petscjam.rows.damping import ContactDamping
from petscjam.rows.kinematics import SIMPLE_SHEAR, contact_rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_NEIGHBOURS = 6


def draw(data: FigureData) -> None:
    """Compute and draw the figure."""
    parameters = data.parameters
    files = data.packings(parameters["particles"], parameters.points("pressure"))
    packing = on_root(data.comm, import_packing, files[0])
    problem = LinearProblem(packing, ContactDamping(), [SIMPLE_SHEAR], False, data.comm)
    (q, _), _ = relax_dissipation(problem, (quasistatic(problem)[0][0], np.ones(1)))
    on_root(data.comm, _draw, packing, problem, q.real, data.picture)


def _draw(packing: Packing, problem: LinearProblem, q: Any, picture: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw_contacts(left, problem, q)
    _draw_drag(right, packing, problem, q)
    save(figure, picture)


def _draw_contacts(axes: Axes, problem: LinearProblem, q: Any) -> None:
    """Draw one disk and its neighbours, with the velocity of each contact point relative to the disk."""
    from matplotlib.patches import Circle

    network = problem.backbone
    counts = np.bincount(np.concatenate([network.i, network.j]), minlength=len(network.radii))
    disk = int(np.argmax(np.where(counts <= MOST_NEIGHBOURS, counts, 0)))
    rows, affine = contact_rows(network, [SIMPLE_SHEAR], at_contact_point=True)
    motion = (rows @ q.ravel() + affine[:, 0]).reshape(-1, 2)
    mine = np.flatnonzero((network.i == disk) | (network.j == disk))
    size = np.abs(motion[mine]).max() / (1.2 * network.radii[disk])
    axes.add_patch(Circle((0, 0), network.radii[disk], fc="#e9eff6", ec="0.3"))
    for c in mine:
        sign = 1 if network.i[c] == disk else -1  # from this disk to the other one
        n = sign * network.normal[c]
        t = np.array([-n[1], n[0]])
        other = network.j[c] if sign == 1 else network.i[c]
        axes.add_patch(Circle(sign * network.r[c], network.radii[other], fc="none", ec="0.6"))
        point = n * network.radii[disk]
        # Δu∥ and Δu⊥ do not depend on the order of the disks: n and t both change sign
        for amount, direction, colour in ((motion[c, 0], n, STORAGE), (motion[c, 1], t, LOSS)):
            arrows(axes, point, amount / size * direction, color=colour, width=0.008, headwidth=3.5, minlength=0)
    axes.plot([], [], color=STORAGE, label=r"$\Delta\dot u^\parallel$")
    axes.plot([], [], color=LOSS, label=r"$\Delta\dot u^{\perp,c}$, rotations counted")
    axes.legend(loc="upper left")
    axes.set_title("(a) contact damping: velocities at contacts,\nseen from the middle disk")
    reach = 2.6 * network.radii.max() * 1.2
    axes.set(aspect="equal", xlim=(-reach, reach), ylim=(-reach, reach))
    axes.set_axis_off()


def _draw_drag(axes: Axes, packing: Packing, problem: LinearProblem, q: Any) -> None:
    """Draw every disk with its velocity relative to the affine flow."""
    box = packing.box
    x = box.wrap(packing.positions)
    u = np.nan_to_num(problem.displacement(q))
    spacing = np.sqrt(box.area / len(packing))
    axes.add_collection(disks(axes, x, packing.radii, facecolors="#e9eff6", edgecolors="0.6"))
    size = np.sqrt((u**2).sum(1).mean()) / spacing
    arrows(axes, x, u / size, color=STORAGE, width=0.005)
    height = box.cell[:, 1].max()
    y = np.linspace(0, height, 9)
    start, longest = -0.22 * height, 0.2 * height
    flow = np.stack([longest * (y / height - 0.5), np.zeros(9)], axis=1)
    arrows(axes, np.stack([np.full(9, start), y], axis=1), flow, color=LOSS, width=0.005)
    axes.annotate(r"$\dot\gamma y$", (start, height), (-8, 8), textcoords="offset points", color=LOSS)
    axes.set_title("(b) Stokes drag: velocities against the affine flow")
    axes.set(aspect="equal", xlim=(-0.36 * height, 1.05 * height), ylim=(-0.05 * height, 1.1 * height))
    axes.set_axis_off()
