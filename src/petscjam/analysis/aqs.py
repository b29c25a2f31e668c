"""Athermal quasi-static shear: a packing stays in a minimum of its energy while its cell is sheared.

The cell has the deformation gradient F = 1 + γ e_x e_yᵀ, at constant area. The next state starts from the tangent
response du/dγ of the last one, and its energy is minimised. The tangent response also predicts the strain at which the
first contact opens or closes: no step goes much further, so that changes are met one by one, as in van Deen et al.,
Phys. Rev. E 90, 020202. A change is bracketed to 1e-10 in strain.

Axes: s state, f event, c change of a contact.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petscjam.base import ranges
from petscjam.base.arguments import Within, integer, number
from petscjam.base.errors import InputError, SolverError, shown
from petscjam.base.interrupt import deferred
from petscjam.base.progress import Progress, Report, reporting
from petscjam.base.types import Array, Integers
from petscjam.geometry.neighbours import pairs
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.packing import Certificate, Packing
from petscjam.parallel.comm import Comm, agree, on_root, resolve
from petscjam.preparation.certify import certify, elastic_tensor, negative_modes
from petscjam.preparation.prepare import equilibrium, relax_packing
from petscjam.response.origin import Judged, Verb, stored
from petscjam.response.problem import LinearProblem, describe

RESOLUTION = 1e-10  # in strain, of an event
BEYOND = 1.01  # length of a step, in units of the predicted strain to the next event
XY = 1  # of F, in the order of :func:`petscjam.preparation.certify.elastic_tensor`
SAME = 1e-3  # of the mean overlap: largest distance of disks in the same minimum


@dataclass(frozen=True, eq=False)
class ShearPath(Judged):
    """States of a packing under athermal quasi-static shear, and events between them. Units: stress k or ke/d².

    States are kept at multiples of the step and on both sides of every event, which are at most 1e-10 of strain apart.
    ``negative_modes`` and ``zero_modes`` are those of the first state.

    Attributes
    ----------
    gamma : (S,)
        Strain γ, measured in the cell of the packing.
    stress, pressure : (S,)
        Shear stress σ_xy = dU/dγ/V, and pressure.
    contacts, Z : (S,)
        Number of contacts of the backbone, and contacts of a disk of it.
    modulus : (S,)
        Tangent modulus dσ_xy/dγ, with pre-stress.
    eigenvalue : (S,)
        Lowest eigenvalue of K; NaN if unknown.
    net_force : (S,)
        Largest net force on a disk, p·d.
    proved : (S,) bool
        Whether the certificate proves a minimum.
    events : (F,)
        The state before each event; the next one is that after it.
    reversible : (F,) bool
        Whether the state before is restored when the strain goes back. If not, the event is an instability.
    contact_changes : (C, 4)
        Event, disks i and j, and 1 for a contact that is made, −1 for one that is lost.
    geometry : Packing
        The last state, with which the path can be continued.
    """

    gamma: Array = field(metadata=stored("1", "S", finite=True))
    stress: Array = field(metadata=stored("stress", "S", finite=True))
    pressure: Array = field(metadata=stored("stress", "S", finite=True))
    contacts: Integers = field(metadata=stored("1", "S"))
    Z: Array = field(metadata=stored("1", "S", finite=True))
    modulus: Array = field(metadata=stored("stress", "S", finite=True))
    eigenvalue: Array = field(metadata=stored("stiffness", "S"))
    net_force: Array = field(metadata=stored("pressure*diameter", "S", finite=True))
    proved: NDArray[np.bool_] = field(metadata=stored(axes="S"))
    events: Integers = field(metadata=stored(axes="F"))
    reversible: NDArray[np.bool_] = field(metadata=stored(axes="F"))
    contact_changes: Integers = field(metadata=stored(axes="C 4"))
    geometry: Packing
    units: ClassVar[str] = "moduli and stresses in k; changes: of contacts, made + lost, at reversible events"
    figure: ClassVar[str] = "petscjam.plots.aqs:path_figure"
    exports: ClassVar[str] = "petscjam.io.paths:export_path"

    @property
    def G0(self) -> float:
        """Tangent modulus of the first state."""
        return float(self.modulus[0])

    @property
    def drop(self) -> Array:
        """Stress drop at each event: decrease of σ_xy, or its increase if the strain decreases, (F,)."""
        return (self.stress[self.events] - self.stress[self.events + 1]) * self.sign

    @property
    def sign(self) -> float:
        """1 if the strain increases, −1 if it decreases."""
        return float(np.sign(self.gamma[-1] - self.gamma[0])) or 1.0

    @property
    def secant(self) -> Array:
        """[σ(γ) − σ(0)]/γ, (S,), from γ ≠ 0 on; the tangent modulus at γ = 0."""
        moved = self.gamma != 0
        change = np.where(moved, self.gamma, 1.0)
        return np.where(moved, (self.stress - self.stress[0]) / change, self.modulus[0])

    def onset(self, part: float) -> float:
        """Return |γ†|, the strain at which the secant modulus first departs from G0 by ``part`` of it; NaN if nowhere.

        Between two states the departure is interpolated linearly.

        Parameters
        ----------
        part : float
        """
        away = np.abs(self.secant / self.G0 - 1) - part
        beyond = np.flatnonzero(away > 0)
        if not len(beyond):
            return np.nan
        k = int(beyond[0])
        return float(np.abs(np.interp(0.0, away[k - 1 : k + 1], self.gamma[k - 1 : k + 1])))

    def count(self, change: int) -> Integers:
        """Return the number of contacts that are made (``change`` = 1) or lost (−1) at each event, (F,)."""
        which = self.contact_changes[self.contact_changes[:, 3] == change, 0]
        return np.bincount(which, minlength=len(self.events))

    def kind(self, event: int) -> str:
        """Return ``made``, ``lost`` or ``made and lost``, or ``instability``, for an event."""
        if not self.reversible[event]:
            return "instability"
        there = [name for name, change in (("made", 1), ("lost", -1)) if self.count(change)[event]]
        return " and ".join(there)

    def row(self) -> dict[str, float | str]:
        """Return its line of the table."""
        kept = self.reversible
        unstable = self.drop[~kept]
        return {
            "strain": float(self.gamma[-1]),
            "first event": float(self.gamma[self.events[0]]) if len(self.events) else "—",
            "changes": f"{self.count(1)[kept].sum()} + {self.count(-1)[kept].sum()}",
            "instabilities": f"{len(unstable)}",
            "largest drop": float(unstable.max()) if len(unstable) else "—",
            "largest stress": float(np.abs(self.stress).max()),
            "G0": self.G0,
            "proved": f"{self.proved.sum()} of {len(self.proved)}",
            "state": self.state,
        }


@dataclass(frozen=True, eq=False)
class State:
    """A minimum of the energy at the strain ``sign``·``way``; or, if not ``jammed``, a packing without one."""

    packing: Packing
    way: float
    sign: float
    jammed: bool = True

    @property
    def strain(self) -> float:
        """γ."""
        return self.sign * self.way

    @cached_property
    def network(self) -> ContactNetwork:
        """Contacts of the backbone."""
        return ContactNetwork.of(self.packing).without_rattlers()

    @cached_property
    def contacts(self) -> dict[tuple[int, int], int]:
        """Number of contacts of each pair of disks of the backbone: more than one through several images."""
        if not self.jammed:
            return {}
        found = np.stack([self.network.i, self.network.j], axis=1)
        pair, number = np.unique(found, axis=0, return_counts=True)
        return {(int(i), int(j)): int(n) for (i, j), n in zip(pair, number, strict=True)}

    @cached_property
    def tangent(self) -> tuple[float, Array]:
        """dσ_xy/dγ, and the non-affine du/dγ of all disks, (N, 2): zero mean on the backbone, 0 for rattlers."""
        C, u = elastic_tensor(self.network)
        motion = np.zeros((len(self.packing), 2))
        motion[self.network.backbone] = u[..., XY] - u[..., XY].mean(0)
        return float(C[XY, XY]), motion

    def moved(self, start: Packing, way: float) -> Packing:
        """Return the packing at ``way`` by the tangent response.

        Parameters
        ----------
        start : Packing
            It has the cell at γ = 0.
        way : float
        """
        change = self.sign * (way - self.way)
        x = self.packing.positions + change * self.tangent[1]
        x[:, 0] += change * self.packing.positions[:, 1]
        F = np.array([[1.0, self.sign * way], [0.0, 1.0]])
        return replace(self.packing, positions=x, box=start.box.deformed(F))

    def gaps(self, i: Integers, j: Integers, r: Array) -> tuple[Array, Array]:
        """Return gaps r − ρi − ρj of pairs, and their derivatives along the path by the tangent response, (C,) each.

        Parameters
        ----------
        i, j : (C,) integers
        r : (C, 2)
            From i to an image of j.
        """
        distance, u = np.hypot(r[:, 0], r[:, 1]), self.tangent[1]
        rate = u[j] - u[i]
        rate[:, 0] += r[:, 1]
        return distance - self.packing.radii[i] - self.packing.radii[j], self.sign * (rate * r).sum(1) / distance

    @cached_property
    def predicted(self) -> float:
        """The way at which the first contact of the backbone opens or closes by the tangent response."""
        i, j, r = pairs(self.packing.box, self.packing.positions, self.packing.radii, 0.3 * self.packing.mean_diameter)
        inside = self.network.backbone[i] & self.network.backbone[j]
        gap, rate = self.gaps(i[inside], j[inside], r[inside])
        with np.errstate(divide="ignore", invalid="ignore"):
            left = np.where(gap * rate < 0, -gap / rate, np.inf)
        return self.way + float(left.min(initial=np.inf))

    def crossings(self, changed: list[tuple[int, int]]) -> Array:
        """Return the ways, before or after this state, at which pairs touch by the tangent response."""
        i, j = np.array(changed).T
        x = self.packing.positions
        gap, rate = self.gaps(i, j, self.packing.box.minimum_image(x[j] - x[i]))
        return self.way - gap[rate != 0] / rate[rate != 0]


def changes(a: State, b: State) -> dict[tuple[int, int], int]:
    """Return the pairs that have more (positive) or fewer contacts in ``b`` than in ``a``.

    Parameters
    ----------
    a, b : State
    """
    change = {pair: b.contacts.get(pair, 0) - a.contacts.get(pair, 0) for pair in {**a.contacts, **b.contacts}}
    return {pair: n for pair, n in sorted(change.items()) if n}


def _minimum(packing: Packing) -> Packing:
    """Return an equilibrium, or the minimum below it if it is a saddle point."""
    with suppress(SolverError):  # the modes cannot be counted
        if negative_modes(packing) == 0:
            return packing
    return relax_packing(packing)


@dataclass(frozen=True)
class _Path:
    """The path of a packing: ``start`` has the cell at γ = 0."""

    start: Packing

    def state(self, before: State, way: float) -> State:
        """Return the state at ``way`` that follows ``before``."""
        after = replace(before, packing=before.moved(self.start, way), way=way)
        with suppress(InputError):  # no contact has a force, or the backbone is in pieces
            found = replace(after, packing=_minimum(equilibrium(after.packing)))
            if len(found.network) > 0:
                return found
        return replace(after, jammed=False)

    def located(self, a: State, b: State) -> tuple[State, State]:
        """Bracket the first change of the contacts between ``a`` and ``b`` to the resolution.

        The tangent response of ``a`` predicts its strain, or that of ``b`` if a rattler is caught. Trials are
        alternately just before and just after; after two that have not halved the bracket, in its middle.
        """
        vain, side = 0, -1.0
        while (width := b.way - a.way) > RESOLUTION:
            changed = list(changes(a, b))
            caught = not a.network.backbone[np.array(changed)].all()
            at = (b if caught else a).crossings(changed)
            way = at[(at > a.way) & (at < b.way)].min(initial=np.inf) + 0.4 * side * RESOLUTION
            if vain > 1 or not a.way < way < b.way:
                way = a.way + width / 2
            c = self.state(a, way)
            if changes(a, c):
                b, side = c, -1.0
            else:
                a, side = c, 1.0
            vain = 0 if b.way - a.way < width / 2 else vain + 1
        return a, b

    def returns(self, a: State, b: State) -> bool:
        """Whether the strain back from ``b`` to ``a`` restores the positions of ``a``."""
        back = self.state(b, a.way)
        if changes(a, back):
            return False
        moved = a.packing.box.minimum_image(back.packing.positions - a.packing.positions)[a.network.backbone]
        network = a.network
        overlap = (network.radii[network.i] + network.radii[network.j] - network.distance).mean()
        return bool(np.abs(moved - moved.mean(0)).max() < SAME * overlap)

    def follow(self, first: State, goals: Array) -> Iterator[tuple[State, bool | None]]:
        """Yield each state that is kept; after an event also whether that is reversible."""
        yield first, None
        now = first
        for goal in goals.tolist():
            while now.way < goal:
                way = min(goal, now.way + max(BEYOND * (now.predicted - now.way), RESOLUTION))
                after = self.state(now, way)
                if changes(now, after):
                    now, after = self.located(now, after)
                    after = self.state(now, after.way)  # it may come from a state far before
                    if changes(now, after):
                        yield now, None
                        if not after.jammed:
                            raise InputError("the packing unjams")
                        yield after, self.returns(now, after)
                elif way == goal:
                    yield after, None
                now = after


@reporting
@deferred()
def aqs(
    packing: Packing,
    strain: float = 1e-2,
    step: float | None = None,
    events: int | None = None,
    *,
    locate: bool = True,
    prestress: bool = True,
    comm: Comm | None = None,
    name: str = "packing",
    progress: Progress | None = None,
) -> ShearPath:
    """Shear ``packing`` quasi-statically at constant area, F = 1 + γ e_x e_yᵀ, and locate every change of its contacts.

    A packing that is not in balance is relaxed first, in its cell. The path ends before ``strain`` if the packing
    unjams; a note says so.

    Parameters
    ----------
    packing : Packing
    strain : float
        The last γ, of either sign.
    step : float, optional
        Strain between states that are kept without an event. Default: a fiftieth of ``strain``.
    events : int, optional
        Number of events after which the path ends. Default: no limit.
    locate : bool
        False: only states at multiples of the step, each from the one before, without events; many times faster.
    prestress : bool
        Must be True: a minimum of the energy has no other tangent response.
    comm, name, progress
        As for :func:`petscjam.spectrum`. One rank does the work.

    Raises
    ------
    InputError
        If strain, step or events is out of range, or the packing is not jammed.
    SolverError
        If the forces of the packing cannot be balanced.
    """
    comm = resolve(comm)
    agree(comm, packing, strain, step, events, locate, prestress)
    for what, value in (("strain", strain), ("step", step)):
        size = abs(value) if isinstance(value, Real) else value
        if value is not None and size not in ranges.QUASISTATIC:
            raise InputError(f"aqs: the size of the {what} must be {ranges.QUASISTATIC}, not {shown(value)}")
    if events is not None:
        ranges.EVENTS.check("aqs: the number of events", events)
        if not locate:
            raise InputError("aqs: a path without located events has no number of events after which it ends")
    if not prestress:
        raise InputError("aqs: a path of minima of the energy needs pre-stress")
    length = abs(strain)
    count = 50.0 if step is None else max(1.0, length / abs(step))
    if count > ranges.MOST_ROWS:
        raise InputError(f"aqs: a strain of {shown(strain)} in steps of {shown(step)} has more than 1e6 states")
    goals = np.append(np.arange(1, np.ceil(count * (1 - 1e-12))) * (length / count), length)
    problem = LinearProblem.elastic(packing, True, comm)
    origin = describe(problem, name)
    notes = list(problem.notes)
    if problem.balanced and packing.certificate.proved is not True:
        notes.append("the packing has no certificate of a minimum")

    def work() -> dict[str, Any]:
        start = replace(packing, provenance={})
        if not problem.balanced:
            start = relax_packing(start)
            notes.append("the path starts from the relaxed packing")
        return _followed(start, float(np.sign(strain)), goals, events, locate, notes, progress)

    made = on_root(comm, work)
    return ShearPath(origin, **made)


def states_at(packing: Packing, strains: Iterable[float]) -> Iterator[State]:
    """Yield ``packing`` and the minima of the energy at the strains, each from the one before; events are not located.

    Parameters
    ----------
    packing : Packing
        In balance, at zero strain.
    strains : iterable of float
        γ, as in :func:`aqs`.

    Raises
    ------
    InputError
        If the packing unjams.
    SolverError
        If forces cannot be balanced.
    """
    path, now = _Path(packing), State(packing, 0.0, 1.0)
    yield now
    for gamma in strains:
        now = path.state(now, gamma)
        if not now.jammed:
            raise InputError(f"the packing unjams at strain {gamma:.6g}")
        yield now


class _Row(NamedTuple):
    """Numbers of a state that is kept, in the units of :class:`ShearPath`."""

    gamma: float
    stress: float
    pressure: float
    contacts: int
    Z: float
    modulus: float
    eigenvalue: float
    net_force: float
    proved: bool

    @classmethod
    def of(cls, state: State, certificate: Certificate) -> _Row:
        lowest, network = certificate.lowest_eigenvalue, state.network
        return cls(
            gamma=state.strain,
            stress=-float(network.stress[0, 1]),
            pressure=network.pressure,
            contacts=len(network),
            Z=network.Z,
            modulus=state.tangent[0],
            eigenvalue=np.nan if lowest is None else lowest,
            net_force=float(certificate.max_force or 0.0),
            proved=certificate.proved is True,
        )


def _followed(
    start: Packing, sign: float, goals: Array, most: int | None, locate: bool, notes: list[str], progress: Report | None
) -> dict[str, Any]:
    """Follow the path on one rank; return the fields of the result."""
    path, first = _Path(start), certify(start)
    last = State(first, 0.0, sign)
    rows: list[_Row] = []
    events: list[int] = []
    reversible: list[bool] = []
    altered: list[tuple[int, int, int, int]] = []
    states = path.follow(last, goals) if locate else ((state, None) for state in states_at(first, sign * goals))
    try:
        for state, restored in states:
            packing = certify(state.packing)
            row = _Row.of(state, packing.certificate)
            if restored is not None:
                new = changes(last, state).items()
                altered += [(len(events), i, j, int(np.sign(n))) for (i, j), n in new]
                events.append(len(rows) - 1)
                reversible.append(restored)
            rows.append(row)
            last = replace(state, packing=packing)
            if progress:
                share = len(events) / most if most else abs(state.way) / goals[-1]
                progress(share, f"strain {state.strain:.4g}, {len(events)} events")
            if most and len(events) == most:
                break
    except (InputError, SolverError) as error:
        if not rows:
            raise
        notes.append(f"the path ends at strain {rows[-1].gamma:.6g}: {error}")
    columns = (np.array(column) for column in zip(*rows, strict=True))
    return {
        **dict(zip(_Row._fields, columns, strict=True)),
        "negative_modes": first.certificate.negative_modes,
        "zero_modes": first.certificate.zero_modes,
        "events": np.array(events, dtype=np.int64),
        "reversible": np.array(reversible, dtype=bool),
        "contact_changes": np.array(altered, dtype=np.int64).reshape(-1, 4),
        "geometry": last.packing,
        "notes": tuple(notes),
    }


def _options(parser: Any) -> None:
    text = "last strain, of either sign (default 1e-2)"
    parser.add_argument("--strain", type=number, default=1e-2, metavar="X", help=text)
    text = "strain between states that are kept without an event (default: a fiftieth of the strain)"
    parser.add_argument("--step", type=Within(number, ranges.QUASISTATIC), metavar="X", help=text)
    text = "number of events after which the path ends (default: no limit)"
    parser.add_argument("--events", type=Within(integer, ranges.EVENTS), metavar="K", help=text)
    text = "states at multiples of the step alone: no event is located (many times faster)"
    parser.add_argument("--no-location", dest="locate", action="store_false", help=text)


VERB = Verb(aqs, "states and events of the path of each packing", _options, stressed=True)
