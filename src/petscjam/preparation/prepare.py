"""Prepare packings: random disks, minimised at a target pressure (BT sec. 2.1) and certified.

Axes: i disk, x Cartesian.
"""

from __future__ import annotations

from dataclasses import replace
from math import log
from numbers import Real
from typing import Any

import numpy as np

from petscjam.base import ranges
from petscjam.base.errors import InputError, SolverError, shown
from petscjam.base.interrupt import deferred
from petscjam.base.progress import Progress, Report, reporting
from petscjam.base.types import Array
from petscjam.base.versions import release
from petscjam.geometry.box import Box
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.packing import Packing
from petscjam.geometry.potential import POTENTIALS
from petscjam.parallel.memory import require
from petscjam.preparation.certify import Instability, judge
from petscjam.preparation.minimise import METHODS, Enthalpy
from petscjam.preparation.newton import descend, first_closeness, near, newton
from petscjam.preparation.records import Goal

GAP = 1e-8  # between a rattler and its neighbours, relative to the sum of their radii
PUSHES = 1000
BYTES_PER_DISK = 3000  # disks, pairs, and the factor of the certificate
BUDGET = 2_000_000
ESCAPES = 20  # largest number of times that a negative mode is followed
ADJUSTMENTS = 10  # of the cell, at the end
ROUNDING = 4.0  # forces in another cell than a packing's own, in units of those in its own
HISTORY = 200  # stored points of the history of a preparation
DIGITS = 1e6  # smallest ratio of forces to rounding errors


@reporting
@deferred()
def prepare_packing(
    n: int = 1024,
    pressure: float = 1e-3,
    seed: int = 1,
    *,
    shear_stabilised: bool = False,
    method: str = "fire",
    potential_name: str = "harmonic",
    ratio: float = 1.4,
    composition: float = 0.5,
    polydispersity: float = 0.0,
    threads: int = 1,
    budget: int = BUDGET,
    progress: Progress | None = None,
) -> Packing:
    """Return a packing of ``n`` disks in mechanical equilibrium at ``pressure``, with its certificate.

    Positions are uniformly random in a square cell, ``default_rng(seed).random((n, 2))`` in units of the
    cell, small disks first; the mean diameter is d = 1. The energy is minimised at constant volume, near the
    density at which quenches have the target pressure; then :func:`relax_packing` continues. The same arguments
    give the same packing, for any number of ``threads``.

    Parameters
    ----------
    n : int
        At least 8.
    pressure : float
        Target, in units of k (the spring constant of two disks whose radii add up to d).
    seed : int
    shear_stabilised : bool
        Whether the shape of the cell relaxes, too: the packing has no shear stress and is stable against shear in
        every direction (Dagois-Bohy et al., Phys. Rev. Lett. 109, 095703).
    method : "fire" or "cg"
    potential_name : str
        A name from :data:`petscjam.geometry.potential.POTENTIALS`.
    ratio : float
        Diameter of the large disks divided by that of the small ones.
    composition : float
        Number fraction of small disks, in [0, 1]; rounded up to whole disks.
    polydispersity : float
        Standard deviation over mean of the diameters of each kind (normal distribution, cut at three standard
        deviations).
    threads : int
        Useful from about ten thousand disks on.
    budget : int
        Evaluations of the force.
    progress : callable, optional
        Called regularly with the completed fraction, in [0, 1], and a line of text.

    Raises
    ------
    InputError
        On an argument out of range.
    SolverError
        If forces and pressure do not reach their tolerances within the budget. (A packing that reaches them, but
        is not proved a minimum within the budget, is returned with ``certificate.proved = False``.)
    """
    check(
        n,
        pressure,
        seed,
        method=method,
        potential_name=potential_name,
        ratio=ratio,
        composition=composition,
        polydispersity=polydispersity,
        budget=budget,
    )
    random = np.random.default_rng(seed)
    x = random.random((n, 2))
    radii = _radii(n, ratio, composition, polydispersity, random)
    phi = 0.842 + 2.5 * POTENTIALS[potential_name].overlap(pressure)
    box = Box.filled(radii, phi)
    made_by = {
        "program": "petscjam",
        "version": release("petscjam"),
        "numpy": release("numpy"),
        "numba": release("numba"),
        "n": int(n),
        "seed": int(seed),
        "ratio": float(ratio),
        "composition": float(composition),
        "polydispersity": float(polydispersity),
    }
    start = Packing(x @ box.cell, radii, box, potential_name, provenance=made_by)
    record = _Record(budget, progress)
    energy = Enthalpy(start, threads=threads, budget=budget, report=record)
    # If the box relaxes before the disks have settled, it overshoots, and the return along soft modes is slow.
    z = METHODS[method](energy, energy.start, Goal(1e-2 * pressure, 1e-2, 0.0))
    record.close(energy)
    return _relaxed(energy.at(z), pressure, shear_stabilised, method, threads, record)


@reporting
@deferred()
def relax_packing(
    packing: Packing,
    pressure: float | None = None,
    *,
    shear_stabilised: bool = False,
    method: str = "fire",
    threads: int = 1,
    budget: int = BUDGET,
    progress: Progress | None = None,
) -> Packing:
    """Return the nearest minimum of ``packing``, with its certificate.

    FIRE or conjugate gradients minimise until Newton's method converges. Then the packing is certified
    (:func:`petscjam.certify`); if there is a negative mode, the disks are moved along it, and minimisation
    continues until the minimum is proved or the budget is used up. The minimisation ends when no net force
    exceeds max(1e-10·p·d, 4·ε·k·L) and the pressure (stabilised: the pressure tensor) is within max(1e-9·p,
    4·ε·k·L/d) of the target.

    Parameters
    ----------
    packing : Packing
        For a series of decreasing pressures, the packing of the previous pressure.
    pressure : float, optional
        At constant pressure the size of the cell relaxes, with ``shear_stabilised`` also its shape; default: the
        cell is fixed.
    shear_stabilised, method, threads, budget, progress
        As in :func:`prepare_packing`.

    Raises
    ------
    InputError
        As :func:`prepare_packing`, and if the disks are not jammed at their volume.
    SolverError
        As :func:`prepare_packing`.
    """
    unit = packing.potential.unit(packing.mean_diameter)
    check_relaxation(len(packing), pressure, shear_stabilised, method, budget, unit)
    record = _Record(budget, progress)
    if pressure is None:
        record.least = _least_pressure(packing)
    return _relaxed(packing, pressure, shear_stabilised, method, threads, record)


def equilibrium(packing: Packing) -> Packing:
    """Return the equilibrium next to ``packing``, in its cell, without a certificate: it may be a saddle point.

    Newton's method comes first, since FIRE can leave a small basin.

    Raises
    ------
    InputError, SolverError
        As :func:`relax_packing`.
    """
    record = _Record(BUDGET, None)
    record.least = _least_pressure(packing)
    h = Enthalpy(packing)
    packing = h.at(newton(h, h.start, _goal(h, h.start)))
    return _minimum(packing, None, False, "fire", 1, record, None)


def _least_pressure(packing: Packing) -> float:
    return DIGITS * ContactNetwork.of(packing).rounding_force / packing.mean_diameter


def _relaxed(
    packing: Packing, pressure: float | None, stabilised: bool, method: str, threads: int, record: _Record
) -> Packing:
    made_by = {**packing.provenance, "pressure": pressure, "shear_stabilised": stabilised, "method": method}
    packing = replace(packing, provenance=made_by)
    judged: Packing | None = None
    way_down: Instability | None = None
    for _ in range(ESCAPES):
        try:
            packing = _minimum(packing, pressure, stabilised, method, threads, record, way_down)
        except SolverError:
            if judged is None:
                raise
            break  # the budget is used up: the forces of the last one balance, but it is not proved
        judged, way_down = judge(packing, pressure)
        if way_down is None:
            break
        packing = judged
    assert judged is not None
    record.finish(judged)
    made_by.update(evaluations=record.spent, history=record.history)
    return replace(judged, provenance=made_by)


def _minimum(
    packing: Packing,
    pressure: float | None,
    stabilised: bool,
    method: str,
    threads: int,
    record: _Record,
    way_down: Instability | None,
) -> Packing:
    """Minimise from ``packing``, or from a point along a motion that decreases the energy."""

    def energy(packing: Packing, pressure: float | None) -> Enthalpy:
        return Enthalpy(
            packing,
            pressure,
            shape=stabilised,
            threads=threads,
            budget=record.budget,
            evaluations=record.spent,
            report=record,
        )

    def descended(h: Enthalpy, z: Array, slack: float, closeness: float) -> Packing:
        force, relative, error = _goal(h, z)
        z = descend(h, z, Goal(slack * force, relative, error), closeness, method)
        record.close(h)
        return h.at(z)

    h = energy(packing, pressure)
    z, closeness = h.start, first_closeness(len(packing))
    if way_down is not None:
        network = ContactNetwork.of(packing)
        overlap = (network.radii[network.i] + network.radii[network.j] - network.distance).mean()
        z = h.downhill(way_down.displacement, way_down.strain, 0.1 * float(overlap))
        closeness = min(closeness, 1e-2 * h.now.force / (h.pressure * h.diameter))
    z = METHODS[method](h, z, near(h, closeness))
    packing = _free_rattlers(descended(h, z, ROUNDING, closeness))
    # In a cell other than its own a packing has larger rounding errors. So the forces are relaxed again in the
    # final cell; this may change the pressure slightly, and then the cell has to be adjusted again.
    for _ in range(ADJUSTMENTS):
        h = energy(packing, pressure)
        h.gradient(h.start)
        if h.reached(_goal(h, h.start)):
            break
        if pressure is not None:
            packing = descended(h, h.start, ROUNDING, 0.0)
        h = energy(packing, None)
        packing = descended(h, h.start, 1.0, 0.0)
    return packing


def _goal(h: Enthalpy, z: Array) -> Goal:
    """Return goals below the documented tolerances, because forces computed from the file have other rounding errors.

    The floor is the force on a disk by rounding of positions in double precision.
    """
    floor = 0.8 * ContactNetwork.of(h.at(z)).rounding_force
    error = max(0.5e-9 * (h.target or 0.0), floor / h.diameter)
    return Goal(max(0.5e-10 * (h.target or 0.0) * h.diameter, floor), 0.5e-10 * h.diameter, error)


class _Record:
    """Budget, progress and history of a preparation that has several stages.

    Disks whose pressure decreases below ``least`` are not jammed: as contacts open, forces and pressure decrease
    together, and a goal in units of the pressure is never reached.
    """

    least = 0.0

    def __init__(self, budget: int, progress: Report | None) -> None:
        self.budget, self.progress = budget, progress
        self.spent = 0
        self.history: dict[str, list[float]] = {"evaluations": [], "phi": [], "pressure": [], "force": []}
        self._every = 1
        self._done = 0.0

    def __call__(self, h: Enthalpy, z: Array) -> None:
        self._note(h, z)
        if h.pressure < self.least:
            raise InputError(f"not jammed: the pressure falls to {h.pressure:.1e}, with all forces")
        unit = h.unit * h.diameter
        goal, force = 1e-10 * h.pressure * h.diameter / unit, h.now.force / unit
        if 0 < goal < 1 and force < 1:
            self._done = max(self._done, min(0.99, log(max(force, goal)) / log(goal)))
        self._say(f"largest force {h.now.force:.1e}, pressure {h.pressure:.4e}")

    def finish(self, packing: Packing) -> None:
        """Report the end of the preparation."""
        self._done = 1.0
        c = packing.certificate
        self._say(f"largest force {c.max_force:.1e} p·d, {'' if c.proved else 'not '}proved")

    def _say(self, text: str) -> None:
        if self.progress is not None:
            self.progress(self._done, text)

    def close(self, h: Enthalpy) -> None:
        """Add the evaluations of a stage."""
        self.spent = h.evaluations

    def _note(self, h: Enthalpy, z: Array) -> None:
        lists = self.history
        count = h.evaluations
        if lists["evaluations"] and count < lists["evaluations"][-1] + 200 * self._every:
            return
        area = h.packing.box.area * float(np.linalg.det(h.unpack(z)[1]))
        phi = float(np.pi * (h.radii**2).sum() / area)
        for name, value in (
            ("evaluations", count),
            ("phi", phi),
            ("pressure", h.pressure),
            ("force", float(h.now.force)),
        ):
            lists[name].append(value)
        if len(lists["phi"]) >= HISTORY:
            self._every *= 2
            for name in lists:
                lists[name] = lists[name][::2]


def _free_rattlers(packing: Packing) -> Packing:
    """Return the packing with rattlers moved away from their neighbours, if there is room.

    After a minimisation rattlers have overlaps of the order of rounding errors, which would determine whether
    they are in contact. So they are moved away by GAP.
    """
    from petscjam.geometry.neighbours import pairs

    rattler = ~ContactNetwork.of(packing).backbone
    x, radii = packing.positions.copy(), packing.radii
    i, j, r = pairs(packing.box, x, radii, 0.01 * packing.mean_diameter)
    loose = rattler[i] | rattler[j]
    i, j, r = i[loose], j[loose], r[loose]
    images = r - (x[j] - x[i])
    share = 1.0 / np.maximum(rattler[i].astype(int) + rattler[j], 1)
    for _ in range(PUSHES):
        r = x[j] - x[i] + images
        distance = np.hypot(r[:, 0], r[:, 1])
        overlap = np.maximum((1 + GAP) * (radii[i] + radii[j]) - distance, 0)
        if not overlap.any():
            break
        push = (share * overlap / distance)[:, None] * r
        np.add.at(x, j, push * rattler[j, None])
        np.add.at(x, i, -push * rattler[i, None])
    return replace(packing, positions=x)


def _radii(n: int, ratio: float, composition: float, polydispersity: float, random: np.random.Generator) -> Array:
    """Return radii, small disks first, of mean ½ for the nominal composition."""
    small = 0.5 / (composition + (1 - composition) * ratio)
    radii = np.where(np.arange(n) < np.ceil(composition * n - 1e-9), small, ratio * small)
    if polydispersity:
        spread = np.clip(random.standard_normal(n), -3, 3)
        radii *= 1 + polydispersity * spread
    return radii


def check(n: int, pressure: float, seed: int, **others: Any) -> None:
    """Raise the InputError that :func:`prepare_packing` would raise on these arguments.

    Parameters
    ----------
    n, pressure, seed
        As for :func:`prepare_packing`.
    **others
        Its keyword arguments; missing ones are not checked.
    """
    ranges.PREPARED.check("prepare: the number of disks", n)
    if not isinstance(pressure, Real):
        raise InputError(f"prepare: the pressure must be a number above 0, not {shown(pressure)}")
    ranges.SEED.check("prepare: the seed", seed)
    for name, known in (
        ("ratio", ranges.RATIO),
        ("composition", ranges.COMPOSITION),
        ("polydispersity", ranges.POLYDISPERSITY),
    ):
        known.check(f"prepare: the {name}", others.get(name, 0.1))
    require(BYTES_PER_DISK * n, f"prepare: {n} disks")
    kind = others.get("potential_name", "harmonic")
    if kind not in POTENTIALS:
        raise InputError(f"prepare: the potential {kind!r} is unknown; known are {', '.join(POTENTIALS)}")
    check_relaxation(
        n, pressure, others.get("shear_stabilised", False), others.get("method", "fire"), others.get("budget", BUDGET)
    )


def check_relaxation(
    n: int, pressure: float | None, stabilised: bool, method: str, budget: int, unit: float = 1.0
) -> None:
    """Raise the InputError that :func:`relax_packing` would raise on these arguments.

    Parameters
    ----------
    n : int
        Number of disks.
    pressure, stabilised, method, budget
        As for :func:`relax_packing`.
    unit : float
        Pressure k·d^(α − 2) of contacts whose overlap is d.
    """
    if pressure is None:
        if stabilised:
            raise InputError("prepare: a packing stabilised against shear needs a target pressure")
    elif not 0 < pressure < 0.5 * unit:
        raise InputError(f"prepare: the pressure must be above 0 and below {0.5 * unit:.3g}, not {shown(pressure)}")
    elif pressure < (lowest := 4e6 * float(np.finfo(float).eps) * n**0.5 * unit):
        raise InputError(
            f"prepare: at a pressure of {shown(pressure)} rounding errors exceed 1e-6 of the forces "
            f"between {n} disks; the lowest is {lowest:.1e}"
        )
    if method not in METHODS:
        raise InputError(f"prepare: the method {method!r} is unknown; known are {', '.join(METHODS)}")
    ranges.BUDGET.check("prepare: the budget of evaluations", budget)
