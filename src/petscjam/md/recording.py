"""The book of a run that is going on: time series, blocks, and a file that is whole at every moment."""

from __future__ import annotations

import time
from collections.abc import Mapping
from os import PathLike
from typing import Any

import numpy as np

from petscjam.base.files import atomic_h5, group
from petscjam.base.interrupt import check
from petscjam.base.progress import Report
from petscjam.base.types import Array
from petscjam.md import kernels
from petscjam.md.frames import frames_of, write_frame
from petscjam.md.kernels import BINS, TICKS
from petscjam.md.protocols import Protocol
from petscjam.md.result import BLOCKS, MISSED, ROWS, Run, write_run
from petscjam.md.simulation import Simulation

STRESSES = [name for name in ROWS if name.startswith(("elastic", "dissipative"))]  # as the kernel counts
KINETIC = [name for name in ROWS if name.startswith("kinetic")]
LOOKS = 5  # at disks and contacts, in each row
ROWS_PER_BLOCK = 50
EVERY = 30.0  # seconds between two checkpoints on disk


class Book:
    """Rows and blocks of a run that is going on."""

    def __init__(self, settings: dict[str, Any], simulation: Simulation) -> None:
        self.settings = settings
        self.layers = max(4, int(simulation.L))
        self.rows: dict[str, list[float]] = {name: [] for name in ROWS}
        self.blocks: dict[str, list[Array]] = {name: [] for name in BLOCKS}
        self.saved: dict[str, Any] = {}
        self._open_block()

    def _open_block(self) -> None:
        self._angles = np.zeros((2, BINS), np.int64)
        self._layers, self._moments = np.zeros((3, self.layers)), np.zeros((5, 4))
        self._scatter = np.full((LOOKS * ROWS_PER_BLOCK, 4), np.nan)
        self._looks = self._pairs = 0

    def fill(
        self,
        simulation: Simulation,
        protocol: Protocol,
        total: int,
        output: str | PathLike[str] | None,
        frames: int,
        progress: Report | None,
    ) -> Run:
        """Go on to step ``total`` of ``protocol``; write a checkpoint now and then, and at the end.

        Whatever ends it, the file is left with the last whole row.
        """
        row_steps = self.settings["row_steps"]
        count = -(-total // row_steps)
        began, written, first = time.monotonic(), time.monotonic(), simulation.steps
        try:
            while simulation.steps < total:
                steps = min(row_steps, total - simulation.steps)
                self._row(simulation, protocol, steps)
                row = len(self.rows["time"])
                if len(self.rows["time"]) % ROWS_PER_BLOCK == 0:
                    self._close_block()
                self.saved = self._checkpoint(simulation)
                if output is not None and row * frames // count > (row - 1) * frames // count:
                    write_frame(self._state, frames_of(output), row * frames // count)
                if output is not None and time.monotonic() - written > EVERY:
                    self.write(output)
                    written = time.monotonic()
                if progress is not None:
                    speed = (simulation.steps - first) * len(simulation.tag) / (time.monotonic() - began)
                    text = f"{self._text()}, {speed / 1e6:.0f} million disk steps a second"
                    progress(simulation.steps / total, text)
                check()
        except BaseException:
            self._take_back()
            raise
        finally:
            if output is not None and self.saved:
                self.write(output)
        return self.run

    def _take_back(self) -> None:
        """Forget what a row that was not finished added to the open block."""
        if self.saved:
            self._angles, self._layers, self._moments, self._scatter = (
                self.saved[f"block_{name}"].copy() for name in ("angles", "layers", "moments", "scatter")
            )
            self._looks, self._pairs = (int(x) for x in self.saved["block_looked"])

    def _row(self, s: Simulation, protocol: Protocol, steps: int) -> None:
        before, rebuilds, substeps = sum(s.energy()), s.rebuilds, s.substeps
        edges = np.linspace(0, steps, min(LOOKS, steps) + 1).astype(int)
        looked = np.zeros(7)
        mean_rate = 0.0
        for k in range(len(edges) - 1):
            at = s.steps + np.arange(edges[k + 1] - edges[k])
            rates = protocol.rates((at + 0.5) * s.dt)
            strains = np.cumsum(np.concatenate([[s.strain], rates * s.dt]))[1:]
            s.advance(strains, rates, protocol.bulk)
            mean_rate += rates.sum() / steps
            scatter = self._scatter[self._looks]
            looked += s.observe(self._layers, self._moments, scatter)
            self._looks += 1
        parts = s.most
        total, counts, angles = s.collect()
        self._angles += angles
        self._pairs += looked[6]
        n, V, looks, contacts = len(s.tag), s.L**2, len(edges) - 1, max(looked[6], 1.0)
        spin = looked[0] / (n * looks)
        mean = total / steps
        values = {
            "time": s.time,
            "strain": s.strain,
            "rate": mean_rate,
            **{name: mean[index] / V for index, name in enumerate(STRESSES)},
            **{name: mean[kernels.KXX + k] / V for k, name in enumerate(KINETIC)},
            "contacts": 2 * mean[kernels.TOUCHING] / n,
            "energy": sum(s.energy()),
            "work": total[kernels.WORK] * s.dt,
            "heat": total[kernels.HEAT] * s.dt,
            "jumps": total[kernels.JUMPS],
            "made": counts[0],
            "broken": counts[1],
            "duration": counts[2] * s.dt / TICKS,
            "spin": spin,
            "spin_variance": looked[1] / (n * looks) - spin**2,
            "dvx2": looked[2] / (n * looks),
            "vy2": looked[3] / (n * looks),
            "normal2": looked[4] / contacts,
            "tangential2": looked[5] / contacts,
            "steps": s.substeps - substeps,
            "parts": parts,
            "rebuilds": s.rebuilds - rebuilds,
        }
        values["imbalance"] = values["energy"] - before - values["work"] - values["jumps"] + values["heat"]
        for name in ROWS:
            self.rows[name].append(float(values[name]))

    def _block(self) -> dict[str, Array]:
        values = {
            "strain": self.rows["strain"][-1],
            "samples": self._looks,
            "making": self._angles[0],
            "breaking": self._angles[1],
            "layer_disks": self._layers[0],
            "layer_vx": self._layers[1],
            "layer_area": self._layers[2],
            "pairs": self._pairs,
            "first": self._moments[0],
            "second": self._moments[1:],
            "scatter": self._scatter,
        }
        return {name: np.array(values[name], dtype=float) for name in BLOCKS}

    def _close_block(self) -> None:
        for name, value in self._block().items():
            self.blocks[name].append(value)
        self._open_block()

    def _checkpoint(self, s: Simulation) -> dict[str, Any]:
        block = {
            "angles": self._angles,
            "layers": self._layers,
            "moments": self._moments,
            "scatter": self._scatter,
            "looked": np.array([self._looks, self._pairs], dtype=np.int64),
        }
        saved = {**s.checkpoint(), **{f"block_{name}": value.copy() for name, value in block.items()}}
        self._state = s.state
        return saved

    def _text(self) -> str:
        last = {name: values[-1] for name, values in self.rows.items()}
        pressure = (last["elastic_xx"] + last["elastic_yy"]) / 2
        heat, missed = (sum(self.rows[name]) for name in ("heat", "imbalance"))
        doubt = ""
        if 0 < MISSED * heat < abs(missed):
            doubt = f", budget misses {abs(missed / heat):.1%} of the heat"
        return f"strain {last['strain']:.4g}, P_el {pressure:.3g}, Z {last['contacts']:.3g}{doubt}"

    @property
    def run(self) -> Run:
        """What there is so far; the last block may be shorter."""
        blocks = {name: list(values) for name, values in self.blocks.items()}
        if self._looks:
            for name, value in self._block().items():
                blocks[name].append(value)
        return Run(
            dict(self.settings),
            {name: np.array(values) for name, values in self.rows.items()},
            {name: np.array(values) for name, values in blocks.items()},
            self._state,
        )

    def write(self, output: str | PathLike[str]) -> None:
        """Replace the file, wholly or not at all."""
        with atomic_h5(output) as h5:
            write_run(h5, self.run)
            node = group(h5, "checkpoint")
            for name, value in self.saved.items():
                node[name] = value

    @classmethod
    def reopened(cls, run: Run, saved: Mapping[str, Any], simulation: Simulation) -> Book:
        """Return the book of a checkpoint."""
        book = cls(dict(run.settings), simulation)
        book.rows = {name: values.tolist() for name, values in run.rows.items()}
        closed = len(run.strain) // ROWS_PER_BLOCK
        book.blocks = {name: list(values[:closed]) for name, values in run.blocks.items()}
        book.saved = dict(saved)
        book._take_back()
        book._state = run.state
        return book
