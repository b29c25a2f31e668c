"""Flat tables, named columns of one length with units, as CSV, Parquet, DataFrame or HTML; objects that have one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from html import escape
from importlib import import_module
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from petscjam.base.errors import MissingError

if TYPE_CHECKING:
    import pandas as pd

LONGEST = 60  # characters of a value in HTML


@dataclass(frozen=True)
class Table:
    """Columns of one length. A number of a shorter table that others have is NaN, a text is empty.

    Attributes
    ----------
    columns : mapping of (R,) arrays
        By name.
    units : mapping of str
        Of the columns that have one.
    """

    columns: Mapping[str, Any]
    units: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    @classmethod
    def of_rows(cls, rows: Iterable[Mapping[str, Any]], units: Mapping[str, str] | None = None) -> Table:
        """Return the table of ``rows``: a column for each of their names.

        Parameters
        ----------
        rows : iterable of mappings
        units : mapping of str
        """
        rows = list(rows)
        names = dict.fromkeys(name for row in rows for name in row)
        return cls({name: _column([row.get(name) for row in rows]) for name in names}, units or {})

    @classmethod
    def stacked(cls, tables: Iterable[Table]) -> Table:
        """Return the rows of all ``tables``, one below the other."""
        tables = list(tables)
        names = dict.fromkeys(name for table in tables for name in table.columns)
        columns = {
            name: _column([x for table in tables for x in _values(table.columns.get(name, [None] * len(table)))])
            for name in names
        }
        return cls(columns, {name: unit for table in tables for name, unit in table.units.items()})

    def to_csv(self) -> bytes:
        """Return the table as CSV with 17 digits; the first lines, which start with #, have the units."""
        import csv
        from io import StringIO

        text = StringIO()
        text.writelines(f"# {name}: {self.units[name]}\n" for name in self.columns if self.units.get(name))
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows(zip(*(map(_written, column) for column in self.columns.values()), strict=True))
        return text.getvalue().encode()

    def to_parquet(self) -> bytes:
        """Return the table as Parquet; the units are metadata of the columns.

        Raises
        ------
        MissingError
            Without pyarrow.
        """
        pyarrow, parquet = optional("pyarrow", "tables"), optional("pyarrow.parquet", "tables")
        arrays = [pyarrow.array(_values(column)) for column in self.columns.values()]
        fields = [
            pyarrow.field(name, array.type, metadata={"unit": self.units.get(name, "")})
            for name, array in zip(self.columns, arrays, strict=True)
        ]
        file = BytesIO()
        parquet.write_table(pyarrow.table(arrays, schema=pyarrow.schema(fields)), file)
        return file.getvalue()

    def to_dataframe(self) -> pd.DataFrame:
        """Return a DataFrame of pandas; ``attrs["units"]`` has the units.

        Raises
        ------
        MissingError
            Without pandas.
        """
        frame = optional("pandas", "tables").DataFrame(dict(self.columns))
        frame.attrs["units"] = dict(self.units)
        return frame

    def html(self) -> str:
        """Return the table as HTML."""
        rows = zip(*(map(in_short, column) for column in self.columns.values()), strict=True)
        heads = [name + (f" ({self.units[name]})" if self.units.get(name, "1") != "1" else "") for name in self.columns]
        return html_table(rows, heads)


class Tabular:
    """An object with a line of text (``summary``), properties (``facts``) and a flat table (``flat``)."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        setattr(cls, "__repr__", Tabular.__repr__)  # noqa: B010 - a dataclass would write every array

    def facts(self) -> dict[str, Any]:
        """Return its properties by name, for a small table."""
        raise NotImplementedError

    def flat(self) -> Table:
        """Return its flat table."""
        raise NotImplementedError

    def to_dataframe(self) -> pd.DataFrame:
        """Return its flat table as a DataFrame of pandas.

        Raises
        ------
        MissingError
            Without pandas.
        """
        return self.flat().to_dataframe()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{name}: {in_short(x)}' for name, x in self.facts().items())})"

    def _repr_html_(self) -> str:
        return html_table(((name, in_short(x)) for name, x in self.facts().items()))


def optional(module: str, extra: str) -> Any:
    """Import an optional module.

    Parameters
    ----------
    module, extra : str
        The module, and the extra of petscjam that installs it.

    Raises
    ------
    MissingError
        If it is not there; the message names the extra.
    """
    try:
        return import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise MissingError(f'{package} is missing ({in_short(error)}): pip install "petscjam[{extra}]"') from None


def html_table(rows: Iterable[Iterable[str]], heads: Iterable[str] = ()) -> str:
    """Return rows of text as a table of HTML.

    Parameters
    ----------
    rows : iterable of rows
    heads : iterable of str
        Heads of the columns. Default: none, and the first column has the heads of the rows.
    """
    heads = list(heads)
    body = []
    for row in rows:
        cells = [f"<td>{escape(cell)}</td>" for cell in row]
        if not heads:
            cells[0] = cells[0].replace("td>", "th>")
        body.append(f"<tr>{''.join(cells)}</tr>")
    head = f"<thead><tr>{''.join(f'<th>{escape(name)}</th>' for name in heads)}</tr></thead>" if heads else ""
    return "\n".join(["<table>", *[head] * bool(head), "<tbody>", *body, "</tbody>", "</table>"])


def in_short(value: Any) -> str:
    """Return a value as text: numbers to five digits, long texts cut."""
    if value is None:
        return "—"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        return "—" if np.isnan(value) else f"{value:.5g}"
    text = " ".join(str(value).split())
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…"


def _column(values: list[Any]) -> Any:
    """Return values as an array: of numbers with NaN, or of objects with None, where one is missing."""
    known = [value for value in values if value is not None]
    if len(known) == len(values):
        return np.array(values, dtype=object if any(isinstance(x, str) for x in values) else None)
    if known and all(isinstance(x, float | int | np.number) and not isinstance(x, bool) for x in known):
        return np.array([np.nan if x is None else x for x in values], dtype=float)
    return np.array(values, dtype=object)


def _values(column: Any) -> list[Any]:
    values: list[Any] = column.tolist() if isinstance(column, np.ndarray) else list(column)
    return values


def _written(value: Any) -> str:
    if value is None or (isinstance(value, float) and np.isnan(value)):
        return ""
    return repr(float(value)) if isinstance(value, float | np.floating) else str(value)
