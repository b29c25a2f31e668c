"""VOT figs. 1–6, 8, 9: model CD, N = 1024."""

from __future__ import annotations

from petscjam.figures import vot
from petscjam.figures.data import FigureData
from petscjam.figures.flows import draw_on_root

FIGURES = {
    "vot1": lambda scan: vot.against_Q(scan, vot.P_EL),
    "vot2": lambda scan: vot.against_Q_and_rate(scan, [(vot.ETA_P,), (vot.B_P,)]),
    "vot3": vot.phase_diagram_CD,
    "vot4": lambda scan: vot.against_Q(scan, vot.Z),
    "vot5": lambda scan: vot.against_Q_and_rate(scan, [(vot.Z, vot.PRODUCT)]),
    "vot6": lambda scan: vot.against_Q_and_rate(scan, [(vot.DURATION,), (vot.COLLISIONS,)]),
    "vot8": vot.collision_angles,
    "vot9": vot.tangential_collisions,
}


def draw(data: FigureData) -> None:
    """Compute and draw a figure."""
    draw_on_root(data, FIGURES[data.parameters.figure](vot.Scan(data, "CD")))
