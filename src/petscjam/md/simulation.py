"""A simulation in progress: disks, their list of pairs, and the sums of what was measured.

Axes: i disk, x Cartesian, k step.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.box import Array
from petscjam.errors import InputError, SolverError, shown
from petscjam.md import kernels
from petscjam.md.kernels import BINS, HEUN, SINGLE, SUMS, Disks, Events, Law
from petscjam.md.model import BULK, Model
from petscjam.md.neighbours import list_pairs, mark, open_contacts, order_in_space, wrap
from petscjam.md.state import State
from petscjam.neighbours import CHUNK

SCHEMES = {"heun": HEUN, "single": SINGLE}
SKIN = 0.03  # ds, the first list
SKINS = 0.005, 0.5  # the least and the most of later ones
BALANCE = {"heun": 1.3, "single": 2.6}  # cost of a build over that of the pairs in a skin of 1 ds, per step


class Simulation:
    """Disks under shear, advanced step by step.

    Parameters
    ----------
    state : State
    model : Model
    dt : float
        Time step in τe; left out, as :meth:`petscjam.md.model.Model.step` says.
    integrator : str
        ``heun`` (VOT eqs. 21–24) or ``single`` (one evaluation of the forces a step).
    threads : int
    masses : (N,)
        In m; left out, all 1 (VOT).

    Raises
    ------
    InputError
        If dt is not stable, or the cell is too small for its disks.
    """

    def __init__(
        self, state: State, model: Model, dt: float | None = None, integrator: str = "heun", threads: int = 1,
        masses: ArrayLike | None = None,
    ) -> None:  # fmt: skip
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
        exponent = None if model.exponent == 2 else float(model.exponent)
        self._law = Law(
            model.normal, model.tangential, float(model.rolls), exponent, float(model.body),
            float(model.spin_drag),
        )  # fmt: skip
        self.skin = SKIN
        self.steps = self.rebuilds = 0
        self._since = 0  # step of the last build
        # A contact is known by its disks: no disk may meet two images of another, nor its own.
        self._widest = state.length / 2 - float(np.sort(state.radii)[-2:].sum())
        if self._widest < SKINS[0]:
            raise InputError(f"shear: a cell of {state.length:.3g} is too small for disks of these sizes")
        runs = (n - 1) // CHUNK + 1
        self._sums = np.zeros((runs + 1, SUMS))
        self._events = Events(np.zeros((runs + 1, 3), np.int64), np.zeros((runs + 1, 2, BINS), np.int64))
        self._total = np.zeros(SUMS)
        self._build(np.empty((0, 3), np.int64))
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
        self._built, self._since = self.strain, self.steps
        self.rebuilds += 1
        if mark(self._pairs, self.tag, contacts):
            raise SolverError(
                f"shear: a contact was lost at a strain of {self.strain:.6g}; take a smaller dt"
            )

    def rebuild(self) -> None:
        """Build the list of pairs anew, with the skin that the displacements since the last build suggest.

        A wider skin costs pairs at each step, a narrower one more builds: the cost is least where a skin
        of s lasts as long as s² says.
        """
        d, shear = self._disks, self.strain - self._built
        if self.steps > self._since:
            away = d.q[:, :2] - d.home
            away[:, 0] -= shear * d.q[:, 1]
            used = 2 * np.sqrt((away**2).sum(1).max()) + abs(shear) * d.R.max()
            pace = used / (self.steps - self._since)
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
            raise InputError(
                "shear: velocities cannot be scaled from a strain rate of 0; choose another bulk"
            )
        done, count, tried = 0, len(rates) - 1, False
        while done < count:
            made = kernels.advance(
                self._disks, self._pairs, self._law, self.L, self.dt, SCHEMES[self.integrator],
                strains[done:], rates[done:], BULK[bulk], self._built, self.skin, self.threads > 1,
                self.steps, self._sums, self._events, self._total,
            )  # fmt: skip
            done += made
            self.steps += made
            self.time += made * self.dt
            self.strain, self.rate = float(strains[done]), float(rates[done])
            if done < count:
                if made == 0 and tried:
                    self._check()
                    if self.skin >= min(SKINS[1], self._widest):
                        raise SolverError(
                            f"shear: disks leave their neighbours within a step at a strain of "
                            f"{self.strain:.6g}; take a smaller dt"
                        )
                    self.skin *= 2
                    self._build(open_contacts(self._pairs, self.tag))
                else:
                    self.rebuild()
                tried = made == 0
        self._check()

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
            d.q, d.F, d, self._pairs, self._law, self.L, self.strain, self.rate, self.threads > 1, True,
            self.steps, self._sums, self._events,
        )  # fmt: skip
        self._sums[:, kernels.KXX : kernels.WORK] = 0.0
        kernels.kinetic(d.q, d.m, self.rate, self._sums)
        kernels.book(self._sums, self.rate, now)
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
        elastic = kernels.elastic_energy(d.q, self._pairs, self.model.exponent, self.L, self.strain)
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
            Contacts made, broken, and the steps that the latter lasted.
        angles : (2, 100)
            Histograms of the collision angle at making and at breaking.
        """
        end, total = self._look(), self._total.copy()
        half = 0.5 * (end - self._start) * (1 if self.integrator == "heun" else -1)
        half[[kernels.TOUCHING, kernels.JUMPS]] = 0.0
        counts, angles = self._events.counts.sum(0), self._events.angles.sum(0)
        self._events.counts[:] = 0
        self._events.angles[:] = 0
        self._total[:] = 0.0
        self._start = end
        return total + half, counts, angles

    def observe(self, layers: Array, moments: Array, scatter: Array) -> Array:
        """Look at every disk and contact once (:func:`petscjam.md.kernels.observe`)."""
        d = self._disks
        pick = (self.steps * 2654435761) % 2**31  # spread over the contacts, the same after a restart
        return kernels.observe(
            d.q, d.R, self._pairs, self.L, self.strain, self.rate, pick, layers, moments, scatter
        )

    @property
    def state(self) -> State:
        """The state at this moment, disks in the order of the start."""
        q = np.empty_like(self._disks.q)
        q[self.tag] = self._disks.q
        R = np.empty(len(q))
        R[self.tag] = self._disks.R
        return State(
            q[:, :2], q[:, 2:4], q[:, 4] / R, R, self.L, self.strain, self.rate, self.time
        )  # fmt: skip

    def checkpoint(self) -> dict[str, Any]:
        """Build a new list; return all that :meth:`restored` needs to go on as if nothing had happened.

        Call :meth:`collect` first: it books the contacts that the last step made and broke.
        """
        self.rebuild()
        d = self._disks
        return {
            "q": d.q, "radii": d.R, "masses": d.m, "tag": self.tag,
            "contacts": open_contacts(self._pairs, self.tag),
            "numbers": np.array([self.L, self.strain, self.rate, self.time, self.skin]),
            "counts": np.array([self.steps, self.rebuilds]), "start": self._start,
        }  # fmt: skip

    @classmethod
    def restored(
        cls, saved: dict[str, Any], model: Model, dt: float, integrator: str, threads: int = 1
    ) -> Simulation:
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
        new._start = saved["start"].copy()
        return new
