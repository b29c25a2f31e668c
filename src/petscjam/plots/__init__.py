"""Figures: complex moduli, a packing and how it was prepared, a library of packings, and what else is found.

matplotlib is imported when the first figure is drawn.
"""

from collections.abc import Callable, Mapping
from os import PathLike
from typing import Any

from petscjam.analysis.correlations import Correlations
from petscjam.analysis.density import DensityOfStates
from petscjam.analysis.drag import NonlinearModulus
from petscjam.analysis.nonaffine import QuasistaticResponse
from petscjam.analysis.viscosity import Viscosity
from petscjam.base.errors import InputError
from petscjam.plots.correlations import plot_correlations
from petscjam.plots.density import plot_density
from petscjam.plots.drag import plot_drag
from petscjam.plots.library import plot_library
from petscjam.plots.modes import plot_modes, plot_relaxations
from petscjam.plots.modulus import _draw_moduli as _draw_moduli
from petscjam.plots.modulus import plot_moduli
from petscjam.plots.nonaffine import plot_nonaffine
from petscjam.plots.packing import plot_packing
from petscjam.plots.viscosity import plot_viscosity
from petscjam.response.modes import Modes
from petscjam.response.relaxations import RelaxationModes
from petscjam.response.result import ComplexModulus

__all__ = [
    "plot_correlations",
    "plot_density",
    "plot_drag",
    "plot_library",
    "plot_modes",
    "plot_moduli",
    "plot_nonaffine",
    "plot_packing",
    "plot_relaxations",
    "plot_results",
    "plot_viscosity",
]

PICTURES: dict[type, Callable[[Mapping[str, Any], str | PathLike[str]], None]] = {
    ComplexModulus: plot_moduli,
    QuasistaticResponse: plot_nonaffine,
    Viscosity: plot_viscosity,
    Modes: plot_modes,
    RelaxationModes: plot_relaxations,
    DensityOfStates: plot_density,
    Correlations: plot_correlations,
    NonlinearModulus: plot_drag,
}


def plot_results(results: Mapping[str, Any], path: str | PathLike[str]) -> None:
    """Draw results of one kind, as a file holds them.

    Raises
    ------
    InputError
        If there are none, or the figure cannot be written.
    """
    if not results:
        raise InputError("the file holds no results yet")
    kind = type(next(iter(results.values())))
    if kind not in PICTURES:
        raise InputError(f"there is no picture of {kind.__name__}")
    PICTURES[kind](results, path)
