"""VOT figs. 22–31, 34–36: model CD_rot at Q = 1, large systems."""

from __future__ import annotations

from petscjam.figures import vot_bands, vot_diagrams, vot_ramps
from petscjam.figures.data import FigureData
from petscjam.figures.flows import draw_on_root
from petscjam.figures.large import Large

FIGURES = {
    "vot22": lambda scan: vot_diagrams.against_phi(scan, "P_el"),
    "vot23": lambda scan: vot_diagrams.against_phi(scan, "μ"),
    "vot24": lambda scan: vot_diagrams.against_phi(scan, "Rv"),
    "vot25": lambda scan: vot_diagrams.diagram(scan, "phi", "rate"),
    "vot26": lambda scan: vot_diagrams.diagram(scan, "pressure", "rate"),
    "vot27": vot_bands.maps,
    "vot28": vot_bands.profiles,
    "vot29": lambda scan: vot_diagrams.diagram(scan, "pressure", "stress"),
    "vot30": vot_ramps.steady,
    "vot31": vot_ramps.ramps,
    "vot34": vot_bands.friction,
    "vot35": vot_diagrams.binodal,
    "vot36": vot_diagrams.two_sizes,
}


def draw(data: FigureData) -> None:
    """Compute and draw a figure."""
    draw_on_root(data, FIGURES[data.parameters.figure](Large(data)))
