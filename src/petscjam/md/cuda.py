"""The engine for a GPU: many runs of one size side by side, one block each, or one large run by the whole card.

The launches of a run are the same in any company (:mod:`petscjam.md.cuda_batch`), so its numbers are, too.

Axes: i disk, x Cartesian, k step.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib.util import find_spec
from typing import Any, ClassVar, TypeVar

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.base.errors import InputError, MissingError, SolverError
from petscjam.base.interrupt import check
from petscjam.base.types import Array
from petscjam.md import kernels
from petscjam.md.engine import (
    CONTACTS,
    JUMPS,
    KXX,
    KYY,
    NORMAL2,
    SAMPLED,
    SUMS,
    TANGENTIAL2,
    TICKS,
    TOUCHING,
    Advance,
    Totals,
)
from petscjam.md.model import Model
from petscjam.md.neighbours import order_in_space, wrap
from petscjam.md.recording import Steps
from petscjam.md.result import Run
from petscjam.md.simulation import BALANCE, SKINS, Simulation, masses_of, saved_engine, saved_state, widest_skin
from petscjam.md.state import State

simulated: bool = numba.config.ENABLE_CUDASIM  # type: ignore[attr-defined]
if not simulated and find_spec("numba_cuda") is None:
    raise MissingError("shear: the engine cuda needs numba-cuda: pip install 'petscjam[cuda]'")
os.environ.setdefault("NUMBA_CUDA_LOW_OCCUPANCY_WARNINGS", "0")  # one run is one block
try:
    from numba import cuda

    from petscjam.md import cuda_kernels as card
    from petscjam.md.cuda_batch import MOST, Batch, Saved, Seen, places

    if not cuda.is_available():
        raise RuntimeError("there is no NVIDIA GPU, or no driver for it")
except Exception as error:
    raise InputError(f"shear: the engine cuda cannot start: {' '.join(str(error).split())}") from None

T = TypeVar("T")


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
    MOST: ClassVar[int] = MOST
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
        self.turned = None if state.angles is None else state.angles.copy()  # angles of the disks
        self.contacts, self.sorted = np.empty((0, 3), np.int64), np.floor(self.strain)
        self.steps = self.rebuilds = self.substeps = 0
        self.parts = self.divided = self.most = 1
        self.total, self.start = np.zeros(SUMS), np.empty(0)
        self.settled = self.ahead = False
        self.batch: Batch | None = None
        self.seen: Seen | None = None
        self.counted: Seen | None = None  # its contacts are those before the ones of the last step were counted
        self.saved: Saved | None = None
        self.error: Exception | None = None
        self.place = self.gather = 0
        if self.wide:
            wrap(self.q, self.length, self.height, self.strain, self.rate)
            self.sort(self.q, self.contacts)

    def __len__(self) -> int:
        return len(self.tag)

    def sort(self, q: Array, contacts: NDArray[np.int64]) -> None:
        """Sort the disks in space.

        Parameters
        ----------
        q : (N, 5)
        contacts : (C, 3)
            By place, with their ticks.
        """
        order = order_in_space(q, self.length, self.height)
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        self.q, self.R, self.m, self.tag = q[order], self.R[order], self.m[order], self.tag[order]
        self.turned = None if self.turned is None else self.turned[order]
        self.contacts = np.column_stack([place[contacts[:, :2]], contacts[:, 2]])
        self.sorted = np.floor(self.strain)

    @property
    def kind(self) -> tuple[Any, ...]:
        """What runs of a batch have in common."""
        return len(self), self.integrator, self.model.potential, self.model.film is None

    @property
    def numbers(self) -> list[float]:
        """Its row of ``numbers`` (:mod:`petscjam.md.cuda_kernels`)."""
        law = self.model
        friction = [law.normal, law.tangential, float(law.rolls), law.body, law.rotational_drag]
        friction += law.film or (0.0, 0.0, 1.0)
        return [self.length, self.height, self.skin, 2 * float(self.R.max()), self.dt / self.parts, *friction]

    @property
    def cells(self) -> tuple[int, int]:
        """Columns and rows of cells, at most as many as disks."""
        edge, n = 2 * float(self.R.max()) + self.skin, len(self)
        columns = max(1, min(int(self.length / edge), int(np.sqrt(n * self.length / self.height))))
        rows = max(1, min(int(self.height / edge), n // columns))
        return columns, rows

    def check(self, rates: Array, bulk: int) -> None:
        """Refuse to scale velocities from a strain rate of 0.

        Parameters
        ----------
        rates : (K + 1,)
        bulk : int
            A value of ``BULK``.
        """
        if bulk == 1 and (rates[:-1] == 0).any() and (rates[1:] != rates[:-1]).any():
            text = "shear: velocities cannot be scaled from a strain rate of 0; choose another bulk"
            self.error = InputError(text)

    def leave(self) -> None:
        """Make room for another run."""
        if self.batch is not None:
            self.batch.drop(self)

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
        """Count what a launch has made.

        Parameters
        ----------
        made, parts, steps : int
            Parts of steps, parts of a step, complete steps.
        done, sums : arrays
            Results and sums of the launch (:mod:`petscjam.md.cuda_kernels`).
        """
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
        batch = self.at_home()
        if not self.settled:
            batch.settle([self])
        if self.error is not None:
            raise self.error
        if self.seen is None or not self.seen.closing:
            batch.see([self], [self])
        assert self.seen is not None
        self.counted = self.seen
        return self.seen.sums[:SUMS].copy()

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
        if self.seen is self.counted:
            self.seen = None
        sums, seen = np.zeros(SAMPLED), self.look
        kernels.sample_disks(seen.q, self.R, self.m, self.height, self.rate, layers, sums)
        y = seen.q[:, 1] / self.height
        layer = np.minimum(((y - np.floor(y)) * layers.shape[1]).astype(int), layers.shape[1] - 1)
        for k in range(3):
            layers[3 + k] += np.bincount(layer, seen.stress[k], layers.shape[1])
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
        place = np.argsort(self.tag)
        q, R = (self.q if self.batch is None else self.look.q)[place], self.R[place]
        cell, name = (self.length, self.strain, self.rate, self.time), self.model.potential.name
        angles = None if self.turned is None else self.turned[place]
        return State(q[:, :2], q[:, 2:4], q[:, 4] / R, R, *cell, name, self.height, angles)

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
        places = np.column_stack([self.tag[contacts[:, :2]], contacts[:, 2]])
        angles = {} if self.turned is None else {"angles": self.turned}
        arrays = {"q": self.seen.q, "radii": self.R, "masses": self.m, "contacts": places, "start": self.start}
        return saved_engine(self, **arrays, **angles)

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
        state = saved_state(saved, model)
        new = cls(state, model, dt, integrator, threads, saved["masses"])
        new.turned = None if state.angles is None else state.angles.copy()
        new.q, new.R, new.m, new.tag = (saved[name].copy() for name in ("q", "radii", "masses", "tag"))
        place = np.empty_like(new.tag)
        place[new.tag] = np.arange(len(new))
        new.contacts = np.column_stack([place[saved["contacts"][:, :2]], saved["contacts"][:, 2]])
        new.skin = float(saved["numbers"][-1])
        new.steps, new.rebuilds = (int(x) for x in saved["counts"])
        new.rebuilds -= 1
        new.start = saved["start"].copy()
        return new


def name() -> str:
    """Return the name of the card, and versions."""
    chip = "numba's simulator" if simulated else cuda.get_current_device().name
    chip = chip.decode() if isinstance(chip, bytes) else chip
    return f"{chip}, numba {numba.__version__}, numpy {np.__version__}"


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
        try:
            batch.work(some)
        except (InputError, SolverError) as error:
            for request in some:
                request.engine.error = error


def abreast(
    tasks: Iterable[T], begin: Callable[[T], Steps], done: Callable[[T, Run], None], rank: int = 0
) -> Iterator[tuple[T, InputError | SolverError]]:
    """Make many runs, as many at a time as the card has room for; yield those that fail, with their errors.

    Parameters
    ----------
    tasks : iterable
    begin : callable
        Returns the steps of the run of a task (:func:`petscjam.md.runs.begin`).
    done : callable
        Is called with each task and its complete run.
    rank : int
        Of this process on its node: each has another card, if there are several.

    Raises
    ------
    Interrupted
        On a signal; the file of each run ends with its last complete row.
    """
    if not card.SIMULATED:
        cuda.select_device(rank % len(cuda.gpus))
    failed: list[tuple[T, InputError | SolverError]] = []

    def step(task: T, steps: Steps) -> Advance | None:
        try:
            return next(steps)
        except StopIteration as end:
            done(task, end.value)
        except (InputError, SolverError) as error:
            failed.append((task, error))
        return None

    waiting, running = deque(tasks), dict[T, tuple[Steps, Advance]]()
    following: tuple[T, Steps, Advance] | None = None  # begun, but there is no room yet
    batch: Batch | None = None
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
                if batch is None or not (running or batch.kind == run.kind):
                    batch = None  # its memory is free
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
                if after is not None:
                    running[task] = steps, after
                else:
                    del running[task]
                    request.engine.leave()
        yield from failed
    finally:
        for steps, _ in running.values():
            steps.close()
        if following is not None:
            following[1].close()


CudaSimulation.abreast = staticmethod(abreast)
