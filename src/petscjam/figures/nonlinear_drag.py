"""The test of equivalent damping (BT, Conclusions): the nonlinear equations of motion against both of its forms.

G* depends on ω and δσ through X = ω^α δσ^(α−1) alone (docs/howto/drag.md), and is computed at one δσ.

Axes: w frequency, k packing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.analysis.contact_drag import self_consistent_drag
from petscjam.analysis.drag import NonlinearModulus, equivalent_drag
from petscjam.analysis.nonlinear_drag import nonlinear_drag
from petscjam.analysis.statistics import by_pressure, standard_error
from petscjam.base.types import Array
from petscjam.figures.data import FigureData
from petscjam.figures.drag import note_exponents
from petscjam.figures.page import Page
from petscjam.io.jobs import ModulusAnalysis, PackingAnalysis
from petscjam.parallel.comm import on_root
from petscjam.plots.figure import save
from petscjam.plots.legends import Shades, setting
from petscjam.rows.damping import ContactDamping

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from petscjam.plots.figure import Colour

Groups = dict[float, list[NonlinearModulus]]  # of each pressure
PARTS: dict[str, Callable[[Any], Array]] = {"G′": np.real, "G″": np.imag}
RTOL = 1e-5
STYLES = {"direct": "o", "one time": "--", "per contact": "-"}
STRESSES = (0.1, 1.0, 10.0)  # times the one of the preset, which are drawn


def draw(data: FigureData) -> None:
    """Compute and draw the figure."""
    parameters = data.parameters
    files = data.packings(parameters["particles"], parameters.points("pressure"))
    analysis: Any = ModulusAnalysis(parameters.points("linear_omega"))
    linear = data.results(files, analysis, [ContactDamping()], (False,), tag="linear")
    stress, found = parameters["stress"], {}
    for alpha in parameters.points("alphas").tolist():
        omegas = (parameters.points("X") * stress ** (1 - alpha)) ** (1 / alpha)
        settings = {"omegas": omegas, "stress": stress, "alpha": alpha}
        accurate = settings | {"points": int(parameters["points"]), "rtol": RTOL}
        found[alpha] = {
            form: data.results(files, PackingAnalysis(analyse, own), prestress=(False,), tag=f"{tag}{alpha:.3f}")
            for form, tag, analyse, own in (
                ("direct", "direct", nonlinear_drag, accurate),
                ("per contact", "contacts", self_consistent_drag, settings),
            )
        }
    on_root(data.comm, _draw, data.page, linear, found, data.picture)


def _draw(
    page: Page, linear: Mapping[str, Any], found: Mapping[float, Mapping[str, Mapping[str, Any]]], picture: Path
) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(22, 5.2 * len(found)), layout="constrained")
    panels = figure.subplots(len(found), 4, squeeze=False)
    models = {g.origin.checksum: g.model for g in linear.values()}
    for row, (alpha, forms) in zip(panels, found.items(), strict=True):
        direct = by_pressure(forms["direct"].values())
        contacts = {g.origin.checksum: g for g in forms["per contact"].values()}
        others: dict[str, Groups] = {"one time": {}, "per contact": {}}
        for p, some in direct.items():
            others["one time"][p] = [equivalent_drag(models[g.origin.checksum], g.omega, g.stress, alpha) for g in some]
            others["per contact"][p] = [contacts[g.origin.checksum] for g in some]
        _draw_row(row, alpha, direct, others)
        for form, groups in {"direct": direct, **others}.items():
            note_exponents(page, alpha, form, groups)
        _note_ratios(page, alpha, direct, others)
    save(figure, picture)


def _draw_row(row: Any, alpha: float, direct: Groups, others: Mapping[str, Groups]) -> None:
    whole, against_stress, *ratios = row
    shades, lowest = Shades("pressure", direct), min(direct)
    for p, some in direct.items():
        forms = {"direct": some} | {form: groups[p] for form, groups in others.items()}
        _draw_moduli(whole, _coefficient, forms, shades(p), f"{setting('pressure', p)} ({len(some)})")
        for axes, form in zip(ratios, others, strict=True):
            _draw_ratio(axes, _coefficient(some[0]), some, forms[form], shades(p), setting("pressure", p))
    stresses = [direct[lowest][0].stress * factor for factor in STRESSES]
    shades = Shades("stress", stresses)
    for stress in stresses:
        forms = {"direct": direct[lowest]} | {form: groups[lowest] for form, groups in others.items()}
        moved = {form: [g.at(stress) for g in some] for form, some in forms.items()}
        _draw_moduli(against_stress, lambda g: g.omega, moved, shades(stress), setting("stress", stress))
    whole.set_title(f"α = {alpha:.3g}; symbols: direct, −: a time for each contact, − −: one time")
    against_stress.set_title(setting("pressure", lowest))
    for axes in (whole, against_stress):
        axes.set(yscale="log", ylabel="$G'$ (●), $G''$ (○)  ($k$)")
    ratios[0].set(yscale="log")
    for axes, form in zip(ratios, others, strict=True):
        axes.set(ylabel=f"{form} / direct: $G'$ (●), $G''$ (○)")
        axes.axhline(1, color="0.6", lw=0.8)
    for axes in row:
        axes.set(xscale="log", xlabel=r"$X=\omega^\alpha\delta\sigma^{\alpha-1}$  ($\tau_1=k=1$)")
        axes.legend()
    against_stress.set(xlabel=r"$\omega\tau_1$")


def _draw_moduli(
    axes: Axes,
    x: Callable[[NonlinearModulus], Array],
    forms: Mapping[str, list[NonlinearModulus]],
    colour: Colour,
    label: str,
) -> None:
    """Draw the means of G′ and G″ over packings, of every form."""
    for form, some in forms.items():
        for part, face in zip(PARTS.values(), (colour, "white"), strict=True):
            mean, named = np.mean([part(g.values) for g in some], axis=0), form == "direct" and face == colour
            style: dict[str, Any] = {"lw": 1, "ms": 4, "color": colour, "mfc": face, "label": label if named else ""}
            axes.plot(x(some[0]), mean, STYLES[form], **style)


def _draw_ratio(
    axes: Axes, X: Array, direct: list[NonlinearModulus], form: list[NonlinearModulus], colour: Colour, label: str
) -> None:
    for part, face, text in zip(PARTS.values(), (colour, "white"), (label, ""), strict=True):
        ratios = _ratios(part, direct, form)
        axes.errorbar(
            X,
            ratios.mean(0),
            np.nan_to_num(standard_error(ratios)),
            fmt="o-",
            ms=3,
            lw=0.8,
            color=colour,
            mfc=face,
            label=text,
        )


def _ratios(part: Callable[[Any], Array], direct: list[NonlinearModulus], form: list[NonlinearModulus]) -> Array:
    """Return the ratio of ``form`` to ``direct`` for each packing, (k, w)."""
    return np.array([part(g.values) / part(exact.values) for exact, g in zip(direct, form, strict=True)])


def _coefficient(g: NonlinearModulus) -> Array:
    """Return X = ω^α δσ^(α−1) (w,)."""
    return g.omega**g.alpha * g.stress ** (g.alpha - 1)


def _third(some: list[NonlinearModulus]) -> Array:
    """Return |γ₃/γ₁| (k, w)."""
    return np.abs(np.array([g.third for g in some]))


def _note_ratios(page: Page, alpha: float, direct: Groups, others: Mapping[str, Groups]) -> None:
    """Note the ratios of each form to the direct solution, and the third harmonic."""
    for form, groups in others.items():
        for name, part in PARTS.items():
            for p, some in direct.items():
                ratios, X = _ratios(part, some, groups[p]), _coefficient(some[0])
                what = f"α = {alpha:.3g}, p = {p:.2g}: {name} of {form} / direct"
                worst = int(np.argmax(abs(np.log(ratios.mean(0)))))
                page.mean(f"{what}, largest deviation", ratios[:, worst], "1", f"X = {X[worst]:.1e}")
                for x, mean, error in zip(X, ratios.mean(0), np.atleast_1d(standard_error(ratios)), strict=True):
                    page.number(what, x, float(mean), float(error))
    for p, some in direct.items():
        third = _third(some)
        for x, mean, error in zip(_coefficient(some[0]), third.mean(0), standard_error(third), strict=True):
            page.number(f"α = {alpha:.3g}, p = {p:.2g}: |γ₃/γ₁|", x, float(mean), float(error))
    every = [g for some in direct.values() for g in some]
    page.tallies.append(
        f"α = {alpha:.3g}: {len(every)} packings; largest |γ₃/γ₁| = {_third(every).max():.2g}; "
        f"mismatch of velocities at most {max(g.tau_changes.max() for g in every):.0e}, change of G* in the last "
        f"iteration {max(g.changes.max() for g in every):.0e}, residual of a solve "
        f"{max(g.residuals.max() for g in every):.0e}."
    )
