"""Settings of a verb in a TOML file, by the names of its options."""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Iterable, Mapping
from difflib import get_close_matches

from petscjam.base.errors import InputError
from petscjam.base.files import naming
from petscjam.cli.renamed import current

Exclusive = argparse._MutuallyExclusiveGroup


def settings(argv: list[str], options: Mapping[str, argparse.Action], exclusive: Iterable[Exclusive]) -> list[str]:
    """Return the options in the file of ``--config``, to be put before ``argv``.

    Options that exclude one in ``argv`` are left out.

    Parameters
    ----------
    argv : list of strings
        The command line of the verb.
    options : mapping
        From option strings to actions of argparse.
    exclusive : iterable
        Groups of mutually exclusive options.
    """
    one = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    one.add_argument("--config")
    try:
        path = one.parse_known_args(argv)[0].config
    except argparse.ArgumentError:  # no file name: the parser of the verb raises the error
        path = None
    if not path:  # an empty name: the same error
        return []
    with naming(path):
        return _words(path, argv, options, exclusive)


def _words(
    path: str, argv: list[str], options: Mapping[str, argparse.Action], exclusive: Iterable[Exclusive]
) -> list[str]:
    with open(path, "rb") as file:
        try:
            content = tomllib.load(file)
        except ValueError as error:
            raise InputError(f"not TOML, name = value ({error})") from None
    given = {word.split("=")[0] for word in argv}
    excluded: set[str] = set()
    for group in exclusive:
        names = {name for action in group._group_actions for name in action.option_strings}
        excluded |= names if names & given else set()
    known = [name[2:].replace("-", "_") for name in options if name[:2] == "--" and name not in ("--help", "--config")]
    words = []
    for key, value in content.items():
        option = current(f"--{key.replace('_', '-')}", options)
        if option[2:].replace("-", "_") not in known:
            raise InputError(misspelt(key, known))
        if option in excluded:
            continue
        if options[option].nargs != 0:
            words.append(f"{option}={','.join(map(str, value)) if isinstance(value, list) else value}")
        elif isinstance(value, bool):
            words += [option] * value
        else:
            raise InputError(f"{key} must be true or false, not {value!r}")
    return words


def misspelt(option: str, known: list[str]) -> str:
    """Return the message that ``option`` is unknown, with a similar known one.

    Parameters
    ----------
    option : str
    known : list of str
    """
    close = get_close_matches(option.split("=")[0], known, 1)
    return f"unknown argument {option}" + (f"; did you mean {close[0]}?" if close else "")
