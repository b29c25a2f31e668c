"""Completion of verbs, options and file names in bash and zsh, from the parser."""

from __future__ import annotations

import argparse
import shlex
from typing import Any

from petscjam.base.arguments import path

SCRIPT = """# completion of petscjam for bash and zsh; zsh: autoload -U bashcompinit && bashcompinit
_petscjam() {{
    local word="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}" verb="${{COMP_WORDS[1]}}" known=""
    if [ "$COMP_CWORD" -eq 1 ]; then
        known={verbs}
    else
        case "$verb:$before" in
{choices}
        *)  case "$verb" in
{options}
            esac ;;
        esac
    fi
    COMPREPLY=( $(compgen -W "$known" -- "$word") )
}}
complete -o default -o bashdefault -F _petscjam petscjam
"""


class Completion(argparse.Action):
    """Print the script for a shell, and stop."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        """Print the script of ``parser``.

        Parameters
        ----------
        parser : Parser
        namespace, values, option_string
            As argparse passes them.
        """
        print(("autoload -U +X bashcompinit && bashcompinit\n" if values == "zsh" else "") + script(parser), end="")
        parser.exit()


def script(parser: Any) -> str:
    """Return the function of bash that completes the command line of ``parser``."""
    verbs = parser._subparsers._group_actions[0].choices
    choices, options = [], []
    for verb, one in verbs.items():
        one.complete()
        options.append(f"            {verb}) known={shlex.quote(' '.join(one._option_string_actions))} ;;")
        for action in one._actions:
            names = "|".join(f"{verb}:{name}" for name in action.option_strings)
            if action.choices and names:
                choices.append(f"        {names}) known={shlex.quote(' '.join(map(str, action.choices)))} ;;")
            elif action.type is path and names:
                choices.append(f"        {names}) known='' ;;")
    words = shlex.quote(" ".join([*verbs, "help", *parser._option_string_actions]))
    return SCRIPT.format(verbs=words, choices="\n".join(choices), options="\n".join(options))
