"""Figures: complex moduli, a packing and how it was prepared, a library of packings.

matplotlib is imported when the first figure is drawn.
"""

from petscjam.plots.library import fit_phi_J, fit_power, plot_library
from petscjam.plots.modulus import _draw_moduli as _draw_moduli
from petscjam.plots.modulus import plot_moduli
from petscjam.plots.packing import plot_packing

__all__ = ["fit_phi_J", "fit_power", "plot_library", "plot_moduli", "plot_packing"]
