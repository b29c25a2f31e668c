"""The engine for a GPU: many runs of one size side by side, one block each, or one large run by the whole card.

A :class:`Batch` has the arrays of its runs on the card and launches the kernels (:mod:`petscjam.md.cuda_kernels`) for
all of them. The launches of a run are the same in any company, so its numbers are, too.

Axes: i disk, x Cartesian, k step.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from typing import Any, ClassVar, NamedTuple, TypeVar

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.base.errors import InputError, SolverError
from petscjam.base.interrupt import check
from petscjam.base.types import Array
from petscjam.md import kernels
from petscjam.md.engine import (
    CONTACTS,
    DXY,
    DYX,
    HEAT,
    JUMPS,
    KXX,
    KYY,
    NORMAL2,
    SAMPLED,
    SUMS,
    TANGENTIAL2,
    TICKS,
    TOUCHING,
    WORK,
    Advance,
    Totals,
)
from petscjam.md.model import BULK, Model
from petscjam.md.neighbours import order_in_space, wrap
from petscjam.md.recording import Steps
from petscjam.md.result import Run
from petscjam.md.simulation import BALANCE, SKINS, Simulation, masses_of, saved_state, widest_skin
from petscjam.md.state import State

if not numba.config.ENABLE_CUDASIM and find_spec("numba_cuda") is None:
    raise InputError("shear: the engine cuda needs numba-cuda: pip install 'petscjam[cuda]'")
try:
    from numba import cuda

    from petscjam.md import cuda_kernels as card

    if not cuda.is_available():
        raise RuntimeError("there is no NVIDIA GPU, or no driver for it")
except Exception as error:
    raise InputError(f"shear: the engine cuda cannot start: {' '.join(str(error).split())}") from error

MOST = 1024  # disks of a run of a batch
STRETCH = 2048  # parts of steps of a launch: a signal waits for no more
T = TypeVar("T")
# Most threads of a block. More hide the latency of memory, which a large run needs; fewer have more registers.
THREADS = (2, 3) if card.SIMULATED else (512, 1024)


class Seen(NamedTuple):
    """A state, and what :func:`petscjam.md.cuda_kernels.look` summed and counted."""

    q: Array  # (N, 5)
    sums: Array  # (LOOKED,)
    angles: NDArray[np.int64]  # (2, BINS), since the run has its place
    duration: int
    closing: bool  # whether it has the sums for the trapezoidal rule


class Saved(NamedTuple):
    """A build for a checkpoint: its results, the contacts (C, 3) by place, and the state after it."""

    done: NDArray[np.int64]
    contacts: NDArray[np.int64]
    seen: Seen


class Batch:
    """Runs of one kind side by side on the card.

    Parameters
    ----------
    run : CudaSimulation
        Like all others.
    places : int
        Most runs at a time.
    """

    def __init__(self, run: CudaSimulation, places: int) -> None:
        n, self.wide, self.kind = len(run), run.wide, run.kind
        each, most = (
            -(-n // multiprocessors()) if run.wide else n,
            THREADS[run.wide and n > THREADS[0] * multiprocessors()],
        )
        self.threads = min(-(-each // 32) * 32, most)
        self.blocks = min(-(-n // self.threads), multiprocessors()) if run.wide else 1
        self.advance, self.look = card.compiled(run.integrator, run.model.potential, run.wide, most)
        self.runs: list[CudaSimulation | None] = [None] * places
        self.sizes = {"R": places, "N": n, "M": n, "C": 8, "B": self.blocks, "L": STRETCH + 1}
        self.sizes |= {"T": self.threads * self.blocks, "S": 10 * n if run.wide else 1}
        self.card = {name: cuda.to_device(self._zeros(name)) for name in card.SHAPES}
        self.host = {name: self._zeros(name) for name in ("numbers", "orders", "state", "course")}

    def _zeros(self, name: str) -> NDArray[Any]:
        kind, axes = card.SHAPES[name]
        numbers = [re.findall(r"\d+|[A-Z]", axis) for axis in axes]
        return np.zeros([math.prod(self.sizes.get(k) or int(k) for k in number) for number in numbers], kind)

    def takes(self, run: CudaSimulation) -> bool:
        """Whether there is room for a run: for any other kind, if the batch is empty, there is not."""
        return self.kind == run.kind and None in self.runs

    def put(self, run: CudaSimulation) -> None:
        """Copy a run to the card, into a free place or its own."""
        if run.batch is None:
            run.batch, run.place = self, self.runs.index(None)
            self.runs[run.place] = run
        n, pairs = self.sizes["N"], np.concatenate([run.contacts, run.contacts[:, [1, 0, 2]]])
        i, j, tick = pairs[np.argsort(pairs[:, 0], kind="stable")].T
        held = np.bincount(i, minlength=n)
        at = np.arange(len(i)) - np.repeat(np.cumsum(held) - held, held)
        for name, values in (("open", j), ("began", tick)):
            rows = np.zeros((held.max(), n), card.SHAPES[name][0])
            rows[at, i] = values
            for k, row in enumerate(rows):
                self.card[name][k, run.place].copy_to_device(row)
        for name, values in (("now", run.q), ("R", run.R), ("m", run.m), ("light", 1 / run.m), ("held", held)):
            self.card[name][run.place].copy_to_device(np.ascontiguousarray(values, card.SHAPES[name][0]).ravel())
        run.gather = 0

    def drop(self, run: CudaSimulation) -> None:
        """Make room for another run."""
        self.runs[run.place], run.batch = None, None

    def _launch(self, kernel: Any, courses: Mapping[CudaSimulation, Course]) -> None:
        """Launch a kernel for some runs."""
        orders, state = self.host["orders"], self.host["state"]
        orders[:, card.END], state[:] = -1, (card.FINE, -1)
        for run, course in courses.items():
            self.host["course"][run.place, :, : len(course.strains)] = course.strains, course.rates
            self.host["numbers"][run.place], orders[run.place] = (
                run.numbers,
                [course.end, run.parts, course.bulk, run.steps * TICKS, *run.cells, run.gather, course.counted],
            )
        for name, values in self.host.items():
            self.card[name].copy_to_device(values)
        grid, shared = (self.blocks, 0) if self.wide else (len(self.runs), 40 * self.sizes["N"])
        kernel[grid, self.threads, 0, shared](card.Runs(**self.card))

    def _made(self, courses: Mapping[CudaSimulation, Course]) -> list[tuple[NDArray[np.int64], Array]]:
        """Launch ``advance``; return results and sums of each run. Cells without room are enlarged."""
        self._launch(self.advance, courses)
        done, sums = self.card["done"].copy_to_host(), self.card["sums"].copy_to_host()[:, :, :SUMS].sum(1)
        if card.CROWDED in [done[run.place, card.STATUS] for run in courses]:
            self.sizes["C"] *= 2
            self.card["members"] = cuda.to_device(self._zeros("members"))
        return [(done[run.place], sums[run.place]) for run in courses]

    def make(self, jobs: Iterable[Job]) -> None:
        """Make all steps of some runs."""
        todo = {job.run: job for job in jobs if job.left}
        while todo:
            divided = [run for run in todo if run.parts != run.divided]
            self.see(divided, divided)
            for run in divided:
                run.close()
            courses = {run: job.next() for run, job in todo.items()}
            for job, (done, sums) in zip([*todo.values()], self._made(courses), strict=True):
                job.took(done, sums)
            todo = {run: job for run, job in todo.items() if job.left and run.error is None}

    def build(self, runs: Iterable[CudaSimulation]) -> dict[CudaSimulation, NDArray[np.int64]]:
        """List the neighbours; return the results of the launches."""
        todo, results = [*runs], dict[CudaSimulation, NDArray[np.int64]]()
        while todo:
            made = self._made({run: Course([run.strain], [run.rate], 0) for run in todo})
            for run, (done, _) in zip([*todo], made, strict=True):
                results[run] = done
                run.room(done[card.STATUS])
                if run.error or run.gather:
                    todo.remove(run)
        return results

    def see(self, runs: Sequence[CudaSimulation], closing: Iterable[CudaSimulation] = ()) -> None:
        """Look at some runs, at those that are ``closing`` also for the trapezoidal rule."""
        if not runs:
            return
        closing = {*closing}
        self._launch(self.look, {run: Course([run.strain], [run.rate], int(run in closing)) for run in runs})
        now, sums, keys, angles, duration = (
            self.card[name].copy_to_host() for name in ("now", "sums", "keys", "angles", "duration")
        )
        for run in runs:
            total = sums[run.place].sum(0)
            total[card.ONE :] = sums[run.place, keys[run.place].argmin(), card.ONE :]
            if keys[run.place].min() == card.NONE:
                total[card.ONE :] = np.nan
            run.seen = Seen(
                now[run.place].reshape(-1, 5), total, angles[run.place], int(duration[run.place, 0]), run in closing
            )

    def contacts(self, runs: Iterable[CudaSimulation]) -> dict[CudaSimulation, NDArray[np.int64]]:
        """Return the contacts at the last build, (C, 3): disks by place, and tick."""
        held = self.card["held"].copy_to_host()
        most = held.max(initial=0)
        open, began = (self.card[name][:most].copy_to_host() for name in ("open", "began"))
        found = {}
        for run in runs:
            there = np.arange(most)[:, None] < held[run.place]
            i, j = np.nonzero(there.T)[0], open[:, run.place].T[there.T]
            rows = np.column_stack([i, j, began[:, run.place].T[there.T]])[i < j]
            found[run] = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
        return found

    def save(self, runs: Sequence[CudaSimulation]) -> None:
        """Build new lists, of a large run with its disks sorted in space; the checkpoint waits in each run."""
        before, done = {run: run.seen for run in runs}, self.build(runs)
        contacts = self.contacts(runs)
        if self.wide:
            (run,) = runs
            self.see(runs)
            run.sort(run.seen.q, contacts[run])
            self.put(run)
            done[run] = self.build(runs)[run]
            contacts[run] = run.contacts
        self.see(runs)
        for run in runs:
            run.saved, run.seen = Saved(done[run], contacts[run], run.seen), before[run]

    def work(self, requests: Sequence[Advance]) -> None:
        """Make the steps of requests, and prepare what is asked for next."""
        runs = [request.engine for request in requests]
        self.settle([run for run in runs if not run.settled])
        self.make([Job(run, request) for run, request in zip(runs, requests, strict=True) if run.error is None])
        closing = [request.engine for request in requests if request.closes and request.engine.error is None]
        self.see([run for run in runs if run.error is None], closing)
        if not self.wide:
            self.save(closing)

    def settle(self, runs: Sequence[CudaSimulation]) -> None:
        """Build the first lists; contacts of the initial state do not count as made."""
        for run, done in self.build(runs).items():
            run.built(done)
            run.settled, run.divided = True, run.parts
        runs = [run for run in runs if run.error is None]
        self.see(runs, [run for run in runs if not len(run.start)])
        for run in runs:
            run.start = run.start if len(run.start) else run.now
            run.forget()


class Course(NamedTuple):
    """A launch: strains (K + 1,), rates (K + 1,), END, BULK, COUNTED (:mod:`petscjam.md.cuda_kernels`)."""

    strains: Sequence[float] | Array
    rates: Sequence[float] | Array
    end: int
    bulk: int = 0
    counted: int = 0


class Job:
    """Steps that a run has to make, with its present strain and rate before the first."""

    def __init__(self, run: CudaSimulation, request: Advance) -> None:
        self.run, self.bulk = run, BULK[request.bulk]
        self.strains, self.rates = np.append(run.strain, request.strains), np.append(run.rate, request.rates)
        self.parts, self.made, self.at, self.fine, self.counted = 1, 0, self.strains[:1], self.rates[:1], 0
        run.check(self.rates, self.bulk)
        fluid = run.model.fluid * run.length * run.height
        run.total[[DXY, DYX]] -= fluid * self.rates[1:].sum()
        run.total[[HEAT, WORK]] += fluid * (self.rates[1:] ** 2).sum()

    @property
    def left(self) -> int:
        """Steps that are not made."""
        return 0 if self.run.error else len(self.rates) - 1

    def next(self) -> Course:
        """Return the next launch."""
        if self.made == len(self.fine) - 1:
            self.parts, self.made = self.run.parts, 0
            steps = min(self.left, max(STRETCH // self.parts, 1))
            self.fine = np.append(self.run.rate, np.repeat(self.rates[1 : steps + 1], self.parts))
            self.at = np.interp(np.arange(len(self.fine)) / self.parts, np.arange(steps + 1), self.strains[: steps + 1])
        end = len(self.fine) - 1 - self.made
        return Course(self.at[self.made :], self.fine[self.made :], end, self.bulk, self.counted)

    def took(self, done: NDArray[np.int64], sums: Array) -> None:
        """Count what a launch has made."""
        run, end = self.run, self.made + int(done[card.MADE])
        steps = end // self.parts - self.made // self.parts
        run.took(end - self.made, self.parts, steps, done, sums)
        self.made, self.counted = end, int(done[card.HALFWAY])
        if done[card.CHANGED]:
            self.fine[end] = self.fine[end + 1]
        run.strain, run.rate = float(self.at[end]), float(self.fine[end])
        self.strains, self.rates = self.strains[steps:], self.rates[steps:]
        if run.parts != self.parts and end % self.parts == 0:  # another division from here on
            self.made, self.at, self.fine = 0, self.at[end : end + 1], self.fine[end : end + 1]


class CudaSimulation:
    """Disks under shear on a GPU: an :class:`petscjam.md.engine.Engine`.

    Parameters
    ----------
    state : State
    model : Model
    dt : float
        As for :class:`petscjam.md.simulation.Simulation`.
    integrator : str
    threads : int
        Is ignored.
    masses : (N,)
        In m; default: all 1 (VOT).

    Raises
    ------
    InputError
        As for the CPU.
    SolverError
        If the contacts require steps below a thousandth of dt.
    """

    CHECKPOINT: ClassVar[Mapping[str, str]] = Simulation.CHECKPOINT
    abreast: ClassVar[Any]

    def __init__(
        self,
        state: State,
        model: Model,
        dt: float | None = None,
        integrator: str = "heun",
        threads: int = 1,
        masses: ArrayLike | None = None,
    ) -> None:
        self.model, self.integrator, n = model, integrator, len(state)
        self.dt = model.step(dt, integrator)
        self.length, self.height = state.length, state.height
        self.strain, self.rate, self.time = state.strain, state.rate, state.time
        self._widest = widest_skin(state)
        # The first list lasts as long as later ones, if the disks keep their velocities.
        pace = 2 * np.hypot(*state.peculiar.T).max() + abs(state.rate) * state.radii.max()
        self.wide, self.skin = n > MOST, self._within(float(np.sqrt(BALANCE[integrator] * pace * self.dt)))
        self.q = np.column_stack([state.positions, state.velocities, state.spins * state.radii])
        self.R, self.m, self.tag = state.radii.copy(), masses_of(n, model, masses), np.arange(n)
        self.contacts = np.empty((0, 3), np.int64)
        self.steps = self.rebuilds = self.substeps = 0
        self.parts = self.divided = self.most = 1
        self.total, self.start = np.zeros(SUMS), np.empty(0)
        self.settled = self.ahead = False
        self.batch: Batch | None = None
        self.seen: Seen | None = None
        self.saved: Saved | None = None
        self.error: Exception | None = None
        self.place = self.gather = 0
        if self.wide:
            wrap(self.q, self.length, self.height, self.strain, self.rate)
            self.sort(self.q, self.contacts)

    def __len__(self) -> int:
        return len(self.tag)

    def sort(self, q: Array, contacts: NDArray[np.int64]) -> None:
        """Sort the disks in space."""
        order = order_in_space(q, self.length, self.height)
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        self.q, self.R, self.m, self.tag = q[order], self.R[order], self.m[order], self.tag[order]
        self.contacts = np.column_stack([place[contacts[:, :2]], contacts[:, 2]])

    @property
    def kind(self) -> tuple[Any, ...]:
        """What runs of a batch have in common."""
        return len(self), self.integrator, self.model.potential

    @property
    def numbers(self) -> list[float]:
        """Its row of ``numbers`` (:mod:`petscjam.md.cuda_kernels`)."""
        law = self.model
        friction = [law.normal, law.tangential, float(law.rolls), law.body, law.rotational_drag]
        return [self.length, self.height, self.skin, 2 * float(self.R.max()), self.dt / self.parts, *friction]

    @property
    def cells(self) -> tuple[int, int]:
        """Columns and rows of cells, at most as many as disks."""
        edge, n = 2 * float(self.R.max()) + self.skin, len(self)
        columns = max(1, min(int(self.length / edge), int(np.sqrt(n * self.length / self.height))))
        rows = max(1, min(int(self.height / edge), n // columns))
        return columns, rows

    def check(self, rates: Array, bulk: int) -> None:
        """Refuse to scale velocities from a strain rate of 0."""
        if bulk == 1 and (rates[:-1] == 0).any() and (rates[1:] != rates[:-1]).any():
            text = "shear: velocities cannot be scaled from a strain rate of 0; choose another bulk"
            self.error = InputError(text)

    def at_home(self) -> Batch:
        """Return its batch, one of its own unless it has one."""
        if self.batch is None:
            Batch(self, 1).put(self)
        assert self.batch is not None
        return self.batch

    def advance(self, strains: Array, rates: Array, bulk: str = "scale") -> None:
        """Make K steps (:meth:`petscjam.md.engine.Engine.advance`), unless :func:`together` has made them.

        Parameters
        ----------
        strains : (K,)
        rates : (K,)
        bulk : str

        Raises
        ------
        SolverError
            If the disks fly apart.
        """
        if not self.ahead:
            together([Advance(self, strains, rates, bulk, False)])
        self.ahead = False
        if self.error is not None:
            raise self.error

    def took(self, made: int, parts: int, steps: int, done: NDArray[np.int64], sums: Array) -> None:
        """Count what a launch has made: so many parts and complete steps."""
        self.substeps += made
        self.steps += steps
        self.time += made * self.dt / parts
        self.most = max(self.most, parts)
        self.total += np.where(np.arange(SUMS) == JUMPS, sums, sums / parts)
        self.seen = None
        if not np.isfinite(sums).all():
            done[card.STATUS] = card.DIVERGED
        if done[card.BUILDS] > 1:
            pace = self.skin * (done[card.BUILDS] - 1) / max(done[card.BEGUN], 1)
            self.skin = float(np.sqrt(BALANCE[self.integrator] * pace))
        elif made:
            self.skin *= 0.9
        self.built(done)
        self.skin = self._within(self.skin)

    def _within(self, skin: float) -> float:
        return min(max(skin, SKINS[0]), SKINS[1], self._widest)

    def built(self, done: NDArray[np.int64]) -> None:
        """Take over the results of a launch that lists neighbours."""
        self.rebuilds += int(done[card.BUILDS])
        self.parts, status = int(done[card.DEMAND]), done[card.STATUS]
        self.room(status)
        at = f"at a strain of {self.strain:.6g}"
        if status == card.LOST:
            self.error = SolverError(f"shear: a contact was lost {at}; take a smaller dt")
        elif status == card.DIVERGED:
            self.error = SolverError(f"shear: velocities grew without bound {at}; take a smaller dt")
        elif self.parts > TICKS:
            self.error = SolverError(f"shear: {at} the contacts require steps below dt/{TICKS}; take a smaller dt")
        elif status == card.WIDEN:
            if self.skin >= min(SKINS[1], self._widest):
                text = f"shear: disks leave their neighbours within a step {at}; take a smaller dt"
                self.error = SolverError(text)
            self.skin *= 2

    def room(self, status: int) -> None:
        """Note whether there was room for the lists, and take a narrower skin if there was not."""
        self.gather = int(status not in (card.FULL, card.CROWDED))
        if status == card.FULL:
            if self.skin <= SKINS[0]:
                text = f"shear: a disk has more than {card.PLACES} neighbours: too many for the engine cuda"
                self.error = InputError(text)
            self.skin = max(self.skin / 2, SKINS[0])

    @property
    def now(self) -> Array:
        """Sums of the current state; contacts that were made or broken in the last step are counted."""
        if self.seen is None or not self.seen.closing:
            self.at_home().see([self], [self])
        assert self.seen is not None
        return self.seen.sums[:SUMS]

    def closed(self) -> tuple[Array, Array]:
        """Return the sums by the trapezoidal rule, and the sums of the current state."""
        end = self.now
        half = 0.5 * (end - self.start) * (1 if self.integrator == "heun" else -1) / self.divided
        half[[TOUCHING, JUMPS]] = 0.0
        return self.total + half, end

    def close(self) -> None:
        """Close the sums before a step is divided into another number of parts."""
        self.total, self.start = self.closed()
        self.divided = self.parts

    def forget(self) -> None:
        """Set the sums to zero."""
        seen = self.look
        self._angles, self._duration = seen.angles, seen.duration
        self.total, self.most = np.zeros(SUMS), 1

    @property
    def look(self) -> Seen:
        """The current state."""
        if self.seen is None:
            batch = self.at_home()
            batch.see([self]) if self.settled else batch.settle([self])
        if self.error is not None:
            raise self.error
        assert self.seen is not None
        return self.seen

    def collect(self) -> Totals:
        """Return the sums over the steps since the last call, and set them to zero."""
        sums, self.start = self.closed()
        angles = self.look.angles - self._angles
        counts = np.array([*angles.sum(1), self.look.duration - self._duration])
        self.forget()
        return Totals(sums, counts, angles)

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
        sums, seen = np.zeros(SAMPLED), self.look
        disks = kernels.Disks(seen.q, seen.q, seen.q, self.R, self.m, seen.q)
        kernels.sample_disks(disks, self.height, self.rate, layers, sums)
        sums[[NORMAL2, TANGENTIAL2, CONTACTS]] = seen.sums[[card.SQUARES, card.SQUARES_T, card.NUMBER]]
        products = np.zeros((4, 4))
        products[np.tril_indices(4)] = seen.sums[card.SECOND : card.ONE]
        moments[0] += seen.sums[card.FIRST : card.SECOND]
        moments[1:] += products + np.tril(products, -1).T
        if np.isfinite(seen.sums[card.ONE]):
            scatter[:] = seen.sums[card.ONE :]
        return sums

    def energy(self) -> tuple[float, float, float]:
        """Return the elastic, the peculiar kinetic and the rotational energy, in m ds²/τe²."""
        sums = self.look.sums
        return float(sums[card.ELASTIC]), float(sums[KXX] + sums[KYY]) / 2, float(sums[card.ROTATIONAL])

    @property
    def state(self) -> State:
        """The current state, disks in the order of the start."""
        now = self.q if self.batch is None else self.look.q
        q, R = np.empty_like(now), np.empty_like(self.R)
        q[self.tag], R[self.tag] = now, self.R
        cell, name = (self.length, self.strain, self.rate, self.time), self.model.potential.name
        return State(q[:, :2], q[:, 2:4], q[:, 4] / R, R, *cell, name, self.height)

    def checkpoint(self) -> dict[str, Any]:
        """Build a new list; return everything that :meth:`restored` needs to continue bit for bit.

        Call :meth:`collect` before: it records the contacts that the last step made and broke.
        """
        if self.saved is None:
            self.at_home().save([self])
        assert self.saved is not None
        done, contacts, self.seen = self.saved
        self.saved = None
        self.built(done)
        if self.error is not None:
            raise self.error
        self.divided = self.parts
        return {
            "q": self.seen.q,
            "radii": self.R,
            "masses": self.m,
            "tag": self.tag,
            "contacts": np.column_stack([self.tag[contacts[:, :2]], contacts[:, 2]]),
            "numbers": np.array([self.length, self.strain, self.rate, self.time, self.skin]),
            "height": np.array([self.height]),
            "counts": np.array([self.steps, self.rebuilds]),
            "start": self.start,
        }

    @classmethod
    def restored(
        cls, saved: Mapping[str, Any], model: Model, dt: float, integrator: str, threads: int = 1
    ) -> CudaSimulation:
        """Return the simulation of a :meth:`checkpoint`, also of one of the CPU.

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
        new = cls(saved_state(saved, model), model, dt, integrator, threads, saved["masses"])
        new.q, new.R, new.m, new.tag = (saved[name].copy() for name in ("q", "radii", "masses", "tag"))
        place = np.empty_like(new.tag)
        place[new.tag] = np.arange(len(new))
        new.contacts = np.column_stack([place[saved["contacts"][:, :2]], saved["contacts"][:, 2]])
        new.skin = float(saved["numbers"][-1])
        new.steps, new.rebuilds = (int(x) for x in saved["counts"])
        new.rebuilds -= 1
        new.start = saved["start"].copy()
        return new


def multiprocessors() -> int:
    """Return the number of multiprocessors of the card."""
    return 1 if card.SIMULATED else int(cuda.get_current_device().MULTIPROCESSOR_COUNT)


def places(n: int) -> int:
    """Return the number of runs of ``n`` disks that the card advances at the same time."""
    return 1 if n > MOST else multiprocessors() * max(1, THREADS[0] // (-(-n // 32) * 32))


def together(requests: Iterable[Advance]) -> None:
    """Make the steps of several runs, all those of a batch in one launch; they know of it when they advance.

    Parameters
    ----------
    requests : iterable of Advance
        Of a :class:`CudaSimulation` each.
    """
    batches: dict[Batch, list[Advance]] = {}
    for request in requests:
        batches.setdefault(request.engine.at_home(), []).append(request)
        request.engine.ahead = True
    for batch, some in batches.items():
        batch.work(some)


def choose(rank: int) -> None:
    """Choose the card of a rank of this node.

    Parameters
    ----------
    rank : int
    """
    if not card.SIMULATED:
        cuda.select_device(rank % len(cuda.gpus))


def abreast(
    tasks: Iterable[T], begin: Callable[[T], Steps], done: Callable[[T, Run], None]
) -> Iterator[tuple[T, InputError | SolverError]]:
    """Make many runs, as many at a time as the card has room for; yield those that fail, with their errors.

    Parameters
    ----------
    tasks : iterable
    begin : callable
        Returns the steps of the run of a task (:func:`petscjam.md.runs.begin`).
    done : callable
        Is called with each task and its complete run.

    Raises
    ------
    Interrupted
        On a signal; the file of each run ends with its last complete row.
    """
    failed: list[tuple[T, InputError | SolverError]] = []

    def step(task: T, steps: Steps) -> Advance | None:
        try:
            return next(steps)
        except StopIteration as end:
            done(task, end.value)
        except (InputError, SolverError) as error:
            failed.append((task, error))
        return None

    waiting, batch = deque(tasks), None
    running: dict[T, tuple[Steps, Advance]] = {}
    following: tuple[T, Steps, Advance] | None = None  # begun, but there is no room yet
    try:
        while waiting or running or following:
            while waiting or following:
                if following is None:
                    task = waiting.popleft()
                    steps = begin(task)
                    request = step(task, steps)
                    if request is None:
                        continue
                    following = task, steps, request
                run = following[2].engine
                if not running and (batch is None or batch.kind != run.kind):
                    batch = Batch(run, min(places(len(run)), len(waiting) + 1))
                if not batch.takes(run):
                    break
                batch.put(run)
                running[following[0]], following = following[1:], None
            yield from failed
            failed.clear()
            check()
            together(request for _, request in running.values())
            for task, (steps, request) in [*running.items()]:
                after = step(task, steps)
                running[task] = steps, after
                if after is None:
                    del running[task]
                    batch.drop(request.engine)
        yield from failed
    finally:
        for steps, _ in running.values():
            steps.close()
        if following is not None:
            following[1].close()


CudaSimulation.abreast = staticmethod(abreast)
