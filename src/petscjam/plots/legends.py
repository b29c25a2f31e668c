"""Colours, markers, labels and legends for the settings in which curves differ."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

import numpy as np

from petscjam.analysis.statistics import nominal
from petscjam.plots.figure import PALETTE, Colour
from petscjam.response.origin import Result
from petscjam.rows.damping import DampingLaw

if TYPE_CHECKING:
    from matplotlib.axes import Axes

R = TypeVar("R", bound=Result)
MARKERS = "osD^vP*X"
MOST = 8  # entries of a legend; more values have a colour bar
TICKS = 10  # of a colour bar
SYMBOLS = {  # of a setting, and its unit
    "particles": ("N", ""),
    "pressure": ("p", "k"),
    "beta": (r"\beta", ""),
    "eta_fluid": (r"\eta_F", r"k\tau_1"),
    "stress": (r"\delta\sigma", "k"),
    "omega": (r"\omega\tau_1", ""),
    "amplitude": (r"\gamma_0", ""),
    "step": (r"\gamma", ""),
    "rate": (r"\dot\gamma\tau_e", ""),
    "phi": (r"\phi", ""),
    "Q": ("Q", ""),
}
USUAL = ("rotations", True), ("potential", "harmonic")
LAWS = {"contact": "contact damping", "stokes": "Stokes drag"}


def number(value: float) -> str:
    """Return a number for a label, with a power of ten if it is far from 1."""
    text = f"{value:.4g}"
    if isinstance(value, int) or float(text) == 0 or 1e-2 <= abs(float(text)) < 1e4:
        return f"{value}" if isinstance(value, int) else text
    head, power = f"{value:.3e}".split("e")
    head = f"{float(head):g}"
    return rf"${'' if head == '1' else head + chr(92) + 'times '}10^{{{int(power)}}}$"


def axis_label(key: str) -> str:
    """Return the symbol of a setting with its unit."""
    symbol, unit = SYMBOLS.get(key, (rf"\mathrm{{{key.replace('_', ' ')}}}", ""))
    return f"${symbol}$" + f"  (${unit}$)" * bool(unit)


def setting(key: str, value: Any) -> str:
    """Return a setting as text, as ``p = 0.01 k`` or ``with pre-stress``.

    Parameters
    ----------
    key : str
        As in :data:`SYMBOLS`, or ``law``, or the name of something that is there or not.
    value : float, str or bool
    """
    if isinstance(value, bool):
        return f"with{'' if value else 'out'} {key.replace('prestress', 'pre-stress').replace('_', ' ')}"
    if isinstance(value, str):
        return LAWS.get(value, value.replace("_", " ").replace("-", " "))
    symbol, unit = SYMBOLS.get(key, (rf"\mathrm{{{key.replace('_', ' ')}}}", ""))
    return f"${symbol}$ = {number(value)}" + f" ${unit}$" * bool(unit)


def given(prestress: bool) -> str:
    """Return ``with pre-stress`` or ``without pre-stress``."""
    return setting("prestress", prestress)


def settings(r: Result) -> dict[str, Any]:
    """Return what may differ between results: N, p, law, its coefficients, masses, strain, pre-stress, potential."""
    found = _of_law(r.origin.damping) if r.origin.damping else {}
    inertia = getattr(r, "inertia", "")
    found |= {"inertia": rf"{inertia} $k\tau_1^2$"} if inertia else {}
    found |= {"strain": r.origin.strain} if r.origin.strain else {}
    size = {"particles": r.origin.particles, "pressure": nominal(r.origin.pressure)}
    return {**size, **found, "prestress": r.prestress, "potential": r.origin.potential}


def law_text(law: DampingLaw) -> str:
    """Return a law and its coefficients as text."""
    return ", ".join(_told(_of_law(law)))


def _of_law(law: DampingLaw) -> dict[str, Any]:
    return {"law": law.name, **law.settings}


def _told(some: Mapping[str, Any]) -> list[str]:
    """Return settings as texts, without those that are usual."""
    return [setting(key, value) for key, value in some.items() if (key, value) not in USUAL]


def heading(results: Mapping[str, Result]) -> str:
    """Return the settings that all results have, and the number of packings if there are several."""
    found = [settings(r) for r in results.values()]
    common = {key: value for key, value in found[0].items() if all(one.get(key) == value for one in found)}
    count = len({r.origin.checksum for r in results.values()})
    return ", ".join([f"{count} packings"] * (count > 1) + _told(common))


class Shades:
    """Colours and markers of the values of one setting, by their place in ascending order.

    Parameters
    ----------
    key : str
        As in :data:`SYMBOLS`.
    values : iterable of float
    """

    def __init__(self, key: str, values: Iterable[float]) -> None:
        self.key, self.values = key, sorted(set(values))

    def __call__(self, value: float) -> Colour:
        """Return the colour of one of the values; the lowest is the darkest."""
        from matplotlib import colormaps

        return colormaps["viridis"](0.9 * self.values.index(value) / max(len(self.values) - 1, 1))

    def marker(self, value: float) -> str:
        """Return the marker of one of the values."""
        return MARKERS[self.values.index(value) % len(MARKERS)]

    def look(self, value: float) -> dict[str, Any]:
        """Return colour and marker of one of the values."""
        return {"color": self(value), "marker": self.marker(value)}

    def show(self, axes: Axes | Sequence[Axes], style: str = "-", *, markers: bool = True, **place: Any) -> None:
        """Draw the legend, or a colour bar if the values are too many for one; one value has neither.

        Parameters
        ----------
        axes
            Of matplotlib. A legend is in the first, together with what has labels there.
        style : str
            Of the lines in the legend.
        markers : bool
            Whether the curves have markers.
        **place
            Of the legend, as for matplotlib.
        """
        from matplotlib.axes import Axes as Panel
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import BoundaryNorm, ListedColormap

        panels = [axes] if isinstance(axes, Panel) else list(axes)
        count = len(self.values)
        if 1 < count <= MOST:
            for value in self.values:
                look = self.look(value) if markers else {"color": self(value)}
                panels[0].plot([], [], ls=style, ms=5, label=setting(self.key, value), **look)
        elif count > 1:
            norm, colours = BoundaryNorm(np.arange(count + 1) - 0.5, count), ListedColormap([*map(self, self.values)])
            places = np.unique(np.linspace(0, count - 1, min(count, TICKS)).round().astype(int))
            bar = panels[0].figure.colorbar(ScalarMappable(norm, colours), ax=panels, ticks=places, aspect=30)
            bar.ax.set_yticklabels([number(self.values[k]) for k in places])
            bar.ax.minorticks_off()
            bar.set_label(axis_label(self.key))
        if panels[0].get_legend_handles_labels()[0]:
            legend(panels[0], **place)


def legend(axes: Axes, **place: Any) -> None:
    """Draw a legend in which each label is once.

    Parameters
    ----------
    axes
        Of matplotlib.
    **place
        As for a legend of matplotlib.
    """
    handles = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    axes.legend(handles.values(), handles.keys(), **place)


class Family(NamedTuple, Generic[R]):
    """Results of the same settings, and how they are drawn."""

    results: dict[str, R]
    colour: Colour
    marker: str
    label: str

    @property
    def look(self) -> dict[str, Any]:
        """Colour and marker."""
        return {"color": self.colour, "marker": self.marker}


class Families(Generic[R]):
    """Results in families of the same settings: the number of most values is the colour, the others are the marker.

    Parameters
    ----------
    results : mapping of Result
    x : str
        A setting that may differ in a family.
    grid : callable, optional
        Of a result: what else is the same in a family.

    Attributes
    ----------
    members : list of Family
        In ascending order of the number that is a colour.
    shades : Shades or None
        None if the families do not differ in a number.
    """

    def __init__(
        self, results: Mapping[str, R], x: str = "", grid: Callable[[R], Sequence[float]] = lambda r: ()
    ) -> None:
        families: dict[Any, dict[str, R]] = {}
        for name, r in results.items():
            own = {key: value for key, value in settings(r).items() if key != x}
            families.setdefault((*own.items(), *grid(r)), {})[name] = r
        groups = [*families.values()]
        found = [{k: v for k, v in settings(next(iter(some.values()))).items() if k != x} for some in groups]
        values = {key: {one.get(key) for one in found} for one in found for key in one}
        differ = {key: some for key, some in values.items() if len(some) > 1}
        numbers = [key for key, some in differ.items() if all(type(value) in (int, float) for value in some)]
        key = max(numbers, key=lambda key: len(differ[key]), default="")
        self.shades = Shades(key, [one[key] for one in found]) if key else None
        labels = [", ".join(setting(k, one[k]) for k in differ if k != key and k in one) for one in found]
        self.kinds = list(dict.fromkeys(labels))
        told = zip(groups, [one.get(key, 0) for one in found], labels, strict=True)
        self.members = [
            Family(some, *self._look(value, label), label)
            for some, value, label in sorted(told, key=lambda item: (item[1], self.kinds.index(item[2])))
        ]

    def _look(self, value: float, label: str) -> tuple[Colour, str]:
        """Return the colour and the marker; many curves that differ in one number have no markers."""
        k = self.kinds.index(label)
        if not self.shades:
            return PALETTE[k % len(PALETTE)], MARKERS[k % len(MARKERS)]
        if len(self.kinds) > 1:
            return self.shades(value), MARKERS[k % len(MARKERS)]
        return self.shades(value), self.shades.marker(value) if len(self.shades.values) <= MOST else ""

    def show(self, axes: Axes, **place: Any) -> None:
        """Draw the legend or the colour bar.

        Parameters
        ----------
        axes
            Of matplotlib.
        **place
            Of the legend, as for matplotlib.
        """
        if len(self.kinds) > 1:
            for k, kind in enumerate(self.kinds):
                colour = "0.4" if self.shades else PALETTE[k % len(PALETTE)]
                axes.plot([], [], MARKERS[k % len(MARKERS)], color=colour, label=kind)
        if self.shades:
            self.shades.show(axes, markers=len(self.kinds) == 1, **place)
        elif axes.get_legend_handles_labels()[0]:
            legend(axes, **place)
