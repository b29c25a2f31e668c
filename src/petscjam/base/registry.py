"""Named things, to which other packages add theirs by entry points."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from importlib.metadata import EntryPoint, entry_points
from typing import Generic, TypeVar

T = TypeVar("T")


class Registry(MutableMapping[str, T], Generic[T]):
    """A dictionary that also has the entry points of a group, which are loaded when it is first read.

    An entry point that cannot be loaded, or has the name of an own entry, is left out with a warning.

    Parameters
    ----------
    own : mapping
        The entries of petscjam.
    group : str
        As ``petscjam.damping``.
    load : callable
        The entry of an entry point. It raises an exception if this is not possible.
    """

    def __init__(self, own: Mapping[str, T], group: str, load: Callable[[EntryPoint], T]) -> None:
        self._entries, self._group, self._load, self._loaded = dict(own), group, load, False

    def _all(self) -> dict[str, T]:
        if not self._loaded:
            self._loaded = True  # first: a package may read the registry while it is loaded
            for point in entry_points(group=self._group):
                where = f"{point.dist.name if point.dist else 'a package'}: {self._group} {point.name} = {point.value}"
                if point.name in self._entries:
                    warnings.warn(f"{where}: this name is taken", RuntimeWarning, stacklevel=3)
                    continue
                try:
                    self._entries[point.name] = self._load(point)
                except Exception as error:
                    text = f"{where} cannot be loaded: {' '.join(str(error).split()) or type(error).__name__}"
                    warnings.warn(text, RuntimeWarning, stacklevel=3)
        return self._entries

    def __getitem__(self, name: str) -> T:
        return self._all()[name]

    def __setitem__(self, name: str, entry: T) -> None:
        self._entries[name] = entry

    def __delitem__(self, name: str) -> None:
        del self._entries[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._all())

    def __len__(self) -> int:
        return len(self._all())


def loaded(kind: type[T]) -> Callable[[EntryPoint], T]:
    """Return the function that loads an object of ``kind``, and refuses any other."""

    def load(point: EntryPoint) -> T:
        found = point.load()
        if not isinstance(found, kind):
            raise TypeError(f"it is a {type(found).__name__}, not a {kind.__name__}")
        return found

    return load
