"""A simulation in progress: disks, their list of pairs, and the sums of what was measured.

Axes: i disk, x Cartesian, k step.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.base.errors import InputError, SolverError, shown
from petscjam.base.types import Array
from petscjam.geometry.neighbours import CHUNK
from petscjam.md import kernels
from petscjam.md.kernels import BINS, HEUN, SINGLE, SUMS, TICKS, Disks, Events, Law
from petscjam.md.model import BULK, Model, stable_step
from petscjam.md.neighbours import list_pairs, mark, open_contacts, order_in_space, wrap
from petscjam.md.state import State

SCHEMES = {"heun": HEUN, "single": SINGLE}
SKIN = 0.03  # ds, the first list
SKINS = 0.005, 0.5  # the least and the most of later ones
BALANCE = {"heun": 1.3, "single": 2.6}  # cost of a build over that of the pairs in a skin of 1 ds, per step


class Simulation:
    """Disks under shear, advanced step by step.

    A step is divided into parts, a power of 2, where the contacts demand it (:meth:`demand`): they are asked
    at each new list of pairs. ``parts`` is that number now, ``substeps`` how many were made, ``most`` the
    largest number since the last :meth:`collect`.

    Parameters
    ----------
    state : State
    model : Model
    dt : float
        Time step in τe, before it is divided; left out, as :meth:`petscjam.md.model.Model.step` says.
    integrator : str
        ``heun`` (VOT eqs. 21–24) or ``single`` (one evaluation of the forces a step).
    threads : int
    masses : (N,)
        In m; left out, all 1 (VOT).

    Raises
    ------
    InputError
        If dt is not stable for two disks, or the cell is too small for its disks.
    SolverError
        If the contacts demand steps below a thousandth of dt.
    """

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
        self.L, self.strain, self.rate, self.time = state.length, state.strain, state.rate, state.time
        n = len(state)
        self.tag = np.arange(n)
        q = np.column_stack([state.positions, state.velocities, state.spins * state.radii])
        m = np.ones(n) if masses is None else np.array(masses, dtype=float)
        if m.shape != (n,) or not (m > 0).all():
            raise InputError(f"shear: masses must be {n} numbers above 0, not {shown(masses)}")
        self._disks = Disks(q, q.copy(), np.zeros((n, 3)), state.radii.copy(), m, q[:, :2].copy())
        exponent = None if model.potential.exponent == 2 else model.potential.exponent
        absolute = None if model.potential.relative else 1.0
        self._law = Law(
            model.normal,
            model.tangential,
            float(model.rolls),
            exponent,
            absolute,
            float(model.body),
            float(model.spin_drag),
        )
        self._threads = True if threads > 1 else None  # None: the kernel of one thread alone is compiled
        self.skin = SKIN
        self.steps = self.rebuilds = self.substeps = 0
        self._since = 0  # substep of the last build
        # A contact is known by its disks: no disk may meet two images of another, nor its own.
        self._widest = state.length / 2 - float(np.sort(state.radii)[-2:].sum())
        if self._widest < SKINS[0]:
            raise InputError(f"shear: a cell of {state.length:.3g} is too small for disks of these sizes")
        runs = (n - 1) // CHUNK + 1
        self._sums = np.zeros((runs + 1, SUMS))
        self._events = Events(np.zeros((runs + 1, 3), np.int64), np.zeros((runs + 1, 2, BINS), np.int64))
        self._total = np.zeros(SUMS)
        self._build(np.empty((0, 3), np.int64))
        self._divided, self.most = self.parts, 1
        self._see()

    def _build(self, contacts: NDArray[np.int64]) -> None:
        """Sort the disks and list their pairs, ``contacts`` among them (:func:`open_contacts`)."""
        d = self._disks
        self.skin = min(max(self.skin, SKINS[0]), SKINS[1], self._widest)
        wrap(d.q, self.L, self.strain, self.rate)
        order = order_in_space(d.q, self.L)
        self.tag = self.tag[order]
        q = d.q[order]
        self._disks = d = Disks(q, d.p, d.F, d.R[order], d.m[order], q[:, :2].copy())
        self._pairs = list_pairs(d.home, d.R, self.L, self.strain, self.skin)
        self._built, self._since = self.strain, self.substeps
        self.rebuilds += 1
        if mark(self._pairs, self.tag, contacts):
            raise SolverError(f"shear: a contact was lost at a strain of {self.strain:.6g}; take a smaller dt")
        self.parts = self.demand()

    def fastest(self) -> tuple[float, float]:
        """Bound the largest eigenvalues of M⁻¹B, in 1/τe, and M⁻¹K, in 1/τe², with the contacts at hand."""
        d, exponent = self._disks, self.model.potential.exponent
        return kernels.fastest(d.q, d.R, d.m, self._pairs, self._law, exponent, self.L, self.strain)

    def demand(self) -> int:
        """Return into how many parts a step must be divided to be stable with the contacts at hand."""
        largest, parts = stable_step(self.integrator, *self.fastest()), 1
        while self.dt > parts * largest:
            parts *= 2
        if parts > TICKS:
            raise SolverError(
                f"shear: at a strain of {self.strain:.6g} the contacts demand steps below {largest:.3g} "
                "tau_e; take a smaller dt"
            )
        return parts

    def rebuild(self) -> None:
        """Build the list of pairs anew, with the skin that the displacements since the last build suggest.

        A wider skin costs pairs at each step, a narrower one more builds: the cost is least where a skin
        of s lasts as long as s² says.
        """
        d, shear = self._disks, self.strain - self._built
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
            γ̇ in each step. Where it changes, ``bulk`` says what happens to the disks: ``scale`` their
            velocities and spins with the rate (VOT eqs. 40, 41), add the change of the linear ``profile``,
            or leave it to the ``boundary``.

        Raises
        ------
        SolverError
            If the disks fly apart.
        """
        strains = np.concatenate([[self.strain], strains])
        rates = np.concatenate([[self.rate], rates])
        if BULK[bulk] == 1 and (rates[:-1] == 0).any() and (rates[1:] != rates[:-1]).any():
            raise InputError("shear: velocities cannot be scaled from a strain rate of 0; choose another bulk")
        done, count = 0, len(rates) - 1
        while done < count:
            parts = self._begin()
            fine = np.concatenate([[self.rate], np.repeat(rates[done + 1 :], parts)])
            at = np.interp(np.arange(len(fine)) / parts, np.arange(count - done + 1), strains[done:])
            made, tried = 0, False
            while made < len(fine) - 1 and (self.parts == parts or made % parts):
                # once other parts are demanded, finish the step that was begun
                end = len(fine) if self.parts == parts else made + parts - made % parts + 1
                some = kernels.advance(
                    self._disks,
                    self._pairs,
                    self._law,
                    self.L,
                    self.dt,
                    parts,
                    SCHEMES[self.integrator],
                    at[made:end],
                    fine[made:end],
                    BULK[bulk],
                    self._built,
                    self.skin,
                    self._threads,
                    self.steps * TICKS + made % parts * (TICKS // parts),
                    self._sums,
                    self._events,
                    self._total,
                )
                self.steps += (made + some) // parts - made // parts
                made += some
                self.substeps += some
                self.time += some * self.dt / parts
                self.strain, self.rate = float(at[made]), float(fine[made])
                if made < end - 1:
                    self._widen() if some == 0 and tried else self.rebuild()
                    tried = some == 0
            done += made // parts
        fluid = self.model.fluid * self.L**2
        self._total[[kernels.DXY, kernels.DYX]] -= fluid * rates[1:].sum()
        self._total[[kernels.HEAT, kernels.WORK]] += fluid * (rates[1:] ** 2).sum()
        self._check()

    def _begin(self) -> int:
        """Begin to divide steps as is demanded; return into how many parts."""
        if self.parts != self._divided:
            self._total, self._start = self._closed()
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

    def _look(self) -> Array:
        """Return the sums at this moment, and book contacts that have just begun or ceased to touch."""
        d, now = self._disks, np.zeros(SUMS)
        d.F[:] = 0.0
        kernels.forces(
            d.q,
            d.F,
            d,
            self._pairs,
            self._law,
            self.L,
            self.strain,
            self.rate,
            self._threads,
            True,
            self.steps * TICKS,
            self._sums,
            self._events,
        )
        self._sums[:, kernels.KXX : kernels.WORK] = 0.0
        kernels.kinetic(d.q, d.m, self.rate, self._sums)
        kernels.book(self._sums, self.rate, 1.0, now)
        self._sums[-1] = 0.0
        return now

    def _see(self) -> None:
        """Take what touches now for contacts, without any event, and start to measure."""
        self._start = self._look()
        self._events.counts[:] = 0
        self._events.angles[:] = 0

    def energy(self) -> tuple[float, float, float]:
        """Return the elastic, the peculiar kinetic and the rotational energy, in m ds²/τe²."""
        d = self._disks
        exponent = self.model.potential.exponent
        elastic = kernels.elastic_energy(d.q, self._pairs, self._law, exponent, self.L, self.strain)
        c = d.q[:, 2:4].copy()
        c[:, 0] -= self.rate * d.q[:, 1]
        return float(elastic), float(d.m @ (c**2).sum(1)) / 2, float(d.m @ d.q[:, 4] ** 2) / 4

    def collect(self) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
        """Return what was summed since the last call, over steps, and begin anew.

        Returns
        -------
        total : (SUMS,)
            By the trapezoidal rule, but for TOUCHING (which belongs to the events) and JUMPS.
        counts : (3,)
            Contacts made, broken, and how long the latter lasted, in ticks, :data:`TICKS` a step.
        angles : (2, 100)
            Histograms of the collision angle at making and at breaking.
        """
        total, self._start = self._closed()
        counts, angles = self._events.counts.sum(0), self._events.angles.sum(0)
        self._events.counts[:] = 0
        self._events.angles[:] = 0
        self._total[:] = 0.0
        self.most = 1
        return total, counts, angles

    def _closed(self) -> tuple[Array, Array]:
        """Return what was summed, by the trapezoidal rule, and the sums at this moment."""
        end = self._look()
        half = 0.5 * (end - self._start) * (1 if self.integrator == "heun" else -1) / self._divided
        half[[kernels.TOUCHING, kernels.JUMPS]] = 0.0
        return self._total + half, end

    def observe(self, layers: Array, moments: Array, scatter: Array) -> Array:
        """Look at every disk and contact once (:func:`petscjam.md.kernels.observe`)."""
        d = self._disks
        pick = (self.steps * 2654435761) % 2**31  # spread over the contacts, the same after a restart
        return kernels.observe(d.q, d.R, self._pairs, self.L, self.strain, self.rate, pick, layers, moments, scatter)

    @property
    def state(self) -> State:
        """The state at this moment, disks in the order of the start."""
        q = np.empty_like(self._disks.q)
        q[self.tag] = self._disks.q
        R = np.empty(len(q))
        R[self.tag] = self._disks.R
        return State(
            q[:, :2], q[:, 2:4], q[:, 4] / R, R, self.L, self.strain, self.rate, self.time, self.model.potential.name
        )

    def checkpoint(self) -> dict[str, Any]:
        """Build a new list; return all that :meth:`restored` needs to go on as if nothing had happened.

        Call :meth:`collect` first: it books the contacts that the last step made and broke.
        """
        self.rebuild()
        self._divided = self.parts
        d = self._disks
        return {
            "q": d.q.copy(),
            "radii": d.R.copy(),
            "masses": d.m.copy(),
            "tag": self.tag.copy(),
            "contacts": open_contacts(self._pairs, self.tag),
            "numbers": np.array([self.L, self.strain, self.rate, self.time, self.skin]),
            "counts": np.array([self.steps, self.rebuilds]),
            "start": self._start.copy(),
        }

    @classmethod
    def restored(cls, saved: dict[str, Any], model: Model, dt: float, integrator: str, threads: int = 1) -> Simulation:
        """Return the simulation of a :meth:`checkpoint`."""
        q, radii = saved["q"], saved["radii"]
        L, strain, rate, time, skin = (float(x) for x in saved["numbers"])
        state = State(q[:, :2], q[:, 2:4], q[:, 4] / radii, radii, L, strain, rate, time)
        new = cls(state, model, dt, integrator, threads, saved["masses"])
        new._disks = Disks(q.copy(), q.copy(), np.zeros((len(q), 3)), radii, saved["masses"], q[:, :2].copy())
        new.tag, new.skin = saved["tag"].copy(), skin
        new.steps, new.rebuilds = (int(x) for x in saved["counts"])
        new.rebuilds -= 1
        new._build(saved["contacts"])
        new._divided = new.parts
        new._start = saved["start"].copy()
        return new
