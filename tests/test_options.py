"""Options of every verb, drawn from valid, boundary and absurd values: done, or refused in a line.

The verbs run in child processes, so that a crash of the interpreter is seen, too.
"""

import argparse
import json
import random
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import contents, sixteen

import petscjam as pj
from petscjam.base.arguments import Within, path
from petscjam.base.errors import InputError
from petscjam.cli import main
from petscjam.cli.parser import Parser, build_parser
from petscjam.cli.renamed import RENAMED
from petscjam.md import protocols
from petscjam.md.runs import run
from petscjam.parallel import memory

ABSURD = """
0 -1 1e-320 -1e-320 1e-30 1e-9 1e9 1e22 1e300 -1e300 1e999 nan inf x 0.5 1 2 3 2147483648 9223372036854775807
9223372036854775808 18446744073709551616 1,2 1:2:3 1:2 1e-300:1e300:5 1:1e300:1000 1:2:10000000 3:1:2 , :
"""
ABSURD = ["", "9" * 5000, *ABSURD.split()]
pytestmark = pytest.mark.parallel(nprocs=1)
VERBS = build_parser()._subparsers._group_actions[0].choices
for parser in VERBS.values():
    parser.complete()
GIVEN = ("output", "config", "help", "start", "parameters", "log", "verbose")  # files, and what does not compute


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A small input of every kind."""
    at = tmp_path_factory.mktemp("inputs")
    sixteen().write(at / "packing.h5")
    assert main(["moduli", str(at / "packing.h5"), "--omega", "1e-2:1:3", "-o", str(at / "modulus.h5")]) == 0
    pj.md.shear(n=16, phi=0.8, rate=1e-2, strain=0.02, output=at / "run.h5")
    return at


def numeric(action):
    return action.type not in (None, Path, path)


def texts(action):
    """What may be written after an option."""
    if action.choices:
        return [*action.choices, "x"]
    if not numeric(action):
        return ["x", ""]
    ends = [action.type.range.low, action.type.range.high] if isinstance(action.type, Within) else []
    return [*ABSURD, *(str(int(end)) if end == int(end) else repr(end) for end in ends)]


def drawn(verb, random):
    """Up to three options of ``verb``: on, one of its choices, or any text."""
    options = [a for a in VERBS[verb]._actions if a.option_strings and a.dest not in GIVEN]
    found = []
    for action in random.sample(options, min(random.randint(1, 3), len(options))):
        name = action.option_strings[-1]
        found.append(name if action.nargs == 0 else f"{name}={random.choice(texts(action))}")
    return found


QUICK = {
    "prepare": "--particles=16 --pressure=1e-2",
    "moduli": "--omega=1e-2:1:3",
    "nonlinear-drag": "--stress=1e-3 --omega=1e-2:1:2",
    "density": "--moments=16 --vectors=2",
    "correlations": "--omega=1e-2",
    "modes": "--count=3",
    "oscillate": "--amplitude=1e-3 --omega=1 --cycles=3",
    "step-strain": "--step=1e-3 --time=10,20 --inertia=1e-2",
    "shear": "--particles=16 --rate=1e-2 --strain=0.02",
    "ramp": "--particles=16 --rate=1e-2 --to=2e-2 --kappa=0.1",
}
INPUTS = {verb: ["packing", "modulus", "run"] for verb in ("info", "export", "plot", "report")}
CHILD = """
import json, signal, sys
from petscjam.cli import main
for words in json.loads(sys.argv[1]):
    print("RUN", json.dumps(words), file=sys.stderr, flush=True)
    signal.alarm(60)
    print("STATUS", main(words), file=sys.stderr, flush=True)
"""


def command(verb, options, source, output):
    """The command line; options that are given last count more."""
    given = [] if verb in ("prepare", "shear", "ramp") else [str(source)]
    output = output.with_suffix(".html") if verb == "report" else output
    here = [] if verb == "info" else ["-o", str(output)]
    return [verb, *given, *QUICK.get(verb, "").split(), *options, *here]


@pytest.mark.parametrize("verb", VERBS)
def test_every_number_has_a_range_or_a_form(verb):
    """What is parsed lies in the range of the option; all else is one line that names the option."""
    for action in VERBS[verb]._actions:
        if not (action.option_strings and numeric(action)):
            continue
        for text in texts(action):
            try:
                value = VERBS[verb]._get_values(action, [text])
            except InputError as error:
                pytest.fail(str(error))
            except argparse.ArgumentError as error:
                assert action.option_strings[0] in str(error)
                assert "\n" not in str(error)
            else:
                if isinstance(action.type, Within):
                    assert all(x in action.type.range for x in np.ravel(value).tolist())


OLD_NAMES = {  # a command with each, and what it sets
    "drag": ("drag p.h5 --stress 1 -o x.h5", {"verb": "nonlinear-drag"}),
    "--strain": ("moduli p.h5 --strain compression -o x.h5", {"strain": "compression"}),
    "--drag": ("shear --strain 2 --drag 0.5 -o x.h5", {"strain": 2.0, "stokes_drag": 0.5}),
    "--spin-drag": ("ramp --spin-drag=0.5 -o x.h5", {"rotational_drag": 0.5}),
}


@pytest.mark.parametrize("old", RENAMED)
def test_old_names_work_with_a_warning(capsys, old):
    words, expected = OLD_NAMES[old]
    options, unknown = build_parser().parse_known_args(words.split())
    assert expected.items() <= vars(options).items()
    assert not unknown
    assert capsys.readouterr().err == f"petscjam: warning: {old} is now {RENAMED[old]}\n"


@pytest.mark.parametrize("key", ["spin-drag", "spin_drag"])
def test_old_names_work_in_a_file_of_settings(tmp_path, capsys, key):
    parser, file = Parser(), tmp_path / "settings.toml"
    parser.add_argument("--config")
    parser.add_argument("--rotational-drag", type=float)
    file.write_text(f"{key} = 0.5")
    assert parser.parse_known_args(["--config", str(file)])[0].rotational_drag == 0.5
    assert capsys.readouterr().err == "petscjam: warning: --spin-drag is now --rotational-drag\n"


REFUSED = """
shear --dt 1e-12
shear --strain 1e15
shear --rate 1e-320
shear --rate 1e300
shear --Q 1e-320
shear --Q 1e300
shear --phi 1e-320
shear --stokes-drag 1e300
shear --rotational-drag 1e300
shear --seed 9223372036854775808
shear --row-time 1e300
shear --row-time -1
shear --frames -1
shear --strain 1e5 --row-time 1e-3 --rate 1e-2
shear --particles 100000000
shear --oscillate 1:1e-300:1
shear --oscillate 1e300:1:1
shear --then 1e300:1
shear --then 0:1e300
shear --particles 16:18 --seeds 1:1000000
shear --exponent 1e300
shear --phi 0.1:0.8:1000 --Q 1:2:1000 --seeds 1:1000
ramp --kappa 1e-320
ramp --kappa 1e300
ramp --kappa 1e-14
ramp --to 1e300
ramp --to 1e-320
prepare --ratio 1e-300
prepare --seed 9223372036854775808
prepare --particles 100000000
prepare --particles 1e22
prepare --budget 9223372036854775808
prepare --particles 16,18 --seeds 1:1000000
density PACKING --moments 10000000000000000000000
density PACKING --moments 1000000 --vectors 100000
density PACKING --seed 9223372036854775808
correlations PACKING --bin 1e-9
correlations PACKING --width 1e-9
nonlinear-drag PACKING --stress 1e-3 --alpha 1e5
nonlinear-drag PACKING --stress 1e300
nonlinear-drag PACKING --stress 1 --alpha 1e-320
moduli PACKING --beta 1e300
moduli PACKING --omega 1e-320
moduli PACKING --team-size 0
modes PACKING --count 10000000000000000000000
viscosity PACKING --beta 1e300
"""


@pytest.mark.parametrize("words", REFUSED.strip().splitlines())
def test_absurd_numbers_are_refused_before_the_work(folder, tmp_path, capfd, monkeypatch, words):
    """One line, status 2, at once, and nothing is written."""
    monkeypatch.setattr(memory, "available_memory", lambda: 8192.0)
    words = words.replace("PACKING", str(folder / "packing.h5")).split()
    assert main([*words, "-o", str(tmp_path / "out.h5")]) == 2
    assert capfd.readouterr().err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "work",
    [
        lambda: run(protocols.steady(1e-4, 1e12), "CD", 16),
        lambda: pj.md.shear(n=16, seed=2**63),
        lambda: pj.md.shear(n=16, row_time=-1.0),
        lambda: pj.md.shear(n=16, frames=-1),
        lambda: pj.md.shear(Q=1e300),
        lambda: protocols.steps([1e-3] * 2000, [1.0] * 2000),
        lambda: pj.prepare_packing(16, 1e-2, 2**63),
        lambda: pj.ContactDamping(1e300),
    ],
)
def test_functions_refuse_them_too(work):
    """As the command does."""
    with pytest.raises(InputError, match=r"from|at most"):
        work()


def test_memory_is_estimated_before_it_is_asked_for(monkeypatch):
    """A machine with 1 MB free takes neither many disks nor many rows."""
    monkeypatch.setattr(memory, "available_memory", lambda: 1.0)
    for work in (
        lambda: pj.md.shear(n=1100),
        lambda: pj.md.shear(n=16, row_time=2.1),
        lambda: pj.prepare_packing(1000),
    ):
        with pytest.raises(InputError, match="needs about"):
            work()


@pytest.mark.slow
@pytest.mark.parametrize("verb", [verb for verb in VERBS if verb != "figure"])
def test_any_options_are_done_or_refused(folder, tmp_path, verb):
    """Status 0, 2, or 1 with a line where a solve fails; no traceback, no part of a file, inputs kept."""
    before, draw, commands = contents(folder), random.Random(verb), []
    for k in range(40):
        source = folder / f"{draw.choice(INPUTS.get(verb, ['packing']))}.h5"
        commands.append(command(verb, drawn(verb, draw), source, tmp_path / f"{k}.h5"))
    child = subprocess.run(
        [sys.executable, "-c", CHILD, json.dumps(commands)], capture_output=True, text=True, cwd=tmp_path
    )
    assert child.returncode == 0, child.stderr[-2000:]
    assert "Traceback" not in child.stderr, child.stderr
    for part in child.stderr.split("RUN ")[1:]:
        status = int(part.split("STATUS ")[1])
        assert status in (0, 2) or (status == 1 and "petscjam: " in part), part
    assert contents(folder) == before
    assert not list(tmp_path.rglob("*.part"))
    for file in tmp_path.glob("*.h5"):
        assert main(["info", str(file)]) == 0
