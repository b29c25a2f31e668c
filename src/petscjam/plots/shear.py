"""Figures of sheared disks: a run, local maps, a ramp, and flow curves of many runs (VOT figs. 1–31)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.analysis.statistics import standard_error
from petscjam.base.errors import InputError
from petscjam.base.types import Array
from petscjam.geometry.box import Box
from petscjam.md.banding import Bands, NoBandsError, bands
from petscjam.md.fields import RADIUS, blocks_after, local_maps, profile
from petscjam.md.model import MODELS, Model
from petscjam.md.oscillations import harmonics
from petscjam.md.result import Mean, Run
from petscjam.md.state import State
from petscjam.plots.figure import LOSS, PALETTE, STABLE, STORAGE, disks, finished, house_style, scale_bar
from petscjam.plots.legends import MARKERS, Shades, axis_label, law_text, legend, number, setting
from petscjam.plots.packing import OUTLINED
from petscjam.plots.tables import describe_bands, means_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase


HARMONICS = 1, 3, 5, 7, 9
GREY, WARNED = "0.35", 4  # warnings shown below a figure of many runs
DEFAULT = "harmonic-relative"  # that of VOT, not in the title
VELOCITIES = [  # in the order of md.result.MIXED
    rf"${name}$  ($d_s\dot\gamma$)" for name in ("V_{ij,T}", "V^R_{ij}", "V^C_{ij,T}", "V_{ij,N}")
]


def _title(run: Run) -> str:
    s = run.settings
    potential = run.state.potential_name
    repulsion = f", {setting('potential', potential)}" * (potential != DEFAULT)
    size = f"$N$ = {s.particles}{repulsion}"
    return rf"{_model(s.model)}, {size}, $\phi$ = {s.phi:.5g}, $Q$ = {number(s.model.Q)}"


def _model(model: Model) -> str:
    """Return the name of a model with its subscript, or its law."""
    if model.name not in MODELS:
        return law_text(model.law)
    head, _, index = model.name.partition("_")
    return rf"{head}$_\mathrm{{{index}}}$" if index else model.name


def _warn(figure: FigureBase, texts: Sequence[str]) -> None:
    """Write warnings below the panels."""
    if texts:
        figure.supxlabel("\n".join(f"warning: {text}" for text in texts), color="#b00020", fontsize=9)


# --- one run ------------------------------------------------------------------------------------------


@house_style()
def plot_run(run: Run, path: str | PathLike[str] | None = None) -> Figure:
    """Draw one run: its time series, profiles, collision angles, contact velocities, and a table of means.

    An oscillation has loops of the stress against strain and strain rate, and harmonics, instead of profiles.

    Means, profiles and histograms leave out the first quarter of the strain, shaded in the time series.

    Parameters
    ----------
    run : Run
    path : str or PathLike, optional
        Write the figure; its extension gives the format.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If the figure cannot be written.
    """
    from matplotlib.figure import Figure

    figure: Any = Figure(figsize=(16, 11), layout="constrained")
    figure.get_layout_engine().set(wspace=0.04, hspace=0.05)
    panels, found = figure.subplots(3, 4), None
    with suppress(NoBandsError):
        found = bands(run)
    _draw_series(panels[0], run)
    if run.settings.protocol == "oscillation":
        _draw_loops(panels[1, :3], run)
    else:
        draw_profiles(panels[1, :3], run, found)
    _draw_angles(panels[1, 3], run)
    _draw_velocities(panels[2, :3], run)
    _draw_means(panels[2, 3], run, found)
    history = run.settings.history
    how = rf"$\dot\gamma\tau_e$ = {number(history['rate'])}"
    if run.settings.protocol == "oscillation":
        how = rf"$\gamma_0$ = {number(history['amplitude'])}, $\omega\tau_e$ = {number(history['omega'])}"
    figure.suptitle(f"{_title(run)}, {how}")
    _warn(figure, run.warnings)
    return finished(figure, path)


def _draw_series(panels: Sequence[Axes], run: Run) -> None:
    stresses, contacts, friction, energy = panels
    strain = np.append(run.settings.strain0, run.strain)
    to_and_fro = not (np.diff(strain) > 0).all() and not (np.diff(strain) < 0).all()
    x, label = (run.time, r"time $t/\tau_e$") if to_and_fro else (run.strain, r"strain $\gamma$")
    for name, values, elastic, colour in (
        ("P", run.pressure, run.pressure_elastic, STORAGE),
        (r"\Sigma", run.stress, run.stress_elastic, LOSS),
    ):
        for some, style, text in ((values, "-", f"${name}$"), (elastic, ":", "elastic part")):
            some = some if to_and_fro else np.where(some > 0, some, np.nan)
            stresses.plot(x, some, style, color=colour, lw=1.1, label=text)
    stresses.set(ylabel=r"stress  ($m/\tau_e^2$)", yscale="linear" if to_and_fro else "log")
    stresses.legend(ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1), columnspacing=1, handlelength=1.5)
    contacts.plot(x, run.contacts, color=STABLE, lw=1.1)
    contacts.set(ylabel="contacts of a disk  $Z$", ylim=(0, 1.1 * max(run.contacts.max(), 1e-3)))
    friction.plot(x, run.friction, color=GREY, lw=1.1)
    friction.set(ylabel=r"friction $\mu = \Sigma/P$")
    with np.errstate(divide="ignore", invalid="ignore"):
        imbalance = np.abs(np.cumsum(run.rows["imbalance"])) / np.cumsum(run.rows["heat"])
    energy.semilogy(x, np.where(imbalance > 0, imbalance, np.nan), color=GREY, lw=1.1)
    energy.set(ylabel="energy not accounted for / heat")
    for axes in panels:
        start = run.settings.time0 if to_and_fro else run.settings.strain0
        axes.axvspan(start, x[np.argmax(run.after())], color="0.93", lw=0, zorder=0)
        axes.set(xlabel=label, xlim=sorted((start, x[-1])))


def _draw_loops(panels: Sequence[Axes], run: Run) -> None:
    """Draw Σ against γ and γ̇, with the harmonics of the mean cycle, and the sizes of the harmonics."""
    elastic, viscous, sizes = panels
    strain = np.append(run.settings.strain0, run.strain)
    elastic.plot((strain[1:] + strain[:-1]) / 2, run.stress, color=LOSS, lw=0.8, label="rows")
    viscous.plot(run.rate, run.stress, color=LOSS, lw=0.8)
    elastic.set(xlabel=r"strain $\gamma$", ylabel=r"shear stress $\Sigma$  ($m/\tau_e^2$)")
    viscous.set(xlabel=r"strain rate $\dot\gamma\tau_e$", ylabel=r"shear stress $\Sigma$  ($m/\tau_e^2$)")
    sizes.set(xlabel="harmonic $n$", ylabel=r"$|G_n|$  ($m/\tau_e^2$)")
    try:
        found = harmonics(run, orders=HARMONICS)
    except InputError as reason:
        sizes.text(0.5, 0.5, str(reason), transform=sizes.transAxes, ha="center", wrap=True, fontsize=8)
        return
    phase = np.linspace(0, 2 * np.pi, 401)
    waves = [(G * np.exp(1j * n * phase)).imag for n, G in zip(found.orders, found.moduli, strict=True)]
    stress = found.amplitude * np.sum(waves, axis=0)
    drawn = ", ".join(map(str, found.orders.tolist()))
    elastic.plot(found.amplitude * np.sin(phase), stress, "--", color="0.1", lw=1.2, label=f"n = {drawn}")
    viscous.plot(found.amplitude * found.omega * np.cos(phase), stress, "--", color="0.1", lw=1.2)
    elastic.legend()
    size, error = np.abs(found.moduli), np.nan_to_num(np.abs(found.errors))
    sizes.errorbar(found.orders, size, np.minimum(error, 0.9 * size), fmt="o", color=STORAGE, capsize=2)
    sizes.set(yscale="log", xticks=found.orders)


def draw_profiles(panels: Sequence[Axes], run: Run, found: Bands | None) -> None:
    """Draw vx(y), its slope and φ(y) (VOT fig. 28); two bands are moved to the middle, and drawn with their fit.

    Parameters
    ----------
    panels
        Three, of matplotlib.
    run : Run
    found : Bands, optional
        Vertical lines are at the edges of the Bagnoldian band: from the strain rates, in the last panel from φ.
    """
    p, fits = (found.profile, found.fitted) if found else (profile(run), [None] * 3)
    for axes, values, error, fit, colour, label, mean in (
        (panels[0], p.vx, p.vx_error, fits[0], STORAGE, r"$v_x(y)$  ($d_s/\tau_e$)", None),
        (panels[1], p.rate, p.rate_error, fits[1], LOSS, r"local strain rate $dv_x/dy$  ($1/\tau_e$)", p.mean_rate),
        (panels[2], p.phi, p.phi_error, fits[2], STABLE, r"local packing fraction $\phi(y)$", p.mean_phi),
    ):
        axes.fill_between(p.y, values - error, values + error, color=colour, alpha=0.25, lw=0)
        axes.plot(p.y, values, color=colour, lw=1.3)
        if mean is None:
            axes.plot(p.y, p.vx.mean() + p.mean_rate * (p.y - p.length / 2), "--", color=GREY, lw=0.9)
        else:
            axes.axhline(mean, color=GREY, ls="--", lw=0.9)
        if found and fit is not None:
            axes.plot(p.y, fit, ":", color="0.1", lw=1.4)
            share = (found.share_phi if axes is panels[2] else found.share)[0]
            for edge in (1 - share, 1 + share):
                axes.axvline(edge * p.length / 2, color="0.6", ls=":", lw=1)
        axes.set(xlabel="$y/d_s$" + ", moved with the bands" * bool(found), ylabel=label, xlim=(0, p.length))
        axes.ticklabel_format(axis="y", style="sci", scilimits=(-2, 4), useMathText=True, useOffset=False)


def _draw_angles(axes: Axes, run: Run) -> None:
    """Draw P(ϑ) at making and breaking of contacts (VOT fig. 8)."""
    kept = blocks_after(run)
    made, broken = (run.blocks[key][kept].sum(0).astype(float) for key in ("making", "breaking"))
    edges = np.linspace(-180, 180, len(made) + 1)
    density = 1 / max((made + broken).sum() * (edges[1] - edges[0]), 1)
    axes.stairs(made * density, edges, fill=True, color=STORAGE, alpha=0.35, label="made")
    axes.stairs(
        (made + broken) * density, edges, baseline=made * density, fill=True, color=LOSS, alpha=0.35, label="broken"
    )
    axes.stairs((made + broken) * density, edges, color=GREY, lw=0.8)
    axes.set(
        xlabel=r"collision angle $\vartheta$ (degrees)",
        ylabel=r"$\mathcal{P}(\vartheta)$  (1/degree)",
        xlim=(-180, 180),
        xticks=np.arange(-180, 181, 90),
        ylim=(0, None),
    )
    axes.legend()


def _draw_velocities(panels: Sequence[Axes], run: Run, most: int = 5000) -> None:
    """Draw the correlation of the velocities of contacts, mean and principal axes (VOT fig. 21)."""
    kept = blocks_after(run)
    points = run.blocks["scatter"][kept].reshape(-1, 4)
    points = points[np.isfinite(points).all(1)][:most]
    pairs = run.blocks["pairs"][kept].sum()
    for axes, (x, y) in zip(panels, ((1, 0), (1, 2), (2, 3)), strict=True):
        if len(points) and not points[:, [x, y]].any(0).all():  # no rotations
            axes.set_axis_off()
            continue
        axes.set(xlabel=VELOCITIES[x], ylabel=VELOCITIES[y], aspect="equal")
        axes.axhline(0, color="0.8", lw=0.8, zorder=0)
        axes.axvline(0, color="0.8", lw=0.8, zorder=0)
        if not len(points):
            continue
        reach = 1.1 * float(np.quantile(np.abs(points), 0.995)) or 1.0
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
        axes.plot(points[:, x], points[:, y], ".", color=STORAGE, ms=2, alpha=0.35, mew=0, rasterized=True)
        mean = run.blocks["first"][kept].sum(0) / pairs
        covariance = run.blocks["second"][kept].sum(0) / pairs - np.outer(mean, mean)
        pick = [x, y]
        variances, directions = np.linalg.eigh(covariance[np.ix_(pick, pick)])
        for variance, way in zip(variances, directions.T, strict=True):
            ends = mean[pick] + 3 * np.sqrt(max(variance, 0)) * np.array([[-1], [1]]) * way
            axes.plot(*ends.T, ":", color="k", lw=1.3)
        axes.plot(*mean[pick], "o", color="white", mec="k", ms=5)
    panels[1].set_title("velocity differences at contacts")


def _draw_means(axes: Axes, run: Run, found: Bands | None) -> None:
    axes.set_axis_off()
    lines = ["time means after a quarter of the strain", ""]
    lines += means_of(run, "{:10s} {:11.4g} ± {:.2g}") if run.after().sum() > 1 else ["the run is too short"]
    if found:
        lines += ["", *describe_bands(found)]
    axes.text(0.02, 0.98, "\n".join(lines), transform=axes.transAxes, va="top", family="monospace", fontsize=9)


# --- maps ---------------------------------------------------------------------------------------------


@house_style()
def plot_maps(state: State, path: str | PathLike[str] | None = None, radius: float = RADIUS) -> Figure:
    """Draw every disk in the colour of the packing fraction, and of the strain rate, around it (VOT fig. 27).

    The range of colours leaves out the lowest and the highest per cent.

    Parameters
    ----------
    state : State
    path : str or PathLike, optional
        Write the figure; its extension gives the format.
    radius : float
        Of the circle around a disk in which both are measured, ds.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If the figure cannot be written.
    """
    from matplotlib.figure import Figure

    size = float(np.clip(0.16 * np.sqrt(len(state)), 5.0, 9.0))  # inches
    figure = Figure(figsize=(2.2 * size, size + 0.6), layout="constrained")
    panels = figure.subplots(1, 2)
    phi, rate = local_maps(state, radius)
    disk, centre = state.box.images(state.positions, state.radii[:, None], Box(np.diag([state.length, state.height])))
    for axes, values, colours, text in (
        (panels[0], phi, "viridis", r"local packing fraction $\phi(x, y)$"),
        (panels[1], rate, "plasma", r"local strain rate $\dot\gamma(x, y)\,\tau_e$"),
    ):
        drawn = _draw_disks(axes, state, values, colours, disk, centre)
        bar: Any = figure.colorbar(drawn, ax=axes, extend="both", shrink=0.85, pad=0.02)
        bar.formatter.set_powerlimits((-2, 3))
        bar.formatter.set_useMathText(True)
        axes.set_title(text)
    figure.suptitle(
        rf"{len(state)} disks, $\phi$ = {state.phi:.5g}, $\dot\gamma\tau_e$ = {number(state.rate)}, "
        rf"$\gamma$ = {state.strain:.5g}; circles of {radius:g} $d_s$"
    )
    return finished(figure, path)


def _draw_disks(axes: Axes, state: State, values: Array, colours: str, disk: Any, centre: Array) -> Any:
    many = len(state) > OUTLINED
    style = {"array": values[disk], "cmap": colours, "linewidths": 0, "edgecolors": "none"}
    drawn = disks(axes, centre, state.radii[disk], **style)
    known = values[np.isfinite(values)]
    if len(known):
        drawn.set_clim(*np.quantile(known, [0.01, 0.99]))
    drawn.set_rasterized(many)
    axes.add_collection(drawn, autolim=False)
    axes.set(xlim=(0, state.length), ylim=(0, state.height), aspect="equal", xticks=[], yticks=[])
    scale_bar(axes, 1.0, "d_s")
    return drawn


# --- a ramp -------------------------------------------------------------------------------------------


@house_style()
def plot_ramp(run: Run, path: str | PathLike[str] | None = None) -> Figure:
    """Draw Σ and P against the strain rate, increasing (filled) and decreasing (open) (VOT fig. 31).

    Parameters
    ----------
    run : Run
    path : str or PathLike, optional
        Write the figure; its extension gives the format.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If ``run`` is not a ramp, or the figure cannot be written.
    """
    from matplotlib.figure import Figure

    if run.settings.protocol != "ramp":
        raise InputError(f"plot: the run is not a ramp, but of the protocol {run.settings.protocol!r}")
    figure = Figure(figsize=(12.5, 5.4), layout="constrained")
    panels = figure.subplots(1, 2)
    rate = np.abs(run.rate)
    up = np.diff(rate, prepend=run.settings.history["rate"]) >= 0
    for axes, values, name in (
        (panels[0], np.abs(run.stress), r"shear stress $\Sigma$  ($m/\tau_e^2$)"),
        (panels[1], run.pressure, r"pressure $P$  ($m/\tau_e^2$)"),
    ):
        axes.set(xscale="log", yscale="log", xlabel=r"strain rate $\dot\gamma\tau_e$", ylabel=name)
        for some, marker, colour, face, text in ((up, "o", STORAGE, STORAGE, "up"), (~up, "s", LOSS, "white", "down")):
            good = some & (values > 0) & (rate > 0)
            axes.plot(rate[good], values[good], marker, color=colour, mfc=face, ms=4.5, mew=0.9, label=text)
        draw_slopes(axes, rate, np.where(values > 0, values, np.nan))
        axes.legend(loc="lower right")
    figure.suptitle(rf"{_title(run)}, $\tilde\kappa$ = {number(run.settings.history['kappa'])}")
    _warn(figure, run.warnings)
    return finished(figure, path)


def draw_slopes(axes: Axes, rate: Array, values: Array) -> None:
    """Draw slope 2 at low rates and slope 1 at high rates: Bagnoldian and Newtonian flow.

    Parameters
    ----------
    axes
        Of matplotlib, both logarithmic.
    rate, values : (K,)
        Values that are not finite are left out.
    """
    low, high = rate.min(), rate.max()
    span = (high / low) ** 0.35
    for slope, anchor, at, factor, side in ((2, low, span, 0.5, -1), (1, high, 1 / span, 2.0, 1)):
        near = np.abs(np.log(rate / anchor)) < 0.2
        height = factor * float(np.nanmedian(values[near])) if np.isfinite(values[near]).any() else np.nan
        ends = anchor * np.array([1, at])
        guide = height * (ends / anchor) ** slope
        if np.isfinite(guide).all():
            axes.plot(ends, guide, "--", color="0.4", lw=1)
            middle = np.sqrt(ends.prod()), np.sqrt(guide.prod())
            axes.annotate(
                f"slope {slope}",
                middle,
                (-6 * side, 6 * side),
                color="0.4",
                fontsize=9,
                textcoords="offset points",
                ha="right" if side > 0 else "left",
                va="bottom" if side > 0 else "top",
            )


# --- flow curves --------------------------------------------------------------------------------------

LOGARITHMIC = "rate", "Q"
CURVES: tuple[tuple[str, str, Callable[[Run], Any]], ...] = (
    (r"shear stress $\Sigma$  ($m/\tau_e^2$)", "log", lambda run: run.stress),
    (r"friction $\mu = \Sigma/P$", "linear", lambda run: run.friction),
    (r"$P^\mathrm{el}$  ($m/\tau_e^2$)", "log", lambda run: run.pressure_elastic),
    ("contacts of a disk  $Z$", "log", lambda run: run.contacts),
    (
        r"$\eta_p^\mathrm{el} = QP^\mathrm{el}/\dot\gamma\tau_e$  ($m/\tau_e^2$)",
        "log",
        lambda run: run.settings.model.Q * run.pressure_elastic / run.rate,
    ),
    (
        r"$B_p^\mathrm{el} = P^\mathrm{el}/(\dot\gamma\tau_e)^2$  ($m/\tau_e^2$)",
        "log",
        lambda run: run.pressure_elastic / run.rate**2,
    ),
    (r"$R_v = \langle\delta v_x^2\rangle/\langle v_y^2\rangle$", "log", lambda run: run.banding),
    (r"spin $\langle\dot\theta/\dot\gamma\rangle$", "linear", lambda run: run.rows["spin"] / run.rate),
    (r"var$[\dot\theta/\dot\gamma]$", "log", lambda run: run.rows["spin_variance"] / run.rate**2),
)
RATES = 3  # strain rates that make a flow curve
SPINS = 7  # the panels before those of spins


@house_style()
def plot_flow(runs: Mapping[str, Run], path: str | PathLike[str] | None = None) -> Figure:
    """Draw flow curves of steady runs: Σ and μ first (VOT figs. 1, 2, 12, 16, 20 and 22–24).

    The abscissa is the strain rate if there are three, otherwise the one of strain rate, Q and φ with the most values.
    Each combination of the others, of models and of sizes is a curve, with the number of the most values as its
    colour. A point is the time mean over the last three quarters of a run with its error; for several runs with equal
    settings, their mean and its standard error.

    Parameters
    ----------
    runs : mapping of str to Run
    path : str or PathLike, optional
        Write the figure; its extension gives the format.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If there are no runs, or a run is not at a steady strain rate, or the figure cannot be written.
    """
    from matplotlib.figure import Figure

    if not runs:
        raise InputError("plot: there are no runs")
    for name, run in runs.items():
        if run.settings.protocol != "steady":
            raise InputError(f"plot: {name} is not a steady run, but a {run.settings.protocol}")
    counts = {key: len({_setting(run, key) for run in runs.values()}) for key in ("rate", "Q", "phi")}
    x = "rate" if counts["rate"] >= RATES else max(counts, key=lambda key: counts[key])
    others = [key for key in ("model", "potential", "particles", "phi", "Q", "rate") if key != x]
    curves: dict[tuple[Any, ...], dict[float, list[Run]]] = {}
    for run in runs.values():
        kind = tuple(_setting(run, key) for key in others)
        curves.setdefault(kind, {}).setdefault(_setting(run, x), []).append(run)
    differ = {key: {kind[k] for kind in curves} for k, key in enumerate(others)}
    same = [_parameter(key, *some) for key, some in differ.items() if len(some) == 1 and some != {DEFAULT}]
    numbers = [key for key in others[2:] if len(differ[key]) > 1]
    key = max(numbers, key=lambda key: len(differ[key]), default="")
    shades = Shades(key, differ[key]) if key else None
    rest = [k for k, one in enumerate(others) if one != key and len(differ[one]) > 1]
    kinds = sorted({tuple(kind[k] for k in rest) for kind in curves})
    spins = any(run.rows["spin"].any() for run in runs.values())
    shown = CURVES if spins else CURVES[:SPINS]
    columns = (len(shown) + 1) // 2  # the legend has a place of its own
    figure = Figure(figsize=(3.9 * columns, 7.6), layout="constrained")
    *panels, free = figure.subplots(2, columns).ravel()
    for kind, points in sorted(curves.items()):
        where, place = sorted(points), kinds.index(tuple(kind[k] for k in rest))
        look: dict[str, Any] = {"color": PALETTE[place % len(PALETTE)], "marker": MARKERS[place % len(MARKERS)]}
        if shades:
            level = kind[others.index(shades.key)]
            look |= {"color": shades(level)} if len(kinds) > 1 else shades.look(level)
        for axes, (_, _, value) in zip(panels, shown, strict=True):
            y, error = np.array([_point(points[w], value) for w in where]).T
            axes.errorbar(where, y, error, ms=4, lw=1, capsize=2, **look)
    for axes, (name, scale, _) in zip(panels, shown, strict=True):
        axes.set(xscale="log" if x in LOGARITHMIC else "linear", xlabel=axis_label(x), ylabel=name)
        y = np.concatenate([bars[0].get_ydata() for bars in axes.containers])
        if scale == "log" and y.max() > 3 * y[y > 0].min(initial=np.inf):  # smallest range with good ticks
            axes.set_yscale("log", nonpositive="mask")
    free.set_axis_off()
    for k, some in enumerate(kinds if len(kinds) > 1 else ()):
        label = ", ".join(_parameter(others[r], value) for r, value in zip(rest, some, strict=True))
        colour = "0.4" if shades else PALETTE[k % len(PALETTE)]
        free.plot([], [], f"{MARKERS[k % len(MARKERS)]}-", color=colour, ms=4, lw=1, label=label)
    if shades:
        shades.show(free, markers=len(kinds) == 1, loc="upper left")
    elif len(kinds) > 1:
        legend(free, loc="upper left")
    figure.suptitle(", ".join(same))
    doubtful = {name: run.warnings for name, run in runs.items() if run.warnings}
    shown_of = [f"{name}: {text}" for name, some in doubtful.items() for text in some]
    _warn(figure, shown_of[:WARNED] + [f"… {len(shown_of)} warnings in all"] * (len(shown_of) > WARNED))
    return finished(figure, path)


def _setting(run: Run, key: str) -> Any:
    """Return a setting, numbers to six digits, because packing fractions have the rounding errors of cells."""
    if key == "model":
        return _model(run.settings.model)
    value = run.settings.attributes[key]
    return float(f"{value:.6g}") if key in ("rate", "Q", "phi") else value


def _parameter(key: str, value: Any) -> str:
    return value if key == "model" else setting(key, value)


def _point(alike: list[Run], value: Callable[[Run], Any]) -> Mean:
    """Return mean and error of one run over time, or of several runs over runs."""
    means = [run.mean(value(run)) for run in alike]
    if len(means) == 1:
        return means[0]
    values = [m.value for m in means]
    return Mean(float(np.mean(values)), float(standard_error(values)))
