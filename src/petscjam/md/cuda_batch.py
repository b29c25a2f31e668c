"""Runs of one kind side by side on a GPU: their arrays, and launches of the kernels for all of them.

Axes: i disk, k step.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numba import cuda
from numpy.typing import NDArray

from petscjam.base.errors import InputError
from petscjam.base.types import Array
from petscjam.md import cuda_kernels as card
from petscjam.md.engine import DXY, DYX, HEAT, SUMS, TICKS, WORK, Advance
from petscjam.md.model import BULK

Simulated: TypeAlias = Any  # a petscjam.md.cuda.CudaSimulation
MOST = 1024  # disks of a run of a batch
STRETCH = 2048  # parts of steps of a launch: a signal waits for no more
# Most threads of a block. More hide the latency of memory, which a large run needs; fewer have more registers.
THREADS = (2, 3) if card.SIMULATED else (512, 1024)


LISTS = "code", "inverse", "gap", "since", "open", "began", "members"
COPIED = (
    "numbers",
    "orders",
    "state",
    "course",
    "done",
    "sums",
    "now",
    "stress",
    "keys",
    "angles",
    "duration",
    "held",
    "angle",
)


class Seen(NamedTuple):
    """A state, and what :func:`petscjam.md.cuda_kernels.look` summed and counted."""

    q: Array  # (N, 5)
    sums: Array  # (LOOKED,)
    stress: Array  # (3, N)
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

    def __init__(self, run: Simulated, places: int) -> None:
        n, self.wide, self.kind, cores = len(run), run.wide, run.kind, multiprocessors()
        most = THREADS[run.wide and n > THREADS[0] * cores]
        self.threads = min(-(-(-(-n // cores) if run.wide else n) // 32) * 32, most)
        self.blocks = min(-(-n // self.threads), cores) if run.wide else 1
        self.potential = run.model.potential
        self.advance, self.look = card.compiled(run.integrator, self.potential, run.model.film is None, run.wide, most)
        self.runs: list[Simulated] = [None] * places
        self.sizes = {"R": places, "N": n, "M": n, "C": 8, "B": self.blocks, "L": STRETCH + 1}
        self.sizes |= {"T": self.threads * self.blocks, "S": 10 * n if run.wide else 1}
        need = sum(math.prod(self._shape(name)) * np.dtype(kind).itemsize for name, (kind, _) in card.SHAPES.items())
        if need > free_memory():
            raise InputError(f"shear: {places} runs of {n} disks need {need / 2**20:.0f} MB on the GPU; less is free")
        self.card = {name: self._array(name) for name in card.SHAPES}
        self.host = {name: cuda.pinned_array(self._shape(name), card.SHAPES[name][0]) for name in COPIED}

    def _shape(self, name: str) -> tuple[int, ...]:
        axes = [re.findall(r"\d+|[A-Z]", axis) for axis in card.SHAPES[name][1]]
        return tuple(math.prod(self.sizes.get(size) or int(size) for size in axis) for axis in axes)

    def _array(self, name: str) -> Any:
        """Return an array on the card, of zeros unless it is a list."""
        kind, shape = card.SHAPES[name][0], self._shape(name)
        return cuda.device_array(shape, kind) if name in LISTS else cuda.to_device(np.zeros(shape, kind))

    def _copy(self, *names: str) -> list[NDArray[Any]]:
        """Copy arrays from the card."""
        for name in names:
            self.card[name].copy_to_host(self.host[name])
        return [self.host[name].copy() for name in names]

    def takes(self, run: Simulated) -> bool:
        """Whether there is room for a run: for any other kind, if the batch is empty, there is not."""
        return self.kind == run.kind and None in self.runs

    def put(self, run: Simulated) -> None:
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
        if run.turned is not None:
            self.card["angle"][run.place].copy_to_device(run.turned)
        run.gather = 0

    def drop(self, run: Simulated) -> None:
        """Make room for another run."""
        self.runs[run.place], run.batch = None, None

    def _launch(self, kernel: Any, courses: Mapping[Simulated, Course]) -> None:
        """Launch a kernel for some runs."""
        orders, state = self.host["orders"], self.host["state"]
        orders[:, card.END], state[:] = -1, (card.FINE, -1)
        for run, course in courses.items():
            self.host["course"][run.place, :, : len(course.strains)] = course.strains, course.rates
            self.host["numbers"][run.place] = run.numbers
            first = course.end, run.parts, course.bulk, run.steps * TICKS + course.tick
            orders[run.place] = *first, *run.cells, run.gather, course.counted, run.turned is not None
        for name in ("numbers", "orders", "state", "course"):
            self.card[name].copy_to_device(self.host[name])
        grid, shared = (self.blocks, 0) if self.wide else (len(self.runs), 40 * self.sizes["N"])
        try:
            kernel[grid, self.threads, 0, shared](card.Runs(**self.card))
        except Exception as error:
            if self.potential.exponent is not None or card.SIMULATED:
                raise
            text = " ".join(str(error).split())
            raise InputError(f"potential: {self.potential.name!r}: numba cannot compile it for a GPU: {text}") from None

    def _made(self, courses: Mapping[Simulated, Course]) -> list[tuple[NDArray[np.int64], Array]]:
        """Launch ``advance``; return results and sums of each run. Cells without room are enlarged."""
        self._launch(self.advance, courses)
        done, sums = self._copy("done", "sums")
        if card.CROWDED in [done[run.place, card.STATUS] for run in courses]:
            self.sizes["C"] *= 2
            self.card["members"] = self._array("members")
        return [(done[run.place], sums[run.place, :, :SUMS].sum(0)) for run in courses]

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

    def build(self, runs: Iterable[Simulated]) -> dict[Simulated, NDArray[np.int64]]:
        """List the neighbours; return the results of the launches."""
        todo, results = [*runs], dict[Simulated, NDArray[np.int64]]()
        while todo:
            made = self._made({run: Course([run.strain], [run.rate], 0) for run in todo})
            for run, (done, _) in zip([*todo], made, strict=True):
                results[run] = done
                run.room(done[card.STATUS])
                if run.error or run.gather:
                    todo.remove(run)
        return results

    def see(self, runs: Sequence[Simulated], closing: Iterable[Simulated] = ()) -> None:
        """Look at some runs.

        Parameters
        ----------
        runs, closing : sequences of CudaSimulation
            All, and those that need the sums for the trapezoidal rule.
        """
        if not runs:
            return
        closing = {*closing}
        self._launch(self.look, {run: Course([run.strain], [run.rate], int(run in closing)) for run in runs})
        now, sums, stress, keys, angles, duration = self._copy("now", "sums", "stress", "keys", "angles", "duration")
        for run in runs:
            total = sums[run.place].sum(0)
            total[card.ONE :] = sums[run.place, keys[run.place].argmin(), card.ONE :]
            if keys[run.place].min() == card.NONE:
                total[card.ONE :] = np.nan
            if run.turned is not None:
                run.turned = self._copy("angle")[0][run.place]
            events = angles[run.place], int(duration[run.place, 0])
            run.seen = Seen(
                now[run.place].reshape(-1, 5), total, stress[run.place].reshape(3, -1), *events, run in closing
            )

    def contacts(self, runs: Iterable[Simulated]) -> dict[Simulated, NDArray[np.int64]]:
        """Return the contacts at the last build, (C, 3): disks by place, and tick."""
        (held,) = self._copy("held")
        most = held.max(initial=0)
        open, began = (self.card[name][:most].copy_to_host() for name in ("open", "began"))
        found = {}
        for run in runs:
            there = np.arange(most)[:, None] < held[run.place]
            i, j = np.nonzero(there.T)[0], open[:, run.place].T[there.T]
            found[run] = np.column_stack([i, j, began[:, run.place].T[there.T]])[i < j]
        return found

    def save(self, runs: Sequence[Simulated]) -> None:
        """Build new lists; the checkpoint waits in each run. Large runs are sorted in space at every unit of strain."""
        before, done = {run: run.seen for run in runs}, self.build(runs)
        contacts = self.contacts(runs)
        for run in runs if self.wide else ():
            if math.floor(run.strain) == run.sorted:
                continue
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

    def settle(self, runs: Sequence[Simulated]) -> None:
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
    """A launch: strains (K + 1,), rates (K + 1,), END, BULK, COUNTED (:mod:`petscjam.md.cuda_kernels`).

    ``tick`` counts from the beginning of the present step.
    """

    strains: Sequence[float] | Array
    rates: Sequence[float] | Array
    end: int
    bulk: int = 0
    counted: int = 0
    tick: int = 0


class Job:
    """Steps that a run has to make, with its present strain and rate before the first."""

    def __init__(self, run: Simulated, request: Advance) -> None:
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
        end, tick = len(self.fine) - 1 - self.made, self.made % self.parts * (TICKS // self.parts)
        return Course(self.at[self.made :], self.fine[self.made :], end, self.bulk, self.counted, tick)

    def took(self, done: NDArray[np.int64], sums: Array) -> None:
        """Count what a launch has made.

        Parameters
        ----------
        done, sums : arrays
            Results and sums of the launch (:mod:`petscjam.md.cuda_kernels`).
        """
        run, end = self.run, self.made + int(done[card.MADE])
        if end % self.parts:
            done[card.DEMAND] = self.parts  # until the step is complete
        steps = end // self.parts - self.made // self.parts
        run.took(end - self.made, self.parts, steps, done, sums)
        self.made, self.counted = end, int(done[card.HALFWAY])
        if done[card.CHANGED]:
            self.fine[end] = self.fine[end + 1]
        run.strain, run.rate = float(self.at[end]), float(self.fine[end])
        self.strains, self.rates = self.strains[steps:], self.rates[steps:]
        if run.parts != self.parts and end % self.parts == 0:  # another division from here on
            self.made, self.at, self.fine = 0, self.at[end : end + 1], self.fine[end : end + 1]


def multiprocessors() -> int:
    """Return the number of multiprocessors of the card."""
    return 1 if card.SIMULATED else int(cuda.get_current_device().MULTIPROCESSOR_COUNT)


def free_memory() -> float:
    """Return the free memory of the card, in bytes."""
    return math.inf if card.SIMULATED else float(cuda.current_context().get_memory_info().free)


def places(n: int) -> int:
    """Return the number of runs of ``n`` disks that the card advances at the same time."""
    return 1 if n > MOST else multiprocessors() * max(1, THREADS[0] // (-(-n // 32) * 32))
