"""The parameters of a figure, from a preset of its TOML file."""

from __future__ import annotations

from argparse import ArgumentTypeError
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from petscjam.base.arguments import points, seeds
from petscjam.base.errors import InputError, shown
from petscjam.base.types import Array


@dataclass(frozen=True)
class Parameters:
    """The parameters of a preset; ``parameters[name]`` is a number, or the list of seeds.

    Attributes
    ----------
    figure, preset : str
    values : dict
        As in the file.
    """

    figure: str
    preset: str
    values: Mapping[str, Any]

    def __getitem__(self, name: str) -> Any:
        """Return a number, or the list of seeds.

        Raises
        ------
        InputError
            If the preset lacks it, or it is neither.
        """
        value = self._given(name)
        if name == "seeds":
            return self._parsed(seeds, name, str(value))
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise InputError(f"{self.figure}: {name} must be a number, not {shown(value)}")
        return value

    def points(self, name: str) -> Array:
        """Return a list of numbers above 0; ``A:B:N`` stands for points, evenly in the logarithm.

        Raises
        ------
        InputError
            If the preset lacks it, or it is not such a list.
        """
        value = self._given(name)
        text = ",".join(map(str, value)) if isinstance(value, list) else str(value)
        return np.asarray(self._parsed(points, name, text))

    def check(self, known: Mapping[str, Any]) -> None:
        """Raise an error if parameters are missing, unknown, or of another kind than the ``known`` ones.

        Raises
        ------
        InputError
            It names the parameter.
        """
        expected, given = set(known), set(self.values)
        for what, keys in (("lacks", expected - given), ("has the unknown", given - expected)):
            if keys:
                raise InputError(f"{self.figure}: the preset {self.preset} {what} {', '.join(sorted(keys))}")
        for name, like in known.items():
            value = self[name] if name == "seeds" or isinstance(like, int | float) else self.points(name)
            whole = all(isinstance(x, int) for x in (like if isinstance(like, list) else [like]))
            if whole and (np.asarray(value) % 1).any():
                raise InputError(f"{self.figure}: {name} must be whole, not {shown(value)}")

    def _given(self, name: str) -> Any:
        if name not in self.values:
            raise InputError(f"{self.figure}: the preset {self.preset} lacks {name}")
        return self.values[name]

    def _parsed(self, parse: Callable[[str], Any], name: str, text: str) -> Any:
        try:
            return parse(text)
        except ArgumentTypeError as error:
            raise InputError(f"{self.figure}: {name}: {error}") from None
