"""Figure of a library of packings: contacts, density and lowest frequency near jamming.

Axes: k packing, m point (mean over the packings of one size and target pressure).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from petscjam.analysis.jamming import BULK, excess_contacts, fit_phi_J, fit_power, in_window
from petscjam.analysis.statistics import means, nominal
from petscjam.base.errors import InputError
from petscjam.base.types import Array
from petscjam.geometry.potential import potential
from petscjam.plots.figure import UNSTABLE, finished, house_style
from petscjam.plots.legends import MARKERS, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


COLUMNS = ("particles", "pressure", "target", "phi", "Z", "rattlers", "contacts", "lowest_eigenvalue", "proved")


@dataclass(frozen=True)
class _Size:
    """The packings of one N."""

    particles: int
    marker: str
    target: Array  # (k,)
    p: Array
    phi: Array
    excess: Array  # Z − Z_iso
    eigenvalue: Array  # the lowest; NaN if unknown
    sound: NDArray[np.bool_]  # False: known not to be a proved minimum

    @property
    def targets(self) -> Array:
        """Target pressures of the sound packings, (m,)."""
        return np.unique(self.target[self.sound])

    def mean(self, values: Array) -> tuple[Array, Array]:
        """Mean over the sound packings of each target, and its standard error (of one: NaN), (m,)."""
        return means(values[self.sound & (self.target == target)] for target in self.targets)


@house_style()
def plot_library(rows: Sequence[Mapping[str, Any]], path: str | PathLike[str] | None = None) -> Figure:
    """Draw Z − Z_iso and φ − φJ against p, and the distribution of the lowest frequency, of a library.

    Large symbols are means over the packings of one N and target pressure, with standard errors; dots are
    packings. Certified packings that are not proved minima are crosses and are not used otherwise. Packings
    without pressure or contacts are not jammed: the title has their number, and they are not drawn.

    Z_iso is that of :func:`petscjam.analysis.jamming.excess_contacts`; a packing with Z = Z_iso cannot be drawn
    on a logarithmic axis. Overlaps of contacts of exponent α grow as p^a, a = 1/(α − 1), and so does φ − φJ; Z −
    Z_iso grows as p^(a/2). This is fitted to the means :func:`petscjam.analysis.jamming.in_window`; its error is
    that of the means, without the dependence on the window. φJ of each N comes from
    :func:`petscjam.analysis.jamming.fit_phi_J`, with the exponent a. λ is the lowest eigenvalue of K with
    pre-stress, ω = √λ the frequency of disks of unit mass; for each N and target the fraction of packings below ω
    is drawn.

    Parameters
    ----------
    rows : sequence of mappings
        One for each packing, with the keys ``particles``, ``pressure``, ``target`` (target pressure, None if
        not known), ``potential``, ``phi``, ``Z``, ``rattlers``, ``contacts`` (within the backbone),
        ``lowest_eigenvalue`` (None or NaN if not known), ``proved`` (None if not judged).
    path : path, optional
        Write the figure; its extension gives the format.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If no row is of a jammed packing, one lacks a key, potentials differ, or the figure cannot be written.
    """
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, LogNorm
    from matplotlib.figure import Figure

    sizes, a = _sizes(rows), _exponent(rows)
    targets = np.unique(np.concatenate([size.target for size in sizes]))
    one = len(targets) == 1
    norm = LogNorm(*(targets[[0, 0]] * [0.5, 2] if one else targets[[0, -1]]))
    colours = ListedColormap(colormaps["viridis"](np.linspace(0, 0.9, 256)))

    def colour(pressure: Any) -> Any:
        return colours(norm(pressure))

    figure = Figure(figsize=(15, max(5.2, 0.6 + 1.2 * len(sizes))), layout="constrained")
    halves: Any = figure.subfigures(1, 2, width_ratios=[2, 1.15])
    left, right = halves
    panels = left.subplots(1, 2)
    _draw_excess(panels[0], sizes, colour, a)
    _draw_density(panels[1], sizes, colour, a)
    stack = right.subplots(len(sizes), 1, sharex=True, squeeze=False)[:, 0]
    _draw_lowest(stack, sizes, colour)
    right.supylabel(r"fraction of packings below $\omega$", fontsize=10)
    if not one:
        right.colorbar(ScalarMappable(norm, colours), ax=list(stack), label="target pressure  ($k$)", aspect=30)
    figure.suptitle(_summary(rows) + (f"; target pressure {number(targets[0])} $k$" if one else ""))
    return finished(figure, path)


def _sizes(rows: Sequence[Mapping[str, Any]]) -> list[_Size]:
    if not rows:
        raise InputError("library: there are no packings to draw")
    for k, row in enumerate(rows):
        missing = [name for name in ("potential", *COLUMNS) if name not in row]
        if missing:
            raise InputError(f"library: packing {k} lacks {', '.join(missing)}")
    jammed = [row for row in rows if _is_jammed(row)]
    if not jammed:
        raise InputError("library: no packing is jammed")
    table = {
        name: np.array([np.nan if row[name] is None else row[name] for row in jammed], dtype=float) for name in COLUMNS
    }
    n, p, target = table["particles"], table["pressure"], table["target"]
    target = np.where(target > 0, target, [nominal(x) for x in p])
    excess = excess_contacts(n, table["rattlers"], table["contacts"])
    columns = (target, p, table["phi"], excess, table["lowest_eigenvalue"], table["proved"] != 0)
    return [_Size(int(m), MARKERS[s % len(MARKERS)], *(c[n == m] for c in columns)) for s, m in enumerate(np.unique(n))]


def _is_jammed(row: Mapping[str, Any]) -> bool:
    return (row["pressure"] or 0) > 0 and (row["contacts"] or 0) > 0


def _exponent(rows: Sequence[Mapping[str, Any]]) -> float:
    """Return a = 1/(α − 1) of the potential."""
    first, *others = sorted({row["potential"] for row in rows})
    if others:
        raise InputError(f"library: mixed units: the potentials are {', '.join([first, *others])}")
    alpha = potential(first).exponent
    if alpha is None:
        raise InputError(f"library: the potential {first} is not a power of the overlap: no exponents near jamming")
    return 1 / (alpha - 1)


def _summary(rows: Sequence[Mapping[str, Any]]) -> str:
    verdicts = [row["proved"] for row in rows]
    counts = {
        "proved": sum(v is not None and bool(v) for v in verdicts),
        "not proved": sum(v is not None and not v for v in verdicts),
        "not judged": sum(v is None for v in verdicts),
    }
    judged = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    loose = sum(not _is_jammed(row) for row in rows)
    left_out = f"; {loose} not jammed, not drawn" if loose else ""
    return f"{len(rows)} packing{'' if len(rows) == 1 else 's'}: {judged}{left_out}"


def _draw_excess(axes: Axes, sizes: Sequence[_Size], colour: Callable[..., Any], a: float) -> None:
    curves = [(size, size.excess, f"N = {size.particles}") for size in sizes]
    _draw_curves(axes, curves, colour, "with no contact to spare, no dot")
    axes.set_ylabel(r"$Z - Z_\mathrm{iso}$,  $Z_\mathrm{iso} = 4 - 2/N'$")
    bulk = []
    for size in sizes:
        points = np.array([size.mean(size.p)[0], *size.mean(size.excess)])
        bulk.append(points[:, in_window(points[0], size.particles, a) & (points[1] > 0)])
    p, mean, error = np.concatenate(bulk, axis=1)
    if len(np.unique(p)) > 1:
        fit = fit_power(p, mean, error)
        span = np.array([p.min(), p.max()])
        axes.plot(
            span,
            fit.prefactor * span**fit.exponent,
            color="0.15",
            lw=1,
            zorder=3,
            label=f"slope {_pm(fit.exponent, fit.exponent_error)}\n"
            rf"(${_power(a)}N^2 > {BULK:g}$, ${_power(a)} \leq 0.01$)",
        )
        top = fit.prefactor * span[1] ** fit.exponent / 3
        _guide(axes, lambda x: top * (x / span[1]) ** (a / 2), f"slope {_fraction(a / 2)}")
    axes.legend(loc="upper left")


def _draw_density(axes: Axes, sizes: Sequence[_Size], colour: Callable[..., Any], a: float) -> None:
    curves, fits, without = [], [], []
    for size in sizes:
        (p, _), (mean, error) = size.mean(size.p), size.mean(size.phi)
        if len(np.unique(p)) > 1:
            fit = fit_phi_J(p, mean, error, exponent=a)
            label = rf"N = {size.particles}: $\phi_J$ = {_pm(fit.phi_J, fit.phi_J_error)}"
            curves.append((size, size.phi - fit.phi_J, label))
            fits.append((fit, np.array([p.min(), fit.highest])))
        else:
            without.append(size)
    if not fits:
        curves = [(size, size.phi, f"N = {size.particles}") for size in sizes]
        _draw_curves(axes, curves, colour, "", log=False)
        axes.set(ylabel=r"packing fraction $\phi$", title=r"$\phi_J$ takes two pressures at one N")
        return
    _draw_curves(axes, curves, colour, r"below $\phi_J$, no dot")
    axes.set_ylabel(r"$\phi - \phi_J$")
    for fit, span in fits:
        if fit.slope > 0:
            axes.plot(span, fit.slope * span**a, color="0.15", lw=1, zorder=3)
    slope = max(fit.slope for fit, _ in fits)
    if slope > 0:
        _guide(axes, lambda p: slope * p**a / 5, f"slope {_fraction(a)}")
    axes.plot([], [], color="0.15", lw=1, label=rf"fits, $\propto {_power(a)}$")
    for size in without:
        axes.plot([], [], " ", label=rf"N = {size.particles} not drawn: fewer than two pressures, no $\phi_J$")
    axes.legend(loc="upper left")


def _draw_curves(
    axes: Axes, curves: Sequence[tuple[_Size, Array, str]], colour: Callable[..., Any], hidden: str, log: bool = True
) -> None:
    """Draw values of (k,) packings against their pressures, and their means."""
    p = np.concatenate([size.p for size, _, _ in curves])
    axes.set(xscale="log", xlabel="pressure $p$  ($k$)", xlim=(p.min() / 1.6, p.max() * 1.6))
    if log:
        axes.set_yscale("log", nonpositive="clip")
        axes.set_ylim(_span(curves))
    bar: dict[str, Any] = {"mec": "0.15", "mew": 0.6, "ecolor": "0.15", "elinewidth": 1, "ms": 6.5, "zorder": 4}
    out = 0
    for size, values, label in curves:
        fine = (values > 0) | (not log)
        out += int((values <= 0).sum()) if log else 0
        k, unsound = size.sound & fine, ~size.sound & fine
        axes.scatter(size.p[k], values[k], s=7, lw=0, alpha=0.45, zorder=2, color=colour(size.target[k]))
        axes.scatter(size.p[unsound], values[unsound], s=22, marker="x", lw=1, zorder=5, color=UNSTABLE)
        (p, _), (mean, error) = size.mean(size.p), size.mean(values)
        for m in np.flatnonzero((mean > 0) | (not log)):
            axes.errorbar(p[m], mean[m], np.nan_to_num(error[m]), fmt=size.marker, color=colour(size.targets[m]), **bar)
        axes.plot([], [], size.marker, color="0.7", mec="0.15", mew=0.6, label=label)
    if any((~size.sound).any() for size, _, _ in curves):
        axes.plot([], [], "x", color=UNSTABLE, label="not proved")
    if out:
        axes.plot([], [], " ", label=f"{out} {hidden}")
    axes.legend(loc="upper left")


def _span(curves: Sequence[tuple[_Size, Array, str]]) -> tuple[float, float]:
    """Return the range of a logarithmic axis, with room for the legend."""
    dots = np.concatenate([values for _, values, _ in curves])
    means = np.concatenate([size.mean(values)[0] for size, values, _ in curves])
    dots, means = dots[dots > 0], means[means > 0]
    if not len(dots):
        return 0.1, 10.0
    lowest = means.min() if len(means) else dots.min()
    low = max(min(dots.min(), lowest), lowest / 10)  # a dot may be anywhere between 0 and its mean
    return low / 2, 2 * dots.max() * (dots.max() / low) ** 0.25


def _draw_lowest(panels: Sequence[Axes], sizes: Sequence[_Size], colour: Callable[..., Any]) -> None:
    """Draw the fraction of packings whose lowest frequency is below ω, for each N and target."""
    values = np.concatenate([size.eigenvalue[size.sound] for size in sizes])
    values = np.sqrt(values[values > 0]) if (values > 0).any() else np.ones(1)
    for axes, size in zip(panels, sizes, strict=True):
        axes.set(xscale="log", xlim=(values.min() / 1.3, values.max() * 1.3), ylim=(-0.04, 1.04), yticks=(0, 0.5, 1))
        known = np.isfinite(size.eigenvalue)
        for target in size.targets:
            some = size.sound & known & (size.target == target)
            omega = np.sort(np.sqrt(size.eigenvalue[some & (size.eigenvalue > 0)]))
            if len(omega):
                axes.step(
                    np.append(omega[0], omega),
                    np.linspace(0, 1, len(omega) + 1),
                    where="post",
                    color=colour(target),
                    lw=1.3,
                )
                axes.plot(np.median(omega), 0.5, size.marker, color=colour(target), mec="0.15", mew=0.6, ms=6)
        title = f"N = {size.particles}"
        for count, text in (
            ((size.sound & ~known).sum(), "without a value"),
            ((size.sound & (size.eigenvalue <= 0)).sum(), r"with $\lambda \leq 0$"),
        ):
            title += f", {count} {text}" if count else ""
        axes.set_title(title, loc="left", fontsize=9)
    panels[-1].set_xlabel(r"lowest frequency $\omega = \sqrt{\lambda}$  ($\sqrt{k/m}$)")


def _guide(axes: Axes, law: Callable[[Array], Array], text: str) -> None:
    """Draw a slope below the data, over the upper half of the pressures."""
    low, high = np.log(axes.get_xlim())
    p = np.exp(np.array([0.5 * (low + high), 0.1 * low + 0.9 * high]))
    axes.plot(p, law(p), color="0.5", lw=1, ls="--", zorder=1)
    middle = np.sqrt(p[:1] * p[1:])
    axes.annotate(
        text, (middle[0], law(middle)[0]), (6, -2), textcoords="offset points", color="0.4", fontsize=9, va="top"
    )


def _fraction(value: float) -> str:
    return str(Fraction(value).limit_denominator(12))


def _power(a: float) -> str:
    """Write p^a for a formula."""
    return "p" if a == 1 else f"p^{{{_fraction(a)}}}"


def _pm(value: float, error: float) -> str:
    """Write value ± error, to two digits of the error."""
    if not error > 0:  # NaN, too
        return f"{value:.5g}"
    digits = max(0, 1 - int(np.floor(np.log10(error))))
    return f"{value:.{digits}f} ± {error:.{digits}f}"
