"""Damping laws as options: each field of each law is an option."""

from __future__ import annotations

import argparse
from dataclasses import Field, fields
from itertools import product
from typing import Any

from petscjam.base.errors import InputError
from petscjam.rows.damping import LAWS, ContactDamping, DampingLaw


def option(item: Field[Any]) -> str:
    """Return the option of a field of a law; the option of a field that is true by default sets it to false."""
    return f"--{'no-' * isinstance(item.default, bool)}{item.name.replace('_', '-')}"


def law_options(options: argparse.Namespace) -> list[str]:
    """Return the options of damping laws whose value is not the default."""
    given = ["--damping"] * (options.damping != ContactDamping.name)
    items = {item.name: item for law in LAWS.values() for item in fields(law)}
    return given + [option(item) for name, item in items.items() if getattr(options, name) is not None]


def chosen_laws(options: argparse.Namespace) -> list[DampingLaw]:
    """Return the damping laws that the options describe, one for each combination of their values.

    An option of another law is refused.
    """
    law = LAWS[options.damping]
    settings: dict[str, list[Any]] = {}
    for other in LAWS.values():
        for item in fields(other):
            value = getattr(options, item.name)
            if value is None:
                continue
            if item.name not in [own.name for own in fields(law)]:
                raise InputError(f"{option(item)} goes with --damping {other.name}, not with {law.name}")
            settings[item.name] = value if isinstance(value, list) else [value]
    return [law(**dict(zip(settings, values, strict=True))) for values in product(*settings.values())]
