"""The pipeline is the layout: imports point backwards along it, and importing the package is cheap."""

import ast
import json
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src"

# A folder may import from itself and from the folders above it.
PIPELINE = [
    "base",
    "parallel",
    "geometry",
    "rows",
    "preparation",
    "response",
    "md",
    "analysis",
    "io",
    "plots",
    "figures",
    "reference",
    "cli",
]


def folder(module):
    """The folder of a module, or of a name imported from one; the command itself belongs to cli."""
    name = module.split(".")[1]
    return "cli" if name == "__main__" else name


def imports(path, module):
    """Every module of petscjam that a file imports anywhere, in functions too."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.startswith("petscjam"))
        elif isinstance(node, ast.ImportFrom):
            origin = node.module or ""
            if node.level:
                package = module.split(".")[: len(module.split(".")) - node.level + (path.stem == "__init__")]
                origin = ".".join([*package, *origin.split(".")]).rstrip(".")
            if origin.startswith("petscjam"):
                yield from (f"{origin}.{alias.name}" for alias in node.names)


def modules():
    found = []
    for path in sorted(SOURCE.rglob("*.py")):
        name = ".".join(path.relative_to(SOURCE).with_suffix("").parts)
        name = name.removesuffix(".__init__")
        if name != "petscjam":  # the package's own __init__ names everything, lazily
            found.append(pytest.param(path, name, id=name))
    return found


@pytest.mark.parametrize(("path", "module"), modules())
def test_imports_point_backwards(path, module):
    here = PIPELINE.index(folder(module))
    forwards = [name for name in imports(path, module) if PIPELINE.index(folder(name)) > here]
    assert not forwards, f"{module} imports what comes later in the pipeline: {forwards}"


def test_no_module_imports_itself_through_others():
    names = {param.values[1] for param in modules()}
    graph = {}
    for path, module in (param.values for param in modules()):
        found = (name if name in names else name.rpartition(".")[0] for name in imports(path, module))
        graph[module] = {name for name in found if name in names and name != module}
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


def functions(tree, inside=""):
    """The name and the node of every public function and method; those inside functions and private classes not."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            if node.name.startswith("_"):
                continue
            if isinstance(node, ast.FunctionDef):
                yield inside + node.name, node
            else:
                yield from functions(node, f"{inside}{node.name}.")


def test_public_functions_describe_their_arguments():
    undescribed = []
    for path, module in (param.values for param in modules()):
        for name, node in functions(ast.parse(path.read_text())):
            arguments = {a.arg for a in (*node.args.args, *node.args.kwonlyargs)} - {"self", "cls"}
            if len(arguments) > 1 and "Parameters\n---" not in (ast.get_docstring(node) or ""):
                undescribed.append(f"{module}.{name}")
    assert not undescribed


def in_a_new_process(code):
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return json.loads(run.stdout)


def test_import_is_fast():
    code = "import time; t = time.perf_counter(); import petscjam; print(time.perf_counter() - t)"
    assert min(in_a_new_process(code) for _ in range(5)) < 0.2


def test_import_loads_nothing_heavy():
    loaded = in_a_new_process("import json, sys, petscjam; print(json.dumps(list(sys.modules)))")
    assert "petscjam" in loaded
    assert not {"petsc4py", "slepc4py", "mpi4py", "numba", "matplotlib"} & set(loaded)
