"""Run the blocks of a page as written, and put what they print and draw into it: python tools/documents.py PAGE…

What a block prints goes into the block of text after it marked <!-- output -->, its pictures into docs/figures.
CONTRIBUTING.md describes the marks.
"""

import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from markdown_it import MarkdownIt

ROOT = Path(__file__).parents[1]
SHOWN = {"text", "toml"}  # neither commands nor Python

# Blocks of Python share their names. Each block of commands is a shell of its own, with the first environment.
RUN = """
import json, os, subprocess, sys
environment, names = dict(os.environ), {"__name__": "__main__"}
for page, line, language, text in json.load(sys.stdin):
    print(f"-- {page}:{line}", flush=True)
    if language == "bash":
        subprocess.run(["bash", "-euo", "pipefail", "-c", text], env=environment, stdin=subprocess.DEVNULL, check=True)
    else:
        exec(compile("\\n" * (line - 1) + text, page, "exec"), names)
"""


@dataclass
class Block:
    """A block of a page, the line where it starts, and the mark above it: its name, and what stands after the colon."""

    page: Path
    line: int
    language: str
    text: str
    mark: str
    said: str

    @property
    def runs(self):
        return self.language not in SHOWN and self.mark != "not run"

    def small(self):
        """Return the text with the substitutions of its mark."""
        text = self.text
        for change in self.said.split(";") if self.mark == "test" else ():
            old, new = (part.strip() for part in change.split("→"))
            assert old in text, f"{self.page}:{self.line}: the mark replaces {old!r}, which is not there"
            text = text.replace(old, new)
        return text


def blocks(page):
    """Return the blocks of a page, without directives of the site."""
    found, mark = [], ("", "")
    for token in MarkdownIt().parse(page.read_text(encoding="utf-8")):
        if token.type in ("fence", "code_block") and not token.info.startswith("{"):
            found.append(Block(page, token.map[0] + 2, token.info, token.content, *mark))
        seen = re.fullmatch(r"<!-- (test|not run|output)(?:: (.*?))? *-->\s*", token.content, re.DOTALL)
        mark = seen.groups() if token.type == "html_block" and seen else ("", "")
    return found


def run(found, folder, small, environment):
    """Run blocks in a folder, in their order.

    Parameters
    ----------
    found : list of Block
    folder : path
    small : bool
        Whether in the sizes of their marks.
    environment : dict
    """
    task = [(str(b.page), b.line, b.language, b.small() if small else b.text) for b in found if b.runs]
    source = 'export PYTHON="$1" && . "$0" && exec "$1" -c "$2"'
    launch = ["bash", "-c", source, str(ROOT / "tools" / "mpi-env.sh"), sys.executable, RUN]
    options = {"text": True, "capture_output": True, "env": environment}
    return subprocess.run(launch, input=json.dumps(task), cwd=folder, **options)


def write(page):
    """Run a page and put the results into it."""
    from PIL import Image

    folder = ROOT / "runs" / "documents" / page.stem
    folder.mkdir(parents=True, exist_ok=True)
    found = blocks(page)
    done = run(found, folder, False, {**os.environ, "MPLBACKEND": "Agg"})
    if done.returncode:
        raise SystemExit(done.stdout + done.stderr)
    printed = dict(re.findall(r"^-- [^\n]*:(\d+)\n(.*?)(?=^-- |\Z)", done.stdout, re.DOTALL | re.MULTILINE))
    lines = page.read_text(encoding="utf-8").split("\n")
    assert blocks(page) == found, f"{page} was changed while it was run"
    for block, after in reversed([*pairwise(found)]):
        if after.mark == "output":
            start = after.line - 1
            lines[start : start + after.text.count("\n")] = printed[str(block.line)].rstrip().split("\n")
    page.write_text("\n".join(lines), encoding="utf-8")
    for picture in folder.glob("*.png"):
        image = Image.open(picture).convert("RGB").quantize(128)
        image.save(ROOT / "docs" / "figures" / picture.name, optimize=True)


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        write(Path(argument).resolve())
