"""The page of a figure: results for the numbers of the paper, and the packings used."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from csv import writer
from dataclasses import dataclass, field
from io import StringIO
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from petscjam.analysis.scaling import Collapse, PowerFit, power_law
from petscjam.analysis.statistics import means
from petscjam.base.errors import InputError, SolverError


@dataclass(frozen=True)
class Finding:
    """A number of the paper: our value, its standard error, and the value of the paper."""

    name: str
    value: float
    error: float
    paper: str
    remark: str = ""

    @property
    def digits(self) -> int:
        """Digits of the value on the page: at least three, and those above the error, up to six."""
        if not (self.error > 0 and self.value):
            return 3
        return int(np.clip(np.floor(np.log10(abs(self.value))) - np.floor(np.log10(self.error)) + 1, 3, 6))


class Number(NamedTuple):
    """A number of the picture: quantity, x, value, its standard error, and the value of the paper."""

    quantity: str
    x: float
    value: float
    error: float
    paper: str = ""


@dataclass
class Page:
    """The results of a figure.

    Attributes
    ----------
    findings : list of Finding
    numbers : list of Number
        Of the picture, for the table NAME.csv.
    tallies : list of str
        Numbers of packings of each kind, and of those left out.
    """

    findings: list[Finding] = field(default_factory=list)
    numbers: list[Number] = field(default_factory=list)
    tallies: list[str] = field(default_factory=list)

    def mean(self, name: str, samples: ArrayLike, paper: str, remark: str = "") -> None:
        """Note the mean of (k,) ``samples`` and its standard error.

        Parameters
        ----------
        name, paper, remark : str
            As in :class:`Finding`.
        samples : (k,)
        """
        (value,), (error,) = means([samples])
        self.found(name, float(value), float(error), paper, remark)

    def found(self, name: str, value: float, error: float, paper: str, remark: str = "") -> None:
        """Note a number and its standard error.

        Parameters
        ----------
        name : str
        value, error : float
        paper, remark : str
            As in :class:`Finding`.
        """
        self.findings.append(Finding(name, value, error, paper, remark))

    def number(self, quantity: str, x: float, value: float, error: float, paper: str = "") -> None:
        """Add a number of the picture to the table.

        Parameters
        ----------
        quantity : str
        x, value, error : float
        paper : str
        """
        self.numbers.append(Number(quantity, x, value, error, paper))

    @property
    def table(self) -> str:
        """The findings and the numbers of the picture as CSV."""
        text = StringIO()
        rows = writer(text, lineterminator="\n")
        rows.writerow(Number._fields)
        rows.writerows([f.name, "", f.value, f.error, f.paper] for f in self.findings)
        rows.writerows(self.numbers)
        return text.getvalue()

    def exponent(
        self,
        name: str,
        x: ArrayLike,
        samples: Sequence[ArrayLike],
        paper: str,
        window: tuple[float, float] | None = None,
        *,
        estimator: str = "mean",
    ) -> PowerFit | None:
        """Fit a power law and note its exponent.

        Parameters
        ----------
        name, paper : str
            As in :class:`Finding`.
        x : (m,)
        samples : m array_likes
            The values of the packings at each x. An x with a single packing is left out.
        window : (float, float), optional
            Fit x between these.
        estimator : str
            ``mean`` or ``median`` over packings.

        Returns
        -------
        PowerFit or None
            None if no power law can be fitted: then a remark has the reason.
        """
        several = [m for m, some in enumerate(samples) if len(np.atleast_1d(some)) > 1]
        try:
            fit = power_law(np.asarray(x)[several], [samples[m] for m in several], window, estimator=estimator)
        except InputError as error:
            self.findings.append(Finding(name, np.nan, np.nan, paper, str(error)))
            return None
        low, high = fit.window
        quality = "" if np.isnan(fit.chi2) else f", χ² = {fit.chi2:.1f}"
        self.findings.append(Finding(name, fit.exponent, fit.error, paper, f"x from {low:.3g} to {high:.3g}{quality}"))
        return fit

    def collapse(self, name: str, find: Callable[[], Collapse], paper: Mapping[str, str]) -> Collapse | None:
        """Note the exponents of a collapse.

        Parameters
        ----------
        name : str
        find : callable
            Calls :func:`petscjam.analysis.scaling.collapse`.
        paper : dict
            The value of each exponent in the paper.

        Returns
        -------
        Collapse or None
            None if there is no collapse: then a remark has the reason.
        """
        try:
            found = find()
        except (InputError, SolverError) as error:
            self.findings.append(Finding(name, np.nan, np.nan, ", ".join(paper.values()), str(error)))
            return None
        for key, value in found.exponents.items():
            remark = f"quality S = {found.quality:.1f}"
            self.findings.append(Finding(f"{name}: {key}", value, found.errors[key], paper[key], remark))
        return found

    def text(self, command: str, parameters: Mapping[str, Any]) -> str:
        """Return the page as Markdown.

        Parameters
        ----------
        command : str
            The command of the figure.
        parameters : dict
            Of the preset.
        """
        lines = [f"Made by `{command}`.", ""]
        if self.findings:
            lines += ["| quantity | here | paper | |", "|---|---|---|---|"]
            for f in self.findings:
                value = "—" if np.isnan(f.value) else f"{f.value:.{f.digits}g}"
                value += "" if np.isnan(f.error) else f" ± {f.error:.1g}"
                lines.append(f"| {f.name} | {value} | {f.paper} | {f.remark} |")
            how = "of exponents, collapses and transitions by bootstrap, of lengths by jackknife, of slopes and means"
            lines += ["", f"± is the standard error over packings or seeds: {how} from their scatter.", ""]
        lines += [f"- {tally}" for tally in self.tallies]
        lines += ["", "| parameter | |", "|---|---|"]
        lines += [f"| {key} | {value} |" for key, value in parameters.items()]
        return "\n".join([*lines, ""])
