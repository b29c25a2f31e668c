"""The pipeline is the layout: imports point backwards along it, and importing the package is cheap."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src"

# A module may import from its own line and from the lines above it. The longest name that fits counts,
# so packing.prepare stands below network, though packing stands above it.
PIPELINE = [
    "errors ranges storage progress values compiled interrupt",
    "parallel.comm parallel.container parallel.memory",
    "box neighbours",
    "potential",
    "packing",
    "network",
    "kinematics",
    "parallel",
    "packing.newton packing.certify packing.prepare packing.library",
    "damping",
    "response",
    "analysis",
    "md",
    "io",
    "ensemble",
    "reference reference_md",
    "report",
    "plots",
    "figures",
    "cli __main__",
]
STAGE = {f"petscjam.{name}": stage for stage, line in enumerate(PIPELINE) for name in line.split()}


def stage(module):
    """Line of PIPELINE on which a module, or a name imported from one, stands; None for the package."""
    parts = module.split(".")
    names = (".".join(parts[:n]) for n in range(len(parts), 0, -1))
    return next((STAGE[name] for name in names if name in STAGE), None)


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
    here = stage(module)
    assert here is not None, f"{module} has no place in PIPELINE"
    forwards = [name for name in imports(path, module) if (there := stage(name)) is None or there > here]
    assert not forwards, f"{module} imports what comes later in the pipeline: {forwards}"


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
