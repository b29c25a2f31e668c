"""The site: what the pages in docs show on the code host, and besides

- ``<!-- site: NAME -->`` becomes what the function NAME below writes;
- a list under ``<!-- toctree: CAPTION -->`` becomes a part of the contents at the left, too;
- a link to a .py or .toml that is a paragraph becomes the file itself, one to a module within a text its reference.
"""

import base64
import inspect
import json
import os
import re
import sys
from importlib import import_module
from pathlib import Path

os.environ["NUMBA_ENABLE_CUDASIM"] = "1"  # petscjam.md.cuda is imported without a GPU
sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))

import ziamath
from documents import blocks
from docutils import nodes
from PIL import Image

from petscjam import __version__ as release
from petscjam.cli.parser import Help, build_parser

project = "petscjam"
author = copyright = "The petscjam developers"
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
]
html_theme = "furo"
html_title = f"petscjam {release}"
html_static_path = ["_static"]
html_css_files = ["petscjam.css"]
html_math_renderer = "svg"
templates_path = ["_templates"]
exclude_patterns = ["_build"]
suppress_warnings = ["ref.python"]  # the C of a shape (C,) is no reference

myst_enable_extensions = ["amsmath", "dollarmath", "colon_fence"]
myst_heading_anchors = 3
autosummary_generate = True
autodoc_typehints = "none"  # the docstrings give types, with shapes
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_ivar = True  # attributes are described once, in the docstring of the class
napoleon_use_rtype = False
here = Path(__file__).parent


def gallery(_):
    """Return a grid of small pictures of the figures of both papers, each a link to its page."""
    thumbs = here / "_generated" / "thumbs"
    thumbs.mkdir(parents=True, exist_ok=True)
    pages = sorted(
        (here / "paper").glob("*.md"),
        key=lambda page: [int(x) if x.isdigit() else x for x in re.split(r"(\d+)", page.stem)],
    )
    lines = [":::{container} gallery"]
    for page in pages:
        picture = here / "figures" / f"{page.stem}.png"
        if picture.exists():
            image = Image.open(picture).convert("RGB")
            image.thumbnail((320, 320))
            image.save(thumbs / picture.name)
            title = re.search(r"^# (.*)", page.read_text(), re.MULTILINE)[1]
            paper = "VOT" if page.stem.startswith("vot") else "BT"
            short = re.sub(r"Fig\. (\d+).*", rf"{paper} \1", title)
            lines += ["", f"[![{title}](_generated/thumbs/{picture.name}) {short}](paper/{page.name})"]
    return "\n".join([*lines, ":::"])


def notebook(page):
    """Write a page as a Jupyter notebook with its outputs, and return a link to it."""
    cells, lines, at = [], page.read_text().split("\n"), 0

    def prose(text):
        for picture in re.findall(r"!\[.*\]\((.*)\)", text):
            data = base64.b64encode((page.parent / picture).read_bytes()).decode()
            cells[-1]["outputs"].append({"output_type": "display_data", "metadata": {}, "data": {"image/png": data}})
        text = re.sub(r"<!--.*?-->|!\[.*\]\(.*\)", "", text, flags=re.DOTALL)
        text = re.sub(r"\[([^\]]+)\]\([^)]*\)", r"\1", text).strip()
        if text:
            cells.append({"cell_type": "markdown", "metadata": {}, "source": text})

    for block in blocks(page):
        prose("\n".join(lines[at : block.line - 2]))
        at = block.line + block.text.count("\n")
        if block.mark == "output":
            cells[-1]["outputs"].append({"output_type": "stream", "name": "stdout", "text": block.text})
        else:
            source = "%%bash\n" * (block.language == "bash") + block.text.rstrip()
            code = {"cell_type": "code", "metadata": {}, "execution_count": None, "source": source, "outputs": []}
            cells.append(code)
    prose("\n".join(lines[at:]))
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    whole = {"nbformat": 4, "nbformat_minor": 4, "metadata": {"kernelspec": kernel}, "cells": cells}
    folder = here / "_generated" / "notebooks"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{page.stem}.ipynb").write_text(json.dumps(whole, indent=1, ensure_ascii=False))
    return f"[As a notebook](../_generated/notebooks/{page.stem}.ipynb)"


def python(_):
    """Return an entry for each public name."""
    lines = []
    for module in ("petscjam", "petscjam.md", "petscjam.plots"):
        package = import_module(module)
        lines += [f"## `{module}`", "", "```{eval-rst}", f".. currentmodule:: {module}", ""]
        for name in sorted(package.__all__, key=str.lower):
            thing = getattr(package, name)
            if inspect.isclass(thing):
                kind = "exception" if issubclass(thing, Exception) else "class"
                lines += [f".. auto{kind}:: {name}", *["   :members:"] * (kind == "class"), ""]
            elif callable(thing):
                lines += [f".. autofunction:: {name}", *["   :no-index:"] * (thing.__module__ == module), ""]
        lines += ["```", ""]
    return "\n".join(lines)


def command(_):
    """Return all verbs with their options, from the parser."""
    lines, form = [], Help("petscjam")
    verbs = build_parser()._subparsers._group_actions[0]
    summaries = {action.dest: action.help for action in verbs._choices_actions}
    for verb, parser in verbs.choices.items():
        parser.complete()
        lines += [f"## {verb}", "", f"{summaries[verb][0].upper()}{summaries[verb][1:]}.", ""]
        for group in parser._action_groups:
            rows = [
                (form._format_action_invocation(action), form._expand_help(action) if action.help else "")
                for action in group._group_actions
                if "--help" not in action.option_strings
            ]
            if rows:
                lines += [f"*{group.title}*", "", "| | |", "|---|---|"]
                lines += [f"| `{option}` | {escaped(text)} |" for option, text in rows] + [""]
    return "\n".join(lines)


def escaped(text):
    return re.sub(r"([|*_<\\])", r"\\\1", " ".join(text.split()))


def read(app, name, source):
    """Make the site's page of that of the code host."""
    page = here / f"{name}.md"
    if not page.exists():
        return
    text = re.sub(r"<!-- site: (\w+) -->", lambda found: globals()[found[1]](page), source[0])
    text = re.sub(r"^\[[^\]]+\]\(([./\w-]+\.(py|toml))\)$", shown, text, flags=re.MULTILINE)
    text = re.sub(
        r"\[([^\]]+)\]\([./]+/src/(petscjam/[\w/]+?)(?:/__init__)?\.py\)",
        lambda found: f"{{py:mod}}`{found[1].strip('`')} <{found[2].replace('/', '.')}>`",
        text,
    )
    source[0] = re.sub(r"<!-- toctree(?:: (.+))? -->\n\n((?:(?:- |  ).+\n)+)", contents, text)


def shown(found):
    language = {"py": "python", "toml": "toml"}[found[2]]
    return f"```{{literalinclude}} {found[1]}\n:language: {language}\n```"


def contents(found):
    pages = re.findall(r"\]\(([^)#]+)\.md\)", found[2])
    return "\n".join(
        [found[2], "```{toctree}", ":hidden:", *[f":caption: {found[1]}"] * bool(found[1]), "", *pages, "```", ""]
    )


def captions(app, doctree):
    """A picture that is a paragraph becomes a figure with its caption, and a link to its full size."""
    for image in list(doctree.findall(nodes.image)):
        if isinstance(image.parent, nodes.paragraph) and len(image.parent) == 1:
            image["width"] = "100%"  # which makes Sphinx link it
            name = nodes.make_id(image["uri"])
            image.parent.replace_self(nodes.figure("", image, nodes.caption("", image["alt"]), ids=[name]))


ziamath.config.svg2 = False
ziamath.config.precision = 2
ziamath.config.math.color = "currentColor"


def formula(writer, node):
    """Draw a formula: it needs neither a script nor a font."""
    inline = isinstance(node, nodes.math)
    tex = " ".join(node.astext().split())
    drawn = ziamath.Latex(tex, size=17, inline=inline)
    svg = drawn.svg().replace(
        "<svg ",
        f'<svg role="img" aria-label="{writer.attval(tex)}" style="vertical-align:{drawn.getyofst():.1f}px" ',
        1,
    )
    writer.body.append(svg if inline else f'<div class="math">{svg}</div>')
    raise nodes.SkipNode


def before_napoleon(app, what, name, obj, options, lines):
    """Keep the first line of a property: napoleon takes what stands before a colon for a type."""
    if what == "property":
        lines.insert(0, "\\")  # an escaped end of line, which is nothing


def after_napoleon(app, what, name, obj, options, lines):
    """Name attributes that are described together: Sphinx takes "K, B" for B of the type K; |δ| is no substitution."""
    lines[:] = [re.sub(r"(?<=^:ivar )[\w, ]+:|(?<=^:vartype )[\w, ]+:", joined, line) for line in lines]
    lines[:] = [line.replace("|", r"\|") for line in lines]


def joined(found):
    return found[0].replace(", ", ",")


def setup(app):
    app.connect("source-read", read)
    app.connect("doctree-read", captions)
    app.connect("autodoc-process-docstring", before_napoleon, priority=400)
    app.connect("autodoc-process-docstring", after_napoleon, priority=600)
    app.add_html_math_renderer("svg", (formula, None), (formula, None))
