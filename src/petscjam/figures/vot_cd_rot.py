"""VOT figs. 10–21, 32, 33: model CD_rot, N = 1024."""

from __future__ import annotations

from petscjam.figures import vot
from petscjam.figures.data import FigureData
from petscjam.figures.flows import draw_on_root

FIGURES = {
    "vot10": lambda scan: vot.against_Q(scan, vot.P_EL),
    "vot11": lambda scan: vot.against_Q_and_rate(scan, [(vot.ETA_P,), (vot.B_P,)]),
    "vot12": lambda scan: vot.against_Q(scan, vot.Z),
    "vot13": lambda scan: vot.against_Q_and_rate(scan, [(vot.Z, vot.PRODUCT)]),
    "vot14": lambda scan: vot.against_Q_and_rate(scan, [(vot.DURATION,), (vot.COLLISIONS,)]),
    "vot15": lambda scan: vot.against_phi(scan, [vot.P_EL], rates=False),
    "vot16": lambda scan: vot.against_phi(scan, [vot.ETA_P, vot.B_P], rates=True),
    "vot17": vot.phase_diagram_CD_rot,
    "vot18": vot.collision_angles,
    "vot19": vot.tangential_collisions,
    "vot20": lambda scan: vot.against_phi(scan, [vot.SPIN, vot.SPIN_VARIANCE], rates=False),
    "vot21": vot.contact_velocities,
    "vot32": vot.differences_Q,
    "vot33": vot.differences_phi,
}


def draw(data: FigureData) -> None:
    """Compute and draw a figure."""
    draw_on_root(data, FIGURES[data.parameters.figure](vot.Scan(data, "CD_rot")))
