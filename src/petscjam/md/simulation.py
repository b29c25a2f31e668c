"""The engine for the CPU: disks, list of pairs, and sums of observables.

Axes: i disk, x Cartesian, k step.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.base.errors import InputError, SolverError, shown
from petscjam.base.types import Array
from petscjam.geometry.neighbours import CHUNK
from petscjam.md import kernels
from petscjam.md.engine import BINS, DXY, DYX, HEAT, JUMPS, KXX, SAMPLED, SUMS, TICKS, TOUCHING, WORK, Totals
from petscjam.md.kernels import Disks, Law, Measured, Moment, Scheme
from petscjam.md.model import BULK, Model, stable_step
from petscjam.md.neighbours import list_pairs, mark, open_contacts, order_in_space, wrap
from petscjam.md.state import State

SKIN = 0.03  # ds, the first list
SKINS = 0.005, 0.5  # smallest and largest skin of later lists
BALANCE = {"heun": 1.3, "single": 2.6}  # cost of a build divided by the cost of the pairs in a skin of 1 ds, per step


class Simulation:
    """Disks under shear, advanced step by step: an :class:`petscjam.md.engine.Engine`.

    A step is divided into a power of 2 of parts if the contacts require it (:meth:`demand`); the number is
    computed with each list of pairs. ``parts`` is its current value, ``substeps`` the total number of parts so
    far, ``most`` the largest number since the last :meth:`collect`.

    Parameters
    ----------
    state : State
    model : Model
    dt : float
        Time step in τe, before it is divided; default: :meth:`petscjam.md.model.Model.step`.
    integrator : str
        ``heun`` (VOT eqs. 21–24) or ``single`` (one evaluation of the forces a step).
    threads : int
    masses : (N,)
        In m; default: that of the model.

    Raises
    ------
    InputError
        If dt is not stable for two disks, or the cell is too small for its disks.
    SolverError
        If the contacts require steps below a thousandth of dt.
    """

    CHECKPOINT: ClassVar[Mapping[str, str]] = {
        "q": "N 5",
        "radii": "N",
        "masses": "N",
        "angles": "N",
        "tag": "N",
        "contacts": "C 3",
        "numbers": "5",
        "height": "1",
        "counts": "2",
        "start": "T",
    }

    def __init__(
        self,
        state: State,
        model: Model,
        dt: float | None = None,
        integrator: str = "heun",
        threads: int = 1,
        masses: ArrayLike | None = None,
    ) -> None:
        self.model, self.integrator, self.threads = model, integrator, threads
        self.dt = model.step(dt, integrator)
        self.length, self.height = state.length, state.height
        self.strain, self.rate, self.time = state.strain, state.rate, state.time
        n = len(state)
        self.tag = np.arange(n)
        q = np.column_stack([state.positions, state.velocities, state.spins * state.radii])
        m = masses_of(n, model, masses)
        angle = np.empty(0) if state.angles is None else state.angles.copy()
        self._disks = Disks(q, q.copy(), np.zeros((n, 3)), state.radii.copy(), m, q[:, :2].copy(), angle)
        exponent = None if model.potential.exponent == 2 else model.potential.exponent
        absolute = None if model.potential.relative else 1.0
        self._law = Law(
            model.normal,
            model.tangential,
            model.film,
            float(model.rolls),
            exponent,
            absolute,
            float(model.body),
            float(model.rotational_drag),
            *model.potential.compiled,
        )
        self._exponent = model.potential.exponent or 1.0
        self._threads = True if threads > 1 else None  # None: the kernel of one thread alone is compiled
        self.skin = SKIN
        self.steps = self.rebuilds = self.substeps = 0
        self._since = 0  # substep of the last build
        self._widest = widest_skin(state)
        rows = (n - 1) // CHUNK + 2
        counts, angles = np.zeros((rows, 3), np.int64), np.zeros((rows, 2, BINS), np.int64)
        self._measured = Measured(np.zeros((rows, SUMS)), counts, angles, np.zeros(SUMS))
        self._build(np.empty((0, 3), np.int64))
        self._divided, self.most = self.parts, 1
        self._start = self.now
        self._forget_events()  # contacts of the initial state do not count as made

    def __len__(self) -> int:
        return len(self.tag)

    def _build(self, contacts: NDArray[np.int64]) -> None:
        """Sort the disks and list their pairs, ``contacts`` among them (:func:`open_contacts`)."""
        d = self._disks
        self.skin = min(max(self.skin, SKINS[0]), SKINS[1], self._widest)
        wrap(d.q, self.length, self.height, self.strain, self.rate)
        order = order_in_space(d.q, self.length, self.height)
        self.tag = self.tag[order]
        q = d.q[order]
        self._disks = d = Disks(q, d.p, d.F, d.R[order], d.m[order], q[:, :2].copy(), d.angle[order[: len(d.angle)]])
        self._pairs = list_pairs(d.home, d.R, self.length, self.height, self.strain, self.skin)
        self._since = self.substeps
        self.rebuilds += 1
        if mark(self._pairs, self.tag, contacts):
            raise SolverError(f"shear: a contact was lost at a strain of {self.strain:.6g}; take a smaller dt")
        self.parts = self.demand()

    def fastest(self) -> tuple[float, float]:
        """Return bounds on the largest eigenvalues of M⁻¹B, 1/τe, and M⁻¹K, 1/τe², for the current contacts."""
        return kernels.fastest(self._disks, self._pairs, self._law, self._exponent, self.strain)

    def demand(self) -> int:
        """Return the number of parts of a step that is needed for stability with the current contacts."""
        largest, parts = stable_step(self.integrator, *self.fastest()), 1
        while self.dt > parts * largest:
            parts *= 2
        if parts > TICKS:
            raise SolverError(
                f"shear: at a strain of {self.strain:.6g} the contacts require steps below {largest:.3g} "
                "tau_e; take a smaller dt"
            )
        return parts

    def rebuild(self) -> None:
        """Build the list of pairs, with a skin from the displacements since the last build.

        A wider skin costs more pairs at each step, a narrower one more builds; the sum is smallest if a skin s
        lasts for a time proportional to s².
        """
        d, shear = self._disks, self.strain - self._pairs.strain
        if self.substeps > self._since:
            away = d.q[:, :2] - d.home
            away[:, 0] -= shear * d.q[:, 1]
            used = 2 * np.sqrt((away**2).sum(1).max()) + abs(shear) * d.R.max()
            pace = used / (self.substeps - self._since)
            self.skin = float(np.sqrt(BALANCE[self.integrator] * pace))
        self._build(open_contacts(self._pairs, self.tag))

    def advance(self, strains: Array, rates: Array, bulk: str = "scale") -> None:
        """Make K steps.

        Parameters
        ----------
        strains : (K,)
            γ at the end of each step.
        rates : (K,)
            γ̇ in each step. ``bulk`` selects the effect of a change: ``scale`` velocities and spins with the rate
            (VOT eqs. 40, 41), add the change of the linear ``profile``, or move only the ``boundary``.

        Raises
        ------
        SolverError
            If the disks fly apart.
        """
        strains = np.concatenate([[self.strain], strains])
        rates = np.concatenate([[self.rate], rates])
        if BULK[bulk] == 1 and (rates[:-1] == 0).any() and (rates[1:] != rates[:-1]).any():
            raise InputError("shear: velocities cannot be scaled from a strain rate of 0; choose another bulk")
        done = 0
        while done < len(rates) - 1:
            done += self._advance(strains[done:], np.append(self.rate, rates[done + 1 :]), bulk)
        fluid, total = self.model.fluid * self.length * self.height, self._measured.total
        total[[DXY, DYX]] -= fluid * rates[1:].sum()
        total[[HEAT, WORK]] += fluid * (rates[1:] ** 2).sum()
        self._check()

    def _advance(self, strains: Array, rates: Array, bulk: str) -> int:
        """Make steps until another number of parts is needed; return the number of complete steps."""
        parts = self._begin()
        single = True if self.integrator == "single" else None
        scheme = Scheme(single, self.dt / parts, parts, BULK[bulk], self._threads)
        fine = np.concatenate([rates[:1], np.repeat(rates[1:], parts)])
        at = np.interp(np.arange(len(fine)) / parts, np.arange(len(strains)), strains)
        made, tried = 0, False
        while made < len(fine) - 1 and (self.parts == parts or made % parts):
            end = len(fine) if self.parts == parts else made + parts - made % parts + 1
            tick = self.steps * TICKS + made % parts * (TICKS // parts)
            some = kernels.advance(
                self._disks, self._pairs, self._law, scheme, at[made:end], fine[made:end], tick, self._measured
            )
            self.steps += (made + some) // parts - made // parts
            made += some
            self.substeps += some
            self.time += some * scheme.dt
            self.strain, self.rate = float(at[made]), float(fine[made])
            if made < end - 1:
                self._widen() if some == 0 and tried else self.rebuild()
                tried = some == 0
        return made // parts

    def _begin(self) -> int:
        """Set the number of parts that is needed, and return it."""
        if self.parts != self._divided:
            self._measured.total[:], self._start = self._closed()
            self._divided = self.parts
        self.most = max(self.most, self.parts)
        return self.parts

    def _widen(self) -> None:
        """Build a new list with twice the skin."""
        self._check()
        if self.skin >= min(SKINS[1], self._widest):
            raise SolverError(
                f"shear: disks leave their neighbours within a step at a strain of {self.strain:.6g}; take a smaller dt"
            )
        self.skin *= 2
        self._build(open_contacts(self._pairs, self.tag))

    def _check(self) -> None:
        if not np.isfinite(self._disks.q).all():
            raise SolverError(
                f"shear: velocities grew without bound at a strain of {self.strain:.6g}; take a smaller dt"
            )

    @property
    def _moment(self) -> Moment:
        return Moment(self.strain, self.rate, self.steps * TICKS)

    @property
    def now(self) -> Array:
        """Sums of the current state; contacts that were made or broken in the last step are counted."""
        d, now, sums = self._disks, np.zeros(SUMS), self._measured.sums
        d.F[:] = 0.0
        kernels.forces(d.q, d, self._pairs, self._law, self._moment, self._threads, True, self._measured)
        sums[:, KXX:WORK] = 0.0
        kernels.kinetic(d.q, d.m, self.rate, sums)
        kernels.record(sums, self.rate, 1.0, now)
        sums[-1] = 0.0
        return now

    def _forget_events(self) -> None:
        self._measured.counts[:] = 0
        self._measured.angles[:] = 0

    def energy(self) -> tuple[float, float, float]:
        """Return the elastic, the peculiar kinetic and the rotational energy, in m ds²/τe²."""
        d = self._disks
        elastic = kernels.elastic_energy(d.q, self._pairs, self._law, self._exponent, self.strain)
        c = d.q[:, 2:4].copy()
        c[:, 0] -= self.rate * d.q[:, 1]
        return float(elastic), float(d.m @ (c**2).sum(1)) / 2, float(d.m @ d.q[:, 4] ** 2) / 4

    def collect(self) -> Totals:
        """Return the sums over the steps since the last call, and set them to zero."""
        sums, self._start = self._closed()
        totals = Totals(sums, self._measured.counts.sum(0), self._measured.angles.sum(0))
        self._forget_events()
        self._measured.total[:] = 0.0
        self.most = 1
        return totals

    def _closed(self) -> tuple[Array, Array]:
        """Return the sums by the trapezoidal rule, and the sums of the current state."""
        end = self.now
        half = 0.5 * (end - self._start) * (1 if self.integrator == "heun" else -1) / self._divided
        half[[TOUCHING, JUMPS]] = 0.0
        return self._measured.total + half, end

    def sample(self, layers: Array, moments: Array, scatter: Array) -> Array:
        """Add observables of the current state (:meth:`petscjam.md.engine.Engine.sample`).

        Parameters
        ----------
        layers, moments, scatter : arrays
            As there; overwritten.

        Returns
        -------
        (SAMPLED,)
            Sums.
        """
        sums = np.zeros(SAMPLED)
        d = self._disks
        kernels.sample_disks(d.q, d.R, d.m, self.height, self.rate, layers, sums)
        kernels.sample_contacts(d.q, self._pairs, self._law, self._moment, layers, moments, scatter, sums)
        return sums

    @property
    def state(self) -> State:
        """The current state, disks in the order of the start."""
        d, place = self._disks, np.argsort(self.tag)
        q, R, angles = d.q[place], d.R[place], d.angle[place] if len(d.angle) else None
        cell, name = (self.length, self.strain, self.rate, self.time), self.model.potential.name
        return State(q[:, :2], q[:, 2:4], q[:, 4] / R, R, *cell, name, self.height, angles)

    def checkpoint(self) -> dict[str, Any]:
        """Build a new list; return everything that :meth:`restored` needs to continue bit for bit.

        Call :meth:`collect` before: it records the contacts that the last step made and broke.
        """
        self.rebuild()
        self._divided = self.parts
        d, contacts = self._disks, open_contacts(self._pairs, self.tag)
        angles = {"angles": d.angle} if len(d.angle) else {}
        return saved_engine(self, q=d.q, radii=d.R, masses=d.m, contacts=contacts, start=self._start, **angles)

    @classmethod
    def restored(
        cls, saved: Mapping[str, Any], model: Model, dt: float, integrator: str, threads: int = 1
    ) -> Simulation:
        """Return the simulation of a :meth:`checkpoint`.

        Parameters
        ----------
        saved : mapping of str to arrays
        model : Model
        dt : float
            τe.
        integrator : str
        threads : int

        Raises
        ------
        InputError
            If its contacts are not those of its disks.
        """
        q, radii, state = saved["q"], saved["radii"], saved_state(saved, model)
        new = cls(state, model, dt, integrator, threads, saved["masses"])
        others = (saved["masses"], q[:, :2].copy(), np.array(saved.get("angles", ())))
        new._disks = Disks(q.copy(), q.copy(), np.zeros((len(q), 3)), radii, *others)
        new.tag, new.skin = saved["tag"].copy(), float(saved["numbers"][-1])
        new.steps, new.rebuilds = (int(x) for x in saved["counts"])
        new.rebuilds -= 1
        new._build(saved["contacts"])
        new._divided = new.parts
        new._start = saved["start"].copy()
        return new


def masses_of(n: int, model: Model, masses: ArrayLike | None) -> Array:
    """Return the masses of ``n`` disks, checked.

    Parameters
    ----------
    n : int
    model : Model
    masses : (N,)
        In m; default: that of the model.
    """
    m = np.full(n, model.mass) if masses is None else np.array(masses, dtype=float)
    if m.shape != (n,) or not (m > 0).all():
        raise InputError(f"shear: masses must be {n} numbers above 0, not {shown(masses)}")
    return m


def widest_skin(state: State) -> float:
    """Return the widest skin: no disk may touch two images of another disk, or its own.

    A contact is identified by its disks.

    Raises
    ------
    InputError
        If the cell is too small for its disks.
    """
    widest = min(state.length, state.height) / 2 - float(np.sort(state.radii)[-2:].sum())
    if widest < SKINS[0]:
        cell = f"{state.length:.3g} x {state.height:.3g}"
        raise InputError(f"shear: a cell of {cell} is too small for disks of these sizes")
    return widest


def saved_engine(engine: Any, **arrays: NDArray[Any]) -> dict[str, Any]:
    """Return the checkpoint of an engine, with copies of its arrays.

    Parameters
    ----------
    engine : Simulation or CudaSimulation
    **arrays
        What each engine keeps in its own way: q, radii, masses, contacts, start, and angles if they are kept.
    """
    own = {
        "tag": engine.tag,
        "numbers": [engine.length, engine.strain, engine.rate, engine.time, engine.skin],
        "height": [engine.height],
        "counts": [engine.steps, engine.rebuilds],
    }
    return {name: np.array(values) for name, values in (own | arrays).items()}


def saved_state(saved: Mapping[str, Any], model: Model) -> State:
    """Return the state of a checkpoint, in its order.

    Parameters
    ----------
    saved : mapping of str to arrays
    model : Model

    Raises
    ------
    InputError
        If its contacts are not those of its disks.
    """
    q, radii, tags = saved["q"], saved["radii"], np.arange(len(saved["tag"]))
    if not (np.array_equal(np.sort(saved["tag"]), tags) and np.isin(saved["contacts"][:, :2], tags).all()):
        raise InputError("checkpoint: tag or contacts contain disks that do not exist")
    length, strain, rate, time, _ = (float(x) for x in saved["numbers"])
    cell = (length, strain, rate, time, model.potential.name, float(saved["height"][0]))
    return State(q[:, :2], q[:, 2:4], q[:, 4] / radii, radii, *cell, saved.get("angles"))
