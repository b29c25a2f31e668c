"""Names of the last version that still work, each with one line of warning."""

from __future__ import annotations

import sys
from collections.abc import Container

RENAMED = {
    "drag": "nonlinear-drag",
    "--strain": "--strain-mode",
    "--drag": "--stokes-drag",
    "--spin-drag": "--rotational-drag",
}


def current(word: str, known: Container[str]) -> str:
    """Return ``word`` with an old name of a verb or of an option replaced by the new one, and warn.

    Parameters
    ----------
    word : str
        A verb, ``--option`` or ``--option=value``.
    known : container of str
        The names that are valid here: ``--strain`` is replaced only if ``--strain`` is not among them.
    """
    name, equals, value = word.partition("=")
    new = RENAMED.get(name)
    if new is None or name in known or new not in known:
        return word
    print(f"petscjam: warning: {name} is now {new}", file=sys.stderr)
    return f"{new}{equals}{value}"
