"""Figures: complex moduli, a packing and how it was prepared, a library of packings, and what else is found.

matplotlib is imported when the first figure is drawn.
"""

from collections.abc import Callable, Mapping
from os import PathLike
from typing import Any

from petscjam.analysis.nonaffine import QuasistaticResponse
from petscjam.analysis.viscosity import Viscosity
from petscjam.errors import InputError
from petscjam.plots.library import fit_phi_J, fit_power, plot_library
from petscjam.plots.modulus import _draw_moduli as _draw_moduli
from petscjam.plots.modulus import plot_moduli
from petscjam.plots.nonaffine import plot_nonaffine
from petscjam.plots.packing import plot_packing
from petscjam.plots.viscosity import plot_viscosity
from petscjam.response.result import ComplexModulus

__all__ = [
    "fit_phi_J", "fit_power", "plot_library", "plot_moduli", "plot_nonaffine", "plot_packing", "plot_results",
    "plot_viscosity",
]  # fmt: skip

PICTURES: dict[type, Callable[[Mapping[str, Any], str | PathLike[str]], None]] = {
    ComplexModulus: plot_moduli,
    QuasistaticResponse: plot_nonaffine,
    Viscosity: plot_viscosity,
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
    PICTURES[type(next(iter(results.values())))](results, path)
