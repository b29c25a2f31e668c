"""The figures of VOT with N = 1024: panels against Q and φ, of CD (figs. 1–9) and CD_rot (figs. 10–21, 32, 33).

Axes: s seed, k value of x.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.analysis.flows import mean, over_seeds
from petscjam.analysis.statistics import standard_error
from petscjam.analysis.transitions import JAMMING, Located, crossing, divergence, midpoint, onset
from petscjam.base.errors import InputError
from petscjam.base.types import Array
from petscjam.figures.data import FigureData
from petscjam.figures.flows import Drawing, Flows, Search, bisection
from petscjam.md.engine import BINS
from petscjam.md.grid import Point, grid
from petscjam.md.result import Mean, Run
from petscjam.plots.figure import PALETTE, save
from petscjam.plots.legends import Shades, setting
from petscjam.plots.shear import VELOCITIES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Runs = dict[Point, Run]
BRIEF = 0.01  # longest mean contact, in the time of the means, for VOT eq. 25
CRITICAL = 0.80  # φc of CD_rot at small Q, N = 1024 (VOT fig. 17)
LABELS = {"phi": "φ = {:g}", "Q": "Q = {:.3g}", "rate": "γ̇ = {:.0e}"}
AXES = {"phi": r"$\phi$", "Q": "$Q$", "rate": r"$\dot\gamma\tau_e$"}


@dataclass(frozen=True)
class Quantity:
    """A number of a flow: symbol of the axis, its name in the table, and its value from a mean of a run.

    Attributes
    ----------
    symbol, name, what : str
        ``what`` as for :func:`petscjam.analysis.flows.mean`.
    factor : callable
        Of a point: the mean is multiplied by it.
    """

    symbol: str
    name: str
    what: str
    factor: Callable[[Point], float] = lambda point: 1.0

    def of(self, points: Sequence[Point], runs: Runs) -> Mean:
        """Return the mean over seeds, and its error.

        Parameters
        ----------
        points : sequence of Point
            That differ in the seed.
        runs : dict
            By point.
        """
        value, error = over_seeds([runs[p] for p in points], self.what)
        return Mean(value * self.factor(points[0]), error * self.factor(points[0]))


P_EL = Quantity(r"$P^{\rm el}$  ($m/\tau_e^2$)", "P_el", "pressure_elastic")
ETA_P = Quantity(r"$\eta_p^{\rm el}$  ($m/\tau_e^2$)", "ηp_el", "pressure_elastic", lambda p: p.Q / p.rate)
B_P = Quantity(r"$B_p^{\rm el}$  ($m/\tau_e^2$)", "Bp_el", "pressure_elastic", lambda p: p.rate**-2)
Z = Quantity("$Z$", "Z", "contacts")
PRODUCT = Quantity(r"$2\tau_{\rm dur}\nu_{\rm coll}$", "2τdurνcoll", "product")
DURATION = Quantity(r"$\tau_{\rm dur}/\tau_e$", "τdur/τe", "duration_time")
COLLISIONS = Quantity(r"$\nu_{\rm coll}/\dot\gamma$", "νcoll/γ̇", "collision_rate", lambda p: 1 / p.rate)
SPIN = Quantity(r"$\langle\dot\theta_i/\dot\gamma\rangle$", "⟨θ̇⟩/γ̇", "spin", lambda p: 1 / p.rate)
SPIN_VARIANCE = Quantity(r"var$[\dot\theta_i/\dot\gamma]$", "var θ̇/γ̇", "spin_variance", lambda p: p.rate**-2)


class Scan:
    """The runs of one model, by what they are for.

    Parameters
    ----------
    data : FigureData
    model : str
        ``CD`` or ``CD_rot``.
    """

    def __init__(self, data: FigureData, model: str) -> None:
        self.data, self.model, self.parameters = data, model, data.parameters
        p = data.parameters
        self.flows = Flows(data, model, p["strain"], p["budget"], p["goal"])
        self.phis, self.Qs = p.points("phi").tolist(), p.points("Q").tolist()
        self.rates, self.details = p.points("rates").tolist(), p.points("details").tolist()

    @property
    def rate(self) -> float:
        """The rate of the scan over φ and Q."""
        return float(self.parameters["rate"])

    @property
    def low(self) -> tuple[float, float]:
        """The two lowest rates, for the criteria of Appendix A."""
        first, second, *_ = sorted({self.rate, *self.rates})
        return first, second

    def transition(self, phi: float) -> str:
        """Return ``Qc``, or ``Q*`` where the flow is Bagnoldian on both sides (CD_rot below φc)."""
        return "Qc" if self.model == "CD" or phi >= CRITICAL else "Q*"

    def points(self, phi: Sequence[float] = (), Q: Sequence[float] = (), rate: Sequence[float] = ()) -> list[Point]:
        """Return points; an empty sequence stands for all φ, all Q, the rate of the scan.

        Parameters
        ----------
        phi, Q, rate : sequences of float
        """
        n, seeds = self.parameters["particles"], self.parameters["seeds"]
        return grid([self.model], [n], phi or self.phis, Q or self.Qs, rate or [self.rate], seeds)

    @property
    def runs(self) -> Runs:
        """All runs so far, on rank 0."""
        return self.flows.runs

    def shares(self) -> dict[float, dict[float, list[float]]]:
        """Return the shares of Newtonian strain by φ and Q near Qc (:func:`bisection`); on rank 0 only. Collective."""
        rounds = int(self.parameters["rounds"])
        searches: list[Search[Any]] = [bisection(self.points([phi]), rounds, self.flows.file) for phi in self.phis]
        return dict(zip(self.phis, self.flows.search(searches), strict=True))

    def located(self, shares: dict[float, dict[float, list[float]]]) -> dict[float, Located]:
        """Return Qc of each φ that has one."""
        found = {phi: crossing(list(some), np.array(list(some.values())).T) for phi, some in shares.items() if some}
        return {phi: Qc for phi, Qc in found.items() if np.isfinite(Qc.value)}

    def differences(self, key: str, points: Sequence[Point], quantity: Quantity) -> tuple[Array, Array]:
        """Return x (K,) and the difference of a quantity between the two lowest rates (S, K) at ``points``.

        Parameters
        ----------
        key : str
            ``Q`` or ``phi``: x.
        points : sequence of Point
            At one value of the other.
        quantity : Quantity
        """
        first, second = self.low
        x = sorted({getattr(p, key) for p in points})
        seeds = sorted({p.seed for p in points})
        at = {(getattr(p, key), p.rate, p.seed): p for p in points}

        def value(y: float, rate: float, seed: int) -> float:
            point = at[y, rate, seed]
            return mean(self.runs[point], quantity.what).value * quantity.factor(point)

        return np.array(x), np.array([[value(y, first, s) - value(y, second, s) for y in x] for s in seeds])


def draw_lines(
    data: FigureData,
    axes: Axes,
    points: Sequence[Point],
    runs: Runs,
    quantity: Quantity,
    x: str,
    key: str,
    *,
    note: str = "",
    filled: bool = True,
) -> None:
    """Draw a quantity against ``x``, one line for each value of ``key``, and add it to the table of numbers.

    Parameters
    ----------
    data : FigureData
    axes
        Of matplotlib.
    points : sequence of Point
    runs : dict
        By point.
    quantity : Quantity
    x, key : str
        ``phi``, ``Q`` or ``rate``.
    note : str
        Added to the name in the table, as ``φ = 0.82``.
    filled : bool
        Symbols, and labels in the legend.
    """
    shades = Shades(key, [getattr(p, key) for p in points])
    for value in shades.values:
        colour, fmt = shades(value), f"{shades.marker(value)}-"
        xs = sorted({getattr(p, x) for p in points if getattr(p, key) == value})
        found = [
            quantity.of([p for p in points if getattr(p, key) == value and getattr(p, x) == one], runs) for one in xs
        ]
        y, error = np.array(found).T
        label = LABELS[key].format(value)
        style: dict[str, Any] = {"fmt": fmt, "ms": 4, "lw": 0.8, "color": colour, "mfc": colour if filled else "white"}
        axes.errorbar(xs, y, np.minimum(error, 0.9 * np.abs(y)), label=setting(key, value) if filled else None, **style)
        for one, mean_, deviation in zip(xs, y, error, strict=True):
            name = ", ".join(part for part in (quantity.name, note, label) if part)
            data.page.number(name, one, mean_, deviation)
    axes.set(xlabel=AXES[x], ylabel=quantity.symbol)


def canvas(rows: int, columns: int) -> tuple[Figure, Any]:
    """Return a figure and its panels, (rows, columns).

    Parameters
    ----------
    rows, columns : int
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.5 * columns, 5 * rows), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def finish(flows: Flows, figure: Figure, panels: Any) -> None:
    """Add legends with each label once, write the picture, and note the runs.

    Parameters
    ----------
    flows : Flows
    figure, panels
        Of matplotlib, as :func:`canvas` returns them.
    """
    for axes in np.ravel(panels):
        handles, labels = axes.get_legend_handles_labels()
        if labels:
            shown = dict(zip(labels, handles, strict=True))
            axes.legend(shown.values(), shown)
    flows.data.page.tallies.append(flows.tally)
    save(figure, flows.data.picture)


def against_Q(scan: Scan, quantity: Quantity) -> Drawing:
    """A quantity against Q at all φ (VOT figs. 1, 4, 10, 12), and Qc from the bisection.

    Parameters
    ----------
    scan : Scan
    quantity : Quantity
    """
    shares = scan.shares()
    yield
    figure, panels = canvas(1, 1)
    axes = panels[0, 0]
    draw_lines(scan.data, axes, scan.points(), scan.runs, quantity, "Q", "phi")
    axes.set(xscale="log", yscale="log")
    for phi, Qc in scan.located(shares).items():
        axes.axvline(Qc.value, ls="--", lw=0.8, color=Shades("phi", scan.phis)(phi), zorder=0)
        scan.data.page.found(f"{scan.transition(phi)} at φ = {phi:g}", *Qc, "")
    finish(scan.flows, figure, panels)


def against_Q_and_rate(scan: Scan, quantities: Sequence[Sequence[Quantity]]) -> Drawing:
    """Quantities against Q at two φ and several rates (VOT figs. 2, 5, 6, 11, 13, 14); the second of a panel is open.

    Parameters
    ----------
    scan : Scan
    quantities : sequence of sequences
        Of each panel at one φ.
    """
    points = scan.points(scan.details, rate=sorted({scan.rate, *scan.rates}))
    scan.flows.make(points)
    yield
    figure, panels = canvas(len(scan.details), len(quantities))
    for phi, row in zip(sorted(scan.details, reverse=True), panels, strict=True):
        for some, axes in zip(quantities, row, strict=True):
            for k, quantity in enumerate(some):
                here = [p for p in points if p.phi == phi]
                draw_lines(scan.data, axes, here, scan.runs, quantity, "Q", "rate", note=f"φ = {phi:g}", filled=k == 0)
            ylabel = ", ".join(quantity.symbol for quantity in some)
            axes.set(xscale="log", yscale="log", title=f"φ = {phi:g}", ylabel=ylabel)
    if [PRODUCT] in [list(some[1:]) for some in quantities]:
        _compare_product(scan, points)
    if quantities[0] == (ETA_P,):
        _independence(scan, points)
    finish(scan.flows, figure, panels)


def _compare_product(scan: Scan, points: Sequence[Point]) -> None:
    """Note how well Z = 2 τdur νcoll (VOT eq. 25) holds: contacts that are open at the end have no duration yet."""
    short: list[float] = []
    long: list[float] = []
    for run in (scan.runs[p] for p in points):
        product, contacts, duration = (mean(run, what) for what in ("product", "contacts", "duration_time"))
        window = float(np.ptp(run.time[run.after()]))
        (short if duration.value < BRIEF * window else long).append(product.value / contacts.value)
    for some, relation in ((short, "below"), (long, "above")):
        if some:
            remark = f"{len(some)} runs, {min(some):.3g} to {max(some):.3g}"
            name = f"2τdurνcoll/Z, τdur {relation} {BRIEF:g} of the time of the means"
            scan.data.page.mean(name, some, "1" if some is short else "", remark)


def _independence(scan: Scan, points: Sequence[Point]) -> None:
    """Note the scatter of ηp over Q in the Newtonian state (Z > 1), relative to its mean."""
    for phi in scan.details:
        some = [p for p in points if p.phi == phi and p.rate == scan.rate and scan.runs[p].mean("contacts").value > 1]
        Qs = sorted({p.Q for p in some})
        if len(Qs) > 1:
            values = [ETA_P.of([p for p in some if p.Q == Q], scan.runs) for Q in Qs]
            v, e = np.array(values).T
            weights = e**-2.0 if (e > 0).all() else np.ones_like(v)
            average = float((weights * v).sum() / weights.sum())
            chi2 = float(((v - average) ** 2 / np.where(e > 0, e, np.nan) ** 2).sum() / (len(v) - 1))
            error = float(standard_error(v))
            remark = f"Q = {Qs[0]:g} to {Qs[-1]:g}, χ² per degree of freedom {chi2:.1f}"
            scan.data.page.found(f"ηp_el in the Newtonian state, φ = {phi:g}", average, error, "", remark)


def phase_diagram_CD(scan: Scan) -> Drawing:
    """Qc(φ), and the fit Qc = Q0 + c (φJ − φ)^−x (VOT fig. 3)."""
    shares = scan.shares()
    yield
    page = scan.data.page
    figure, panels = canvas(1, 1)
    axes = panels[0, 0]
    found = scan.located(shares)
    _draw_transition(scan, axes, found, "Qc")
    for phi in scan.phis:
        if phi not in found:
            page.found(f"Qc at φ = {phi:g}", np.nan, np.nan, "", "Z does not fall sharply in this range of Q")
        else:
            values = [
                [scan.runs[p].mean("pressure_elastic").value for p in _row(scan, phi, seed)] for seed in _seeds(scan)
            ]
            page.found(f"midpoint of the fall of P_el, φ = {phi:g}", *midpoint(scan.Qs, values), "")
    phi, Qc, error = np.reshape([(phi, *Qc) for phi, Qc in found.items()], (-1, 3)).T
    try:
        fit = divergence(phi, Qc, error)
    except InputError as problem:
        page.found("x of Qc = Q0 + c (φJ − φ)^−x", np.nan, np.nan, "1.1 ± 0.1", str(problem))
    else:
        page.found("x of Qc = Q0 + c (φJ − φ)^−x", *fit.x, "1.1 ± 0.1", "φJ = 0.8433 fixed")
        page.found("Q0", *fit.Q0, "1.2")
        page.found("c", *fit.c, "")
        fine = np.linspace(phi.min(), min(phi.max() + 0.01, JAMMING - 1e-3), 200)
        axes.plot(fine, fit(fine), "-", color="0.3", lw=1, label="fit")
    axes.axvline(JAMMING, ls="--", color="0.5", lw=0.8)
    axes.set(xlabel=AXES["phi"], ylabel=AXES["Q"], yscale="log")
    finish(scan.flows, figure, panels)


def _seeds(scan: Scan) -> list[int]:
    return list(scan.parameters["seeds"])


def _row(scan: Scan, phi: float, seed: int) -> list[Point]:
    return [p for p in scan.points([phi]) if p.seed == seed]


def _draw_transition(scan: Scan, axes: Axes, found: dict[float, Located], name: str, colour: str = "k") -> None:
    """Draw located Q against φ, and note them."""
    if found:
        phi, Q, error = np.array([(phi, *Q) for phi, Q in found.items()]).T
        axes.errorbar(phi, Q, np.nan_to_num(error), fmt="o", color=colour, label=name)
    for at, Qc in found.items():
        scan.data.page.found(f"{name} at φ = {at:g}", *Qc, "")
        scan.data.page.number(name, at, *Qc)


def collision_angles(scan: Scan) -> Drawing:
    """Histograms of the collision angle at making and breaking of contacts, for three Q (VOT figs. 8, 18)."""
    shares, points = scan.shares(), scan.points(scan.details)
    scan.flows.make(points)
    yield
    located = scan.located(shares)
    figure, panels = canvas(1, len(scan.details))
    angle = (np.arange(BINS) + 0.5) * 360 / BINS - 180
    for phi, axes in zip(sorted(scan.details, reverse=True), panels[0], strict=True):
        middle = located[phi].value if phi in located else float(np.exp(np.log(scan.Qs).mean()))
        chosen = sorted({scan.Qs[0], min(scan.Qs, key=lambda Q: abs(np.log(Q / middle))), scan.Qs[-1]})
        for k, Q in enumerate(chosen):
            some = [scan.runs[p] for p in points if p.phi == phi and p.Q == Q]
            for name, style in (("making", "-"), ("breaking", "--")):
                counts = np.sum([run.blocks[name].sum(0) for run in some], axis=0)
                density = counts / max(counts.sum(), 1) * BINS / 360
                axes.plot(angle, density, style, color=PALETTE[k], label=f"Q = {Q:.3g}, {name}")
                for at, value in zip(angle, density, strict=True):
                    error = float(np.sqrt(value * BINS / 360 / max(counts.sum(), 1)))
                    scan.data.page.number(f"P(ϑ) at {name}, φ = {phi:g}, Q = {Q:g}", at, value, error)
        axes.set(xlabel=r"collision angle $\vartheta$  (degrees)", ylabel=r"$P(\vartheta)$  (1/degree)", yscale="log")
        axes.set_title(f"φ = {phi:g}, Qc = {middle:.3g}")
    finish(scan.flows, figure, panels)


def tangential_collisions(scan: Scan) -> Drawing:
    """P(ϑ = 90°) against Q (VOT figs. 9, 19)."""
    points = scan.points(scan.details)
    scan.flows.make(points)
    yield
    figure, panels = canvas(1, len(scan.details))
    near = np.abs(np.abs((np.arange(BINS) + 0.5) * 360 / BINS - 180) - 90) < 360 / BINS
    for phi, axes in zip(sorted(scan.details, reverse=True), panels[0], strict=True):
        for name, symbol in (("making", "o-"), ("breaking", "s--")):
            values = []
            for Q in scan.Qs:
                each = []
                for run in (scan.runs[p] for p in points if p.phi == phi and p.Q == Q):
                    counts = run.blocks[name].sum(0)
                    each.append(counts[near].mean() / max(counts.sum(), 1) * BINS / 360)
                values.append((float(np.mean(each)), float(standard_error(each))))
                scan.data.page.number(f"P(90°) at {name}, φ = {phi:g}", Q, *values[-1])
            y, error_ = np.array(values).T
            axes.errorbar(scan.Qs, y, np.nan_to_num(error_), fmt=symbol, ms=4, lw=0.8, label=name)
        axes.set(xscale="log", yscale="log", xlabel="$Q$", title=f"φ = {phi:g}")
        axes.set_ylabel(r"$P(\vartheta = 90°)$  (1/degree)")
    finish(scan.flows, figure, panels)


def against_phi(scan: Scan, quantities: Sequence[Quantity], *, rates: bool) -> Drawing:
    """Quantities against φ: at all Q (VOT figs. 15, 20) or, with ``rates``, at two Q and several rates (fig. 16).

    Parameters
    ----------
    scan : Scan
    quantities : sequence of Quantity
        One a panel.
    rates : bool
    """
    Qs = scan.parameters.points("Q_details").tolist() if rates else scan.Qs
    points = scan.points(Q=Qs, rate=sorted({scan.rate, *scan.rates}) if rates else [])
    scan.flows.make(points)
    yield
    figure, panels = canvas(len(Qs) if rates else 1, len(quantities))
    for Q, row in zip(Qs if rates else [None], panels, strict=True):
        here = [p for p in points if Q in (None, p.Q)]
        for quantity, axes in zip(quantities, row, strict=True):
            note = "" if Q is None else f"Q = {Q:g}"
            draw_lines(scan.data, axes, here, scan.runs, quantity, "phi", "rate" if rates else "Q", note=note)
            signed = quantity in (SPIN, SPIN_VARIANCE)
            axes.set(yscale="linear" if signed else "log", title=note)
            if quantity is SPIN:
                axes.axhline(-0.5, color="0.7", lw=0.8)
    if rates:
        for Q in Qs:
            _exponent(scan, Q)
    if SPIN in quantities:
        values = [SPIN.of([p], scan.runs).value for p in points]
        scan.data.page.mean("⟨θ̇⟩/γ̇ over all runs", values, "−1/2")
    finish(scan.flows, figure, panels)


def _exponent(scan: Scan, Q: float) -> None:
    """Note d ln P^el/d ln γ̇ at the largest φ: 1 in Newtonian flow, 2 in Bagnoldian flow."""
    phi, rates = max(scan.phis), scan.low
    each = [[mean(scan.runs[p], "pressure_elastic").value for p in scan.points([phi], [Q], [rate])] for rate in rates]
    slopes = np.subtract(*np.log(each)) / np.log(rates[0] / rates[1])
    remark = f"γ̇ from {rates[0]:g} to {rates[1]:g}; 1: Newtonian, 2: Bagnoldian"
    scan.data.page.mean(f"d ln P^el/d ln γ̇ at φ = {phi:g}, Q = {Q:g}", slopes, "1", remark)


def contact_velocities(scan: Scan) -> Drawing:
    """Scatter of the components of the contact velocity, and principal axes of their covariance (VOT fig. 21)."""
    Q = scan.parameters.points("Q_details").tolist()[:1]
    points = scan.points(scan.details, Q)
    scan.flows.make(points)
    yield
    words = "V_T", "V^R", "V^C_T", "V_N"
    figure, panels = canvas(3, len(scan.details))
    for phi, column in zip(sorted(scan.details), panels.T, strict=True):
        some = [scan.runs[p] for p in points if p.phi == phi]
        dots = np.concatenate([run.blocks["scatter"].reshape(-1, 4) for run in some])
        each = [_covariance([run]) for run in some]
        centre, covariance = _covariance(some)
        for axes, (a, b) in zip(column, ((1, 0), (1, 2), (2, 3)), strict=True):
            axes.plot(*dots[:, [a, b]].T, ".", ms=1, alpha=0.3, rasterized=True)
            for length, way in zip(*np.linalg.eigh(covariance[np.ix_([a, b], [a, b])]), strict=True):
                axes.plot(*(centre[[a, b], None] + np.outer(way, [-3, 3]) * np.sqrt(max(length, 0))), "k:", lw=1)
            axes.plot(*centre[[a, b]], "wo", mec="k", ms=6)
            axes.set(xlabel=VELOCITIES[a], ylabel=VELOCITIES[b], title=f"φ = {phi:g}, Q = {Q[0]:g}")
            correlations = [c[a, b] / np.sqrt(c[a, a] * c[b, b]) for _, c in each]
            scan.data.page.mean(f"correlation of {words[b]} and {words[a]}, φ = {phi:g}", correlations, "")
    finish(scan.flows, figure, panels)


def _covariance(runs: Sequence[Run]) -> tuple[Array, Array]:
    """Return the mean (4,) and the covariance (4, 4) of V_T, V^R, V^C_T and V_N over the contacts of runs."""
    count, first, second = (
        np.sum([run.blocks[name].sum(0) for run in runs], axis=0) for name in ("pairs", "first", "second")
    )
    first, second = first / count, second / count
    return first, second - np.outer(first, first)


def differences_Q(scan: Scan) -> Drawing:
    """Z/γ̇ at the lowest rate minus that at the next one, against Q: Qc and Q* (VOT fig. 32)."""
    points = scan.points(scan.details, rate=scan.low)
    scan.flows.make(points)
    yield
    figure, panels = canvas(1, len(scan.details))
    for phi, axes in zip(sorted(scan.details, reverse=True), panels[0], strict=True):
        quantity = Quantity("", "", "contacts", lambda p: 1 / p.rate)
        x, values = scan.differences("Q", [p for p in points if p.phi == phi], quantity)
        _draw_differences(scan, axes, x, values, f"Z/γ̇ difference, φ = {phi:g}")
        found = onset(x[::-1], values[:, ::-1])
        _note(scan, f"{scan.transition(phi)} at φ = {phi:g} from Z/γ̇", found, "")
        axes.axvline(found.value, color="0.7", lw=0.8)
        axes.set(xlabel="$Q$", xscale="log", title=f"φ = {phi:g}")
        axes.set_ylabel(r"$Z/\dot\gamma_1 - Z/\dot\gamma_2$  ($\tau_e$)")
    finish(scan.flows, figure, panels)


def differences_phi(scan: Scan) -> Drawing:
    """Bp^el at the lowest rate minus that at the next one, against φ: φc (VOT fig. 33)."""
    Qs = scan.parameters.points("Q_details").tolist()
    points = scan.points(Q=Qs, rate=scan.low)
    scan.flows.make(points)
    yield
    figure, panels = canvas(1, len(Qs))
    for Q, axes in zip(Qs, panels[0], strict=True):
        x, values = scan.differences("phi", [p for p in points if p.Q == Q], B_P)
        _draw_differences(scan, axes, x, values, f"Bp_el difference, Q = {Q:g}")
        found = onset(x, values)
        _note(scan, f"φc at Q = {Q:g} from Bp_el", found, "0.80" if Q == 1 else "")
        axes.axvline(found.value, color="0.7", lw=0.8)
        axes.set(xlabel=r"$\phi$", ylabel=r"$B^{\rm el}_{p1} - B^{\rm el}_{p2}$  ($m/\tau_e^2$)", title=f"Q = {Q:g}")
    finish(scan.flows, figure, panels)


def _note(scan: Scan, name: str, found: Located, paper: str) -> None:
    """Note where a difference becomes nonzero, or that it does not."""
    first, second = scan.low
    remark = f"γ̇ = {first:g} and {second:g}" + ("" if np.isfinite(found.value) else ": no onset")
    scan.data.page.found(name, *found, paper, remark)


def _draw_differences(scan: Scan, axes: Axes, x: Array, values: Array, name: str) -> None:
    y = values.mean(0)
    error = standard_error(values)
    axes.errorbar(x, y, np.nan_to_num(error), fmt="o-", ms=4, lw=0.8, color="k")
    axes.axhline(0, color="0.7", lw=0.8)
    for row in zip(x, y, error, strict=True):
        scan.data.page.number(name, *row)


def phase_diagram_CD_rot(scan: Scan) -> Drawing:
    """Qc(φ), φc(Q) and Q*(φ) (VOT fig. 17)."""
    shares = scan.shares()
    Qs = scan.parameters.points("Q_details").tolist()
    by_Q, by_phi = scan.points(scan.details, rate=scan.low), scan.points(Q=Qs, rate=scan.low)
    scan.flows.make([*by_Q, *by_phi])
    yield
    figure, panels = canvas(1, 1)
    axes = panels[0, 0]
    located = scan.located(shares)
    for name, colour in (("Qc", "k"), ("Q*", PALETTE[1])):
        some = {phi: Q for phi, Q in located.items() if scan.transition(phi) == name}
        _draw_transition(scan, axes, some, name, colour)
    for phi in scan.details:
        quantity = Quantity("", "", "contacts", lambda p: 1 / p.rate)
        x, values = scan.differences("Q", [p for p in by_Q if p.phi == phi], quantity)
        found = onset(x[::-1], values[:, ::-1])
        name = f"{scan.transition(phi)} from Z/γ̇ at two rates"
        _note(scan, f"{name}, φ = {phi:g}", found, "")
        error, label = [np.nan_to_num(found.error)], "Z/γ̇ at two rates"
        axes.errorbar([phi], [found.value], error, fmt="s", color=PALETTE[0], label=label)
    for Q in Qs:
        found = onset(*scan.differences("phi", [p for p in by_phi if p.Q == Q], B_P))
        _note(scan, f"φc at Q = {Q:g}", found, "0.80" if Q == 1 else "")
        axes.errorbar([found.value], [Q], xerr=[np.nan_to_num(found.error)], fmt="^", color=PALETTE[2], label="φc")
    axes.axvline(JAMMING, ls="--", color="0.5", lw=0.8)
    axes.set(xlabel=AXES["phi"], ylabel=AXES["Q"], yscale="log")
    finish(scan.flows, figure, panels)
