"""Figure of a library of packings: how contacts, density and the lowest frequency approach jamming.

Axes: k packing, m point (mean over the packings of one size and target pressure).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from os import PathLike
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.base.errors import InputError
from petscjam.base.types import Array
from petscjam.geometry.potential import potential
from petscjam.plots.figure import UNSTABLE, save

COLUMNS = ("particles", "pressure", "target", "phi", "Z", "rattlers", "contacts", "lowest_eigenvalue", "proved")
MARKERS = "osD^vP*X"
# Where Z − Z_iso is fitted, with a of plot_library: where p^a·N² is above the one, N no longer matters; where
# p^a is below the other (p in k), p does not yet.
BULK, DENSE = 100.0, 1.1e-2


class PowerLaw(NamedTuple):
    """y = prefactor · x^exponent, with standard errors."""

    exponent: float
    exponent_error: float
    prefactor: float
    prefactor_error: float


class JammingDensity(NamedTuple):
    """φ = phi_J + slope · p^a, with standard errors, fitted to points up to the pressure ``highest``."""

    phi_J: float
    phi_J_error: float
    slope: float
    slope_error: float
    highest: float


def fit_power(x: ArrayLike, y: ArrayLike, error: ArrayLike | None = None) -> PowerLaw:
    """Fit y = A·x^a: a straight line through log y against log x, weighted by the standard errors of y.

    Errors too small for the scatter about the line are scaled up, as the Particle Data Group does. Without
    ``error``, or where one is missing (NaN or 0), every log y weighs the same, and the errors of the fit
    come from the scatter; of two points they are then NaN.

    Raises
    ------
    InputError
        If there are fewer than two different x, or a value that is not positive.
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if not ((x > 0) & (y > 0)).all():
        raise InputError("fit: a power law needs values above 0")
    relative = None if error is None else np.asarray(error, dtype=float) / y
    (a, log_A), (a_error, log_A_error) = _line(np.log(x), np.log(y), relative)
    A = float(np.exp(log_A))
    return PowerLaw(a, a_error, A, A * log_A_error)


def fit_phi_J(
    p: ArrayLike, phi: ArrayLike, error: ArrayLike | None = None, *, exponent: float = 1.0, decades: float = 1.5
) -> JammingDensity:
    """Fit φ = φJ + c·p^a with a given a, over the lowest ``decades`` of the pressures.

    Weights and errors are those of :func:`fit_power`. If fewer than three pressures lie within ``decades``
    the lowest three are taken, or as many as there are.

    Raises
    ------
    InputError
        If there are fewer than two different pressures, or one is not positive.
    """
    p, phi = np.asarray(p, dtype=float), np.asarray(phi, dtype=float)
    if not (p > 0).all():
        raise InputError("fit: the pressures must be above 0")
    rising = np.unique(p)
    # A measured pressure is not exactly its target: let the last of the decades in.
    highest = max(rising[0] * 10**decades * 1.05, rising[:3][-1]) if len(p) else 0.0
    low = p <= highest
    sigma = None if error is None else np.asarray(error, dtype=float)[low]
    (c, phi_J), (c_error, phi_J_error) = _line(p[low] ** exponent, phi[low], sigma)
    return JammingDensity(phi_J, phi_J_error, c, c_error, float(p[low].max()))


def _line(x: Array, y: Array, error: Array | None) -> tuple[tuple[float, float], tuple[float, float]]:
    """Fit a straight line; return slope and intercept, and their standard errors."""
    if len(np.unique(x)) < 2:
        raise InputError(f"fit: a line needs two different points, not {len(np.unique(x))}")
    known = error is not None and bool((np.isfinite(error) & (error > 0)).all())
    weights = 1 / error if error is not None and known else np.ones(len(x))
    (slope, intercept), covariance = np.polyfit(x, y, 1, w=weights, cov="unscaled")
    free = len(x) - 2
    chi2 = float(((weights * (y - slope * x - intercept)) ** 2).sum())
    scale = chi2 / free if free else np.nan
    if known:
        scale = np.fmax(scale, 1.0)
    slope_error, intercept_error = np.sqrt(scale * covariance.diagonal())
    return (float(slope), float(intercept)), (float(slope_error), float(intercept_error))


@dataclass(frozen=True)
class _Size:
    """The packings of one N."""

    particles: int
    marker: str
    target: Array  # (k,)
    p: Array
    phi: Array
    excess: Array  # Z − Z_iso
    eigenvalue: Array  # the lowest; NaN where it is not known
    sound: NDArray[np.bool_]  # False: known not to be a proved minimum

    @property
    def targets(self) -> Array:
        """Target pressures of the sound packings, (m,)."""
        return np.unique(self.target[self.sound])

    def mean(self, values: Array) -> tuple[Array, Array]:
        """Mean over the sound packings of each target, and its standard error (of one: NaN), (m,)."""
        means, errors = [], []
        for target in self.targets:
            some = values[self.sound & (self.target == target)]
            means.append(some.mean())
            errors.append(some.std(ddof=1) / np.sqrt(len(some)) if len(some) > 1 else np.nan)
        return np.array(means), np.array(errors)


def plot_library(rows: Sequence[Mapping[str, Any]], path: str | PathLike[str]) -> None:
    """Draw Z − Z_iso and φ − φJ against p, and the distribution of the lowest frequency, of a library.

    Large symbols are means over the packings of one N and target pressure, with standard errors; dots are
    packings. Those that are judged and not proved minima are crosses, and count for nothing else. Those
    without pressure or contacts are not jammed: they are counted in the title, and not drawn.

    The isostatic number of contacts of the N' disks of the backbone is that of Goodrich, Liu and Nagel,
    Phys. Rev. Lett. 109, 095704 (2012): a periodic packing with a positive bulk modulus needs at least
    N_iso = d·N' − d + 1 contacts, in two dimensions Z_iso = 2·N_iso/N' = 4 − 2/N'. A packing with no
    contact to spare has Z = Z_iso, and no place on a logarithmic axis.

    Overlaps of contacts of exponent α grow as p^a, a = 1/(α − 1), and so does φ − φJ; Z − Z_iso grows as
    its root. The exponent of Z − Z_iso is fitted to the means of p^a·N² > 100, where the number of disks no
    longer matters (same paper, for α = 2), and p^a ≤ 0.01; its error is that of the means, and does not know
    of the window. φJ of each N comes from :func:`fit_phi_J`, with the exponent a. λ is the lowest eigenvalue
    of K with pre-stress, ω = √λ the frequency of disks of unit mass; of each N and target the fraction of
    packings below ω is drawn.

    Parameters
    ----------
    rows : sequence of mappings
        One for each packing, with the keys ``particles``, ``pressure``, ``target`` (target pressure, None if
        not known), ``potential``, ``phi``, ``Z``, ``rattlers``, ``contacts`` (within the backbone),
        ``lowest_eigenvalue`` (None or NaN if not known), ``proved`` (None if not judged).
    path : path

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
        right.colorbar(ScalarMappable(norm, colours), ax=list(stack), label="target pressure", aspect=30)
    figure.suptitle(_summary(rows) + (f"; target pressure {targets[0]:.3g}" if one else ""), fontsize=11)
    save(figure, path)


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
    target = np.where(target > 0, target, [float(f"{x:.1e}") for x in p])
    backbone = n - table["rattlers"]
    backbone[backbone == 0] = np.nan
    excess = 2 * (table["contacts"] - (2 * backbone - 1)) / backbone
    columns = (target, p, table["phi"], excess, table["lowest_eigenvalue"], table["proved"] != 0)
    return [_Size(int(m), MARKERS[s % len(MARKERS)], *(c[n == m] for c in columns)) for s, m in enumerate(np.unique(n))]


def _is_jammed(row: Mapping[str, Any]) -> bool:
    return (row["pressure"] or 0) > 0 and (row["contacts"] or 0) > 0


def _exponent(rows: Sequence[Mapping[str, Any]]) -> float:
    """Return a = 1/(α − 1) of the potential."""
    first, *others = sorted({row["potential"] for row in rows})
    if others:
        raise InputError(f"library: mixed units: the potentials are {', '.join([first, *others])}")
    return 1 / (potential(first).exponent - 1)


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


def _draw_excess(axes: Any, sizes: Sequence[_Size], colour: Any, a: float) -> None:
    curves = [(size, size.excess, f"N = {size.particles}") for size in sizes]
    _draw_curves(axes, curves, colour, "with no contact to spare, no dot")
    axes.set_ylabel(r"$Z - Z_\mathrm{iso}$,  $Z_\mathrm{iso} = 4 - 2/N'$")
    bulk = [
        point
        for size in sizes
        for point in zip(size.mean(size.p)[0], *size.mean(size.excess), strict=True)
        if point[0] ** a * size.particles**2 > BULK and point[0] ** a < DENSE and point[1] > 0
    ]
    p, mean, error = np.array(bulk).reshape(-1, 3).T
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
    axes.legend(loc="upper left", frameon=False, fontsize=9)


def _draw_density(axes: Any, sizes: Sequence[_Size], colour: Any, a: float) -> None:
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
        axes.set(ylabel=r"$\phi$   ($\phi_J$ takes two pressures at one N)")
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
    axes.legend(loc="upper left", frameon=False, fontsize=9)


def _draw_curves(
    axes: Any, curves: Sequence[tuple[_Size, Array, str]], colour: Any, hidden: str, log: bool = True
) -> None:
    """Draw values of (k,) packings against their pressures, and their means."""
    p = np.concatenate([size.p for size, _, _ in curves])
    axes.set(xscale="log", xlabel="pressure $p$", xlim=(p.min() / 1.6, p.max() * 1.6))
    if log:
        axes.set_yscale("log", nonpositive="clip")
        axes.set_ylim(_span(curves))
    bar = {"mec": "0.15", "mew": 0.6, "ecolor": "0.15", "elinewidth": 1, "ms": 6.5, "zorder": 4}
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
    axes.legend(loc="upper left", frameon=False, fontsize=9)


def _span(curves: Sequence[tuple[_Size, Array, str]]) -> tuple[float, float]:
    """Return the range of a logarithmic axis, with room for the legend above."""
    dots = np.concatenate([values for _, values, _ in curves])
    means = np.concatenate([size.mean(values)[0] for size, values, _ in curves])
    dots, means = dots[dots > 0], means[means > 0]
    if not len(dots):
        return 0.1, 10.0
    lowest = means.min() if len(means) else dots.min()
    low = max(min(dots.min(), lowest), lowest / 10)  # a dot may be anywhere between 0 and its mean
    return low / 2, 2 * dots.max() * (dots.max() / low) ** 0.25


def _draw_lowest(panels: Sequence[Any], sizes: Sequence[_Size], colour: Any) -> None:
    """Draw the fraction of packings whose lowest frequency lies below ω, for each N and target."""
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
    panels[-1].set_xlabel(r"lowest frequency $\omega = \lambda^{1/2}$")


def _guide(axes: Any, law: Callable[[Array], Array], text: str) -> None:
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
