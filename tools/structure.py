#!/usr/bin/env python3
"""Measure the source: python tools/structure.py [FOLDER]; FOLDER holds the package, src/petscjam if left out.

Lines are physical lines; code leaves out blank lines, comments and docstrings. Repeats are counted by other tools.
"""

import ast
import sys
import tokenize
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from statistics import median

LEFT_OUT = tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING
FUNCTION = ast.FunctionDef, ast.AsyncFunctionDef


def docstring_lines(tree):
    """The lines on which docstrings stand."""
    lines = set()
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, *FUNCTION)) and ast.get_docstring(node, clean=False) is not None:
            text = node.body[0]
            lines.update(range(text.lineno, text.end_lineno + 1))
    return lines


def code_lines(path, tree):
    """The lines that hold code."""
    lines = set()
    with tokenize.open(path) as file:
        for token in tokenize.generate_tokens(file.readline):
            if token.type not in LEFT_OUT and token.string:
                lines.update(range(token.start[0], token.end[0] + 1))
    return lines - docstring_lines(tree)


def imported(tree, package):
    """The names of modules and of what is imported from them."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(package):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def arguments(node):
    """How many arguments a function takes, self and cls left out."""
    names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
    return len([name for name in names if name not in ("self", "cls")])


def circles(graph):
    """How many edges must go until no module imports itself through others."""
    count = 0
    while True:
        try:
            TopologicalSorter(graph).prepare()
            return count
        except CycleError as error:
            circle = error.args[1]
            graph[circle[1]] = graph[circle[1]] - {circle[0]}
            count += 1


def undescribed(tree):
    """Public functions of two or more arguments without Parameters; not those in functions and private classes."""
    count = 0
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            count += undescribed(node)
        elif isinstance(node, FUNCTION) and not node.name.startswith("_") and arguments(node) >= 2:
            count += "Parameters\n" not in (ast.get_docstring(node) or "")
    return count


root = Path(sys.argv[1] if len(sys.argv) > 1 else "src/petscjam")
package = root.name
paths = [path for path in sorted(root.rglob("*.py")) if not path.is_symlink()]
trees = {path: ast.parse(path.read_text()) for path in paths}
names = {
    path: ".".join((package, *path.relative_to(root).with_suffix("").parts)).removesuffix(".__init__") for path in paths
}
graph = {}
for path, tree in trees.items():
    found = (name if name in names.values() else name.rpartition(".")[0] for name in imported(tree, package))
    graph[names[path]] = {name for name in found if name in names.values() and name not in (names[path], package)}
lengths = [len(path.read_text().splitlines()) for path in paths]
functions = [node for tree in trees.values() for node in ast.walk(tree) if isinstance(node, FUNCTION)]
signatures = [ast.unparse(part) for f in functions for part in (f.args, f.returns) if part]
for label, value in {
    "files": len(paths),
    "lines": sum(lengths),
    "lines of code": sum(len(code_lines(path, tree)) for path, tree in trees.items()),
    "lines of a file, median": f"{median(lengths):g}",
    "files over 300 lines": sum(length > 300 for length in lengths),
    "functions over 50 lines": sum(f.end_lineno - f.lineno + 1 > 50 for f in functions),
    "functions of more than 8 arguments": sum(arguments(f) > 8 for f in functions),
    "public functions without Parameters": sum(undescribed(tree) for tree in trees.values()),
    "Any in signatures": sum(text.count("Any") for text in signatures),
    "import circles": circles(graph),
    "fmt: skip": sum(path.read_text().count("# fmt: skip") for path in paths),
}.items():
    print(f"{label:36} {value:>7}")
