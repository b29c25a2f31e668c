"""BT Fig. 6: Stokes drag, its collapse, and the effect of the viscosity of the fluid."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from petscjam.analysis.statistics import grouped
from petscjam.figures.bt3 import draw_collapse
from petscjam.figures.data import FigureData
from petscjam.figures.panels import draw_mean, guide
from petscjam.io.jobs import ModulusAnalysis
from petscjam.parallel.comm import on_root
from petscjam.plots.figure import save
from petscjam.plots.legends import Shades, setting
from petscjam.rows.damping import StokesDrag

if TYPE_CHECKING:
    from petscjam.response.result import ComplexModulus

FLUID = 0.01  # ωτ1 above which ηF ω contributes to G″


def draw(data: FigureData) -> None:
    """Compute and draw the figure: NAME.png is Fig. 6a, NAME-fluid.png Fig. 6b."""
    parameters = data.parameters
    files = data.packings(parameters["particles"], parameters.points("pressure"))
    analysis = ModulusAnalysis(parameters.points("omega"))
    results = data.results(files, analysis, [StokesDrag()], (True, False))
    on_root(data.comm, draw_collapse, data.page, data.stable(results, "G*"), StokesDrag(), data.picture, FLUID)
    one = data.packings(parameters["particles"], [parameters["fluid_pressure"]])
    fluids = [StokesDrag(float(eta)) for eta in parameters.points("fluids")]
    varied = data.results(one, analysis, fluids, tag="fluids")
    other = data.picture.with_stem(f"{data.picture.stem}-fluid")
    on_root(data.comm, _draw_fluids, data.stable(varied, "varying ηF"), other)


def _draw_fluids(results: Mapping[str, ComplexModulus], picture: Path) -> None:
    """Draw G* at one pressure for every viscosity of the fluid."""
    from matplotlib.figure import Figure

    groups = grouped(results.values(), lambda g: g.damping.fluid)
    figure = Figure(figsize=(8, 6), layout="constrained")
    axes = figure.subplots()
    shades = Shades("eta_fluid", groups)
    for eta, some in groups.items():
        draw_mean(axes, some, shades(eta), setting("eta_fluid", eta), marker=shades.marker(eta))
    guide(axes, (1e-4, 1e-2), 5e-4, 0.5, "slope ½")
    pressure = next(iter(results.values())).origin.pressure
    axes.set(xlabel=r"$\omega\tau_1$", ylabel=r"$G'$ (●), $G''$ (○)  ($k$)")
    axes.set_title(f"Stokes drag, {setting('pressure', pressure)}, with pre-stress")
    axes.legend()
    save(figure, picture)
