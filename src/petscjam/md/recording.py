"""Recording of a run: time series, blocks, and a file that is complete at every moment."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import suppress
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.base.errors import InputError
from petscjam.base.files import atomic_h5, group, marked
from petscjam.base.interrupt import check
from petscjam.base.progress import Report
from petscjam.base.types import Array
from petscjam.md.engine import CONTACTS, SAMPLED, Advance, Engine
from petscjam.md.frames import frames_of, write_frame
from petscjam.md.observables import (
    BLOCKS,
    CHECKPOINT,
    ROWS,
    ROWS_PER_BLOCK,
    SAMPLES,
    AbsentError,
    BlockSums,
    Interval,
    Observed,
)
from petscjam.md.protocols import Protocol
from petscjam.md.result import MISSED, Run, check_arrays, write_run
from petscjam.md.settings import Settings

if TYPE_CHECKING:
    import h5py

EVERY = 30.0  # seconds between two checkpoints on disk
Steps = Generator[Advance, None, Run]  # of a run, which it returns


class Recorder:
    """Rows and blocks of the current run.

    Parameters
    ----------
    settings : Settings
    engine : Engine
        At the start, or at the end of ``run``.
    run, saved : Run and mapping, optional
        The run to continue, and its checkpoint; the recorded observables are those of ``run``.

    Raises
    ------
    InputError
        If ``run`` has an observable that is unknown.
    """

    def __init__(
        self, settings: Settings, engine: Engine, run: Run | None = None, saved: Mapping[str, Any] | None = None
    ) -> None:
        self.settings = settings
        self.layers = max(4, int(engine.height))
        self.rows: dict[str, list[float]] = {name: [] for name in ROWS}
        self.blocks: dict[str, list[Array]] = {name: [] for name in BLOCKS}
        self.saved = dict(saved or {})
        self.state, self.block = engine.state, BlockSums.empty(self.layers)
        if run is not None:
            if unknown := (run.rows.keys() - ROWS.keys()) | (run.blocks.keys() - BLOCKS.keys()):
                raise InputError(f"holds observables that are unknown here: {', '.join(sorted(unknown))}")
            closed = len(run.strain) // ROWS_PER_BLOCK
            self.rows = {name: values.tolist() for name, values in run.rows.items()}
            self.blocks = {name: list(values[:closed]) for name, values in run.blocks.items()}
            self.block = BlockSums.restored(self.saved)

    def fill(
        self,
        engine: Engine,
        protocol: Protocol,
        total: int,
        output: str | PathLike[str] | None,
        frames: int,
        progress: Report | None,
    ) -> Steps:
        """Advance to step ``total`` of ``protocol``; write a checkpoint every 30 s, and at the end.

        The file ends with the last complete row, also after an error or a signal. This is a generator: it yields
        steps before the engine makes them, so that an engine can make those of many runs together.

        Parameters
        ----------
        engine : Engine
        protocol : Protocol
        total : int
            Time steps.
        output : path
            File of the run.
        frames : int
            Total number of snapshots, evenly spaced.
        progress : callable
            See :mod:`petscjam.base.progress`.

        Yields
        ------
        Advance

        Returns
        -------
        Run
        """
        row_steps = self.settings.row_steps
        count = -(-total // row_steps)
        began, written, first = time.monotonic(), time.monotonic(), engine.steps
        try:
            yield Advance(engine, np.empty(0), np.empty(0), protocol.bulk, False)
            while engine.steps < total:
                yield from self._row(engine, protocol, min(row_steps, total - engine.steps))
                row = len(self.rows["time"])
                if row % ROWS_PER_BLOCK == 0:
                    self._close_block()
                self.saved = self._checkpoint(engine)
                if output is not None and row * frames // count > (row - 1) * frames // count:
                    write_frame(self.state, frames_of(output), row * frames // count)
                if output is not None and time.monotonic() - written > EVERY:
                    self.write(output)
                    written = time.monotonic()
                if progress is not None:
                    speed = (engine.steps - first) * len(engine) / (time.monotonic() - began)
                    text = f"{self._text()}, {speed / 1e6:.0f} million disk steps a second"
                    progress(engine.steps / total, text)
                check()
        except BaseException:  # remove the contribution of an incomplete row to the block
            if self.saved:
                self.block = BlockSums.restored(self.saved)
            raise
        finally:
            if output is not None and self.saved:
                self.write(output)
        return self.run

    def _row(self, engine: Engine, protocol: Protocol, steps: int) -> Iterator[Advance]:
        before, rebuilds, substeps = sum(engine.energy()), engine.rebuilds, engine.substeps
        edges = np.linspace(0, steps, min(SAMPLES, steps) + 1).astype(int)
        samples, sums, mean_rate = len(edges) - 1, np.zeros(SAMPLED), 0.0
        sampled = {name: 0.0 for name in self.rows if ROWS[name].sample}
        for k in range(samples):
            at = engine.steps + np.arange(edges[k + 1] - edges[k])
            rates = protocol.rates((at + 0.5) * engine.dt)
            strains = np.cumsum(np.concatenate([[engine.strain], rates * engine.dt]))[1:]
            yield Advance(engine, strains, rates, protocol.bulk, k == samples - 1)
            engine.advance(strains, rates, protocol.bulk)
            mean_rate += rates.sum() / steps
            sums += self._sample(engine, sampled)
        parts, totals = engine.most, engine.collect()
        self.block.angles += totals.angles
        interval = Interval(
            disks=len(engine),
            area=engine.length * engine.height,
            dt=engine.dt,
            time=engine.time,
            strain=engine.strain,
            rate=mean_rate,
            steps=steps,
            substeps=engine.substeps - substeps,
            parts=parts,
            rebuilds=engine.rebuilds - rebuilds,
            totals=totals,
            samples=samples,
            sums=sums,
            before=before,
            energy=sum(engine.energy()),
            sampled={name: value / samples for name, value in sampled.items()},
        )
        for name, values in self.rows.items():
            values.append(float(ROWS[name].value(interval, name)))

    def _sample(self, engine: Engine, sampled: dict[str, float]) -> Array:
        """Add a sample to the block and to ``sampled``; return its sums."""
        block = self.block
        sums = engine.sample(block.layers, block.moments, block.scatter[block.looked[0]])
        block.looked += 1, int(sums[CONTACTS])
        taken = {name: sample for name in self.blocks if (sample := BLOCKS[name].sample)}
        if sampled or taken:
            state = engine.state
            rows = {name: sample for name in sampled if (sample := ROWS[name].sample)}
            for name, take in rows.items():
                sampled[name] += take(state)
            for name, sample in taken.items():
                block.sampled[name] = block.sampled.get(name, 0.0) + np.asarray(sample(state), dtype=float)
        return sums

    def _closed(self) -> dict[str, Array]:
        self.block.strain = self.rows["strain"][-1]
        return {name: np.array(BLOCKS[name].value(self.block, name), dtype=float) for name in self.blocks}

    def _close_block(self) -> None:
        for name, value in self._closed().items():
            self.blocks[name].append(value)
        self.block = BlockSums.empty(self.layers)

    def _checkpoint(self, engine: Engine) -> dict[str, Any]:
        saved = engine.checkpoint() | self.block.arrays
        self.state = engine.state
        return saved

    def _text(self) -> str:
        """Return a line on the progress of the run, from the observables that it records."""
        rows = Observed(self.rows)
        text = f"strain {rows['strain'][-1]:.4g}"
        with suppress(AbsentError):
            pressure = (rows["elastic_xx"][-1] + rows["elastic_yy"][-1]) / 2
            text += f", P_el {pressure:.3g}, Z {rows['contacts'][-1]:.3g}"
            heat, missed = sum(rows["heat"]), sum(rows["imbalance"])
            if 0 < MISSED * heat < abs(missed):
                text += f", budget misses {abs(missed / heat):.1%} of the heat"
        return text

    @property
    def run(self) -> Run:
        """The run so far; the last block may be shorter."""
        blocks = {name: list(values) for name, values in self.blocks.items()}
        if self.block.looked[0]:
            for name, value in self._closed().items():
                blocks[name].append(value)
        return Run(
            self.settings,
            {name: np.array(values) for name, values in self.rows.items()},
            {name: np.array(values) for name, values in blocks.items()},
            self.state,
        )

    def write(self, output: str | PathLike[str]) -> None:
        """Replace the file, completely or not at all."""
        with atomic_h5(output) as h5:
            write_run(h5, self.run)
            node = group(h5, "checkpoint")
            for name, value in self.saved.items():
                node[name] = value


def read_checkpoint(h5: h5py.Group, shapes: Mapping[str, str]) -> dict[str, Any]:
    """Return the checkpoint (:meth:`Recorder.write`) of an open HDF5 file.

    Parameters
    ----------
    h5 : file
    shapes : mapping
        Axes of the arrays of the engine, :attr:`petscjam.md.engine.Engine.CHECKPOINT`.

    Raises
    ------
    InputError
        If something is missing or damaged.
    """
    saved = {name: h5["checkpoint"][name][()] for name in h5["checkpoint"]}
    whole = {"tag", "contacts", "counts", "block_angles"}
    if "block_looked" in saved and saved["block_looked"].dtype.kind == "i":  # older files also have floats
        whole.add("block_looked")
    if marked(h5)[1] == 2:
        saved["height"] = saved["numbers"][:1]
    check_arrays("checkpoint", {**shapes, **CHECKPOINT}, saved, {"block_scatter"}, whole)
    return saved
