"""What the figures share: packings and results that are made once and kept, and a page on what was found."""

from __future__ import annotations

from argparse import ArgumentTypeError
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from petscjam.analysis.scaling import PowerFit, power_law
from petscjam.base.arguments import points, seeds
from petscjam.base.errors import InputError, SolverError, shown
from petscjam.base.files import write_atomically
from petscjam.base.progress import Report
from petscjam.base.types import Array
from petscjam.io.jobs import Analysis, Ensemble, analyse
from petscjam.io.results import read_results
from petscjam.parallel.comm import on_root
from petscjam.plots.figure import given
from petscjam.preparation.library import prepare_library, read_library
from petscjam.rows.damping import DampingLaw


@dataclass(frozen=True)
class Finding:
    """A number of the paper, as found here: its standard error, and what the paper says."""

    name: str
    value: float
    error: float
    paper: str
    remark: str = ""


@dataclass
class Study:
    """One figure in the making.

    Attributes
    ----------
    name, preset : str
    parameters : dict
        Of the preset.
    folder : Path
    comm : communicator
    overwrite : bool
        Make results anew; packings are kept all the same.
    existing : bool
        Prepare no packings: go on with those that are there.
    progress, log : callable
    findings : list of Finding
    tallies : list of str
        How many packings there were of each kind, and how many were left out.
    checksums : dict
        Of the packings.
    """

    name: str
    preset: str
    parameters: Mapping[str, Any]
    folder: Path
    comm: Any
    overwrite: bool = False
    existing: bool = False
    progress: Report | None = None
    log: Callable[[str], None] = print
    findings: list[Finding] = field(default_factory=list)
    tallies: list[str] = field(default_factory=list)
    checksums: dict[Path, str] = field(default_factory=dict)

    def __getitem__(self, parameter: str) -> Any:
        """Return a number, or the list of seeds.

        Raises
        ------
        InputError
            If the preset lacks it, or it is none.
        """
        value = self._asked(parameter)
        if parameter == "seeds":
            return self._parsed(seeds, parameter, str(value))
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise InputError(f"{self.name}: {parameter} must be a number, not {shown(value)}")
        return value

    def check(self, known: Mapping[str, Any]) -> None:
        """Refuse parameters of other kinds than the ``known`` ones, before any work."""
        for name, like in known.items():
            value = self[name] if name == "seeds" or isinstance(like, int | float) else self.points(name)
            whole = all(isinstance(x, int) for x in (like if isinstance(like, list) else [like]))
            if whole and (np.asarray(value) % 1).any():
                raise InputError(f"{self.name}: {name} must be whole, not {shown(value)}")

    def points(self, parameter: str) -> Array:
        """Return a list of numbers above 0; ``A:B:N`` stands for points, evenly in the logarithm.

        Raises
        ------
        InputError
            If the preset lacks it, or it is no such list.
        """
        value = self._asked(parameter)
        text = ",".join(map(str, value)) if isinstance(value, list) else str(value)
        return np.asarray(self._parsed(points, parameter, text))

    def _asked(self, parameter: str) -> Any:
        if parameter not in self.parameters:
            raise InputError(f"{self.name}: the preset {self.preset} lacks {parameter}")
        return self.parameters[parameter]

    def _parsed(self, parse: Callable[[str], Any], parameter: str, text: str) -> Any:
        try:
            return parse(text)
        except ArgumentTypeError as error:
            raise InputError(f"{self.name}: {parameter}: {error}") from None

    def packings(self, particles: int, pressures: Iterable[float]) -> list[Path]:
        """Return the packings of this size and these pressures, made if need be, less those not proved."""
        wanted, own = [float(f"{p:.12g}") for p in pressures], self["seeds"]
        folder = self.folder / "packings"
        if self.existing:
            library = on_root(self.comm, read_library, folder)
        else:
            library = prepare_library(
                folder, [particles], wanted, own, comm=self.comm, resume=True, progress=self.progress
            )
        rows = [r for r in library.rows if r["particles"] == particles and r["target"] in wanted and r["seed"] in own]
        proved = {library.folder / r["file"]: r["checksum"] for r in rows if r["proved"]}
        if not proved:
            raise InputError(f"{self.name}: no proved packing of {particles} disks in {folder}")
        self.checksums |= proved
        missing = len(wanted) * len(own) - len(proved)
        self.tallies.append(
            f"{len(proved)} packings: N = {particles}; "
            f"p = {', '.join(f'{p:.3g}' for p in wanted)}; {len(own)} seeds. "
            f"Left out because not there or not proved minima: {missing}."
        )
        return list(proved)

    def results(
        self,
        files: Sequence[Path],
        analysis: Analysis,
        laws: Sequence[DampingLaw | None] = (None,),
        prestress: Sequence[bool] = (True,),
        *,
        tag: str = "",
    ) -> dict[str, Any]:
        """Return the results of an analysis of packings by name, made if need be; on rank 0 alone.

        Parameters
        ----------
        files : sequence of Path
            As :meth:`packings` gives them.
        analysis : Analysis
        laws, prestress : sequences
            As for :class:`petscjam.io.jobs.Ensemble`.
        tag : str
            The results are kept in ``NAME-TAG.h5``.

        Raises
        ------
        InputError
            If the file holds results that were made with other settings.
        SolverError
            If there is no result.
        """
        output = self.folder / f"{self.name}{tag and '-'}{tag}.h5"
        ensemble = Ensemble(files, output, laws, prestress, resume=not self.overwrite, overwrite=self.overwrite)
        _, failures = analyse(ensemble, analysis, comm=self.comm, progress=self.progress, log=self.log)
        if failures and not on_root(self.comm, output.exists):
            raise SolverError("; ".join(failures))
        if failures:
            self.tallies.append(f"{len(failures)} results failed: {'; '.join(failures)}")
        wanted = {self.checksums[file] for file in files}
        results: dict[str, Any] = {}
        on_root(self.comm, lambda: results.update(read_results(output)))  # they may be large
        return {name: r for name, r in results.items() if r.origin.checksum in wanted}

    def tally(self, results: Mapping[str, Any], what: str) -> dict[str, Any]:
        """Return the stable results, and say how many were left out at each pressure. Collective.

        Raises
        ------
        SolverError
            If there are results, and none is stable.
        """
        kept = {name: r for name, r in results.items() if r.stable}
        packings: dict[str, set[str]] = {}
        lost: dict[str, set[str]] = {}
        for r in results.values():
            key = f"N = {r.origin.particles}, p = {r.origin.pressure:.3g}, {given(r.prestress)}"
            for kind in [packings] + [lost] * (not r.stable):
                kind.setdefault(key, set()).add(r.origin.checksum)
        gone = "; ".join(f"{key}: {len(lost[key])} of {len(packings[key])}" for key in sorted(lost))
        self.tallies.append(f"{what}: packings left out as unstable (G0 ≤ 0 or negative modes): {gone or 'none'}.")
        if self.comm.bcast(bool(results) and not kept):
            raise SolverError(f"{self.name}: {what}: none of {len(results)} results is stable")
        return kept

    def exponent(
        self, name: str, x: Any, samples: Any, paper: str, window: tuple[float, float] | None = None, **options: Any
    ) -> PowerFit | None:
        """Fit a power law and note its exponent; None, with a remark, where it cannot be fitted.

        An x with a single packing does not count.
        """
        several = [m for m, some in enumerate(samples) if len(some) > 1]
        try:
            fit = power_law(np.asarray(x)[several], [samples[m] for m in several], window, **options)
        except InputError as error:
            self.findings.append(Finding(name, np.nan, np.nan, paper, str(error)))
            return None
        low, high = fit.window
        quality = "" if np.isnan(fit.chi2) else f", χ² = {fit.chi2:.1f}"
        self.findings.append(Finding(name, fit.exponent, fit.error, paper, f"x from {low:.3g} to {high:.3g}{quality}"))
        return fit

    def collapsed(self, name: str, find: Callable[[], Any], paper: Mapping[str, str]) -> Any:
        """Note the exponents of a collapse; None, with a remark, where nothing collapses."""
        try:
            found = find()
        except (InputError, SolverError) as error:
            self.findings.append(Finding(name, np.nan, np.nan, ", ".join(paper.values()), str(error)))
            return None
        for key, value in found.exponents.items():
            remark = f"quality S = {found.quality:.1f}"
            self.findings.append(Finding(f"{name}: {key}", value, found.errors[key], paper[key], remark))
        return found

    def page(self, command: str) -> str:
        """Return what was found by ``command``, as Markdown."""
        lines = [f"Made by `{command}`.", ""]
        if self.findings:
            lines += ["| quantity | here | paper | |", "|---|---|---|---|"]
            for f in self.findings:
                value = "—" if np.isnan(f.value) else f"{f.value:.3g}"
                value += "" if np.isnan(f.error) else f" ± {f.error:.1g}"
                lines.append(f"| {f.name} | {value} | {f.paper} | {f.remark} |")
            how = "of exponents and collapses by bootstrap, of lengths by jackknife, of local slopes and means"
            lines += ["", f"± is the standard error over packings: {how} from their scatter.", ""]
        lines += [f"- {tally}" for tally in self.tallies]
        lines += ["", "| parameter | |", "|---|---|"]
        lines += [f"| {key} | {value} |" for key, value in self.parameters.items()]
        return "\n".join([*lines, ""])

    def write(self, command: str) -> None:
        """Write the page."""
        write_atomically(self.folder / f"{self.name}.md", self.page(command).encode())
