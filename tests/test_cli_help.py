"""Help, examples, settings in files, completion, JSON, messages and logs of every verb."""

import argparse
import json
import os
import shlex
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from helpers import refused, sixteen

import petscjam as pj
from petscjam.base import progress as reports
from petscjam.cli import join_negative, main
from petscjam.cli.completion import script
from petscjam.cli.examples import EXAMPLES
from petscjam.cli.parser import build_parser
from petscjam.io.results import read_results

pytestmark = pytest.mark.parallel(nprocs=1)
FORMATS = Path(__file__).parent / "fixtures" / "formats"
FILES = [*sorted(FORMATS.glob("*.h5")), FORMATS / "library", FORMATS / "flows"]
VERBS = build_parser()._subparsers._group_actions[0].choices


@pytest.fixture
def packing(tmp_path):
    sixteen().write(tmp_path / "p.h5")
    return tmp_path / "p.h5"


def helped(capsys, *words):
    with pytest.raises(SystemExit) as stop:
        main([*words])
    assert stop.value.code == 0
    return capsys.readouterr().out


# Help


@pytest.mark.parametrize("verb", VERBS)
def test_help_has_status_examples_and_messages(verb, capsys):
    text = helped(capsys, "help", verb)
    assert text == helped(capsys, verb, "--help")
    assert "Exit status: 0 done, 2 bad input" in " ".join(text.split())
    assert all(f"  petscjam {line}\n" in text for line in EXAMPLES[verb])
    assert text.index("\nsettings, messages:\n") > text.index("\noptions:\n")


def test_help_alone_lists_the_verbs(capsys):
    text = helped(capsys, "help")
    assert all(f"\n    {verb} " in text for verb in VERBS)


@pytest.mark.parametrize("line", [line for lines in EXAMPLES.values() for line in lines])
def test_examples_are_commands(line):
    options, unknown = build_parser().parse_known_args(join_negative(shlex.split(line)))
    assert not unknown
    assert line.startswith(f"{options.verb} ")


def test_the_options_of_shear_are_in_groups(capsys):
    text = helped(capsys, "shear", "--help")
    for title in ("strain rate:", "model and forces:", "disks and start:", "time steps:", "what is stored:"):
        assert f"\n{title}\n" in text
    free = VERBS["shear"]._action_groups[1]._group_actions
    assert len(free) <= 4  # help, output, overwrite, resume


# Settings in a file


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_takes_its_settings_from_a_file(verb, tmp_path):
    """An option of each form that the verb has, as in a file and on the command line."""
    parser = VERBS[verb]
    parser.complete()
    numbers = [a for a in parser._actions if a.option_strings and a.choices and a.option_strings[0].startswith("--")]
    flags = [a for a in parser._actions if a.nargs == 0 and a.dest not in ("help", "overwrite", "resume", "verbose")]
    flags = [a for a in flags if a.option_strings != ["--prestress-both"]]  # excludes --no-prestress
    lines, words = [], []
    for action in [*numbers[:2], *flags[:1]]:
        name = action.option_strings[-1]
        value = next(iter(action.choices)) if action.choices else None
        lines.append(f"{name[2:].replace('-', '_')} = {json.dumps(value) if value else 'true'}")
        words += [name] + [value] * (value is not None)
    (tmp_path / "s.toml").write_text("\n".join(lines))
    needed = ["x"] * sum(not a.option_strings for a in parser._actions)
    needed += [f"{a.option_strings[-1]}=1" for a in parser._actions if a.option_strings and a.required]
    given = build_parser().parse_args([verb, *needed, *words])
    read = build_parser().parse_args([verb, *needed, "--config", str(tmp_path / "s.toml")])
    assert str({**vars(read), "config": None}) == str(vars(given))


def test_settings_of_moduli_in_a_file(packing, tmp_path):
    (tmp_path / "s.toml").write_text('omega = [0.1, 1]\nbeta = 0.5\nno_prestress = true\nstrain-mode = "pure-shear"\n')
    out = tmp_path / "g.h5"
    assert main(["moduli", str(packing), "--config", str(tmp_path / "s.toml"), "--beta", "0.2", "-o", str(out)]) == 0
    g = pj.read_modulus(out)
    assert (g.damping.beta, g.prestress, g.strain, g.omega.tolist()) == (0.2, False, "pure-shear", [0.1, 1.0])


def test_a_file_of_settings_is_no_output_of_any_verb(packing, tmp_path, capfd):
    (tmp_path / "s.toml").write_text("omega = 1\n")
    command = ["moduli", packing, "--config", tmp_path / "s.toml", "--overwrite", "-o", tmp_path / "s.toml"]
    assert "is an input, too" in refused(capfd, *command)


# Messages


def test_quiet_says_nothing(packing, tmp_path, capfd):
    command = ["moduli", str(packing), "--omega", "1", "--no-prestress", "-o", str(tmp_path / "g.h5")]
    assert main([*command, "-q"]) == 0
    assert capfd.readouterr() == ("", "")
    assert main([*command, "--overwrite"]) == 0
    out, err = capfd.readouterr()
    assert "eta_inf" in out
    assert "100 %" in err
    assert "exists already" in refused(capfd, *command, "-q")


def test_verbose_says_version_time_and_where(packing, tmp_path, capfd):
    assert main(["info", str(packing), "-v"]) == 0
    err = capfd.readouterr().err
    assert f"petscjam {pj.__version__}, 1 ranks" in err
    assert err.endswith(" s\n")
    assert main(["info", str(tmp_path / "none.h5"), "-v"]) == 2
    err = capfd.readouterr().err
    assert err.count("Traceback") == 1
    assert err.splitlines()[-1].startswith(f"petscjam: {tmp_path / 'none.h5'}")


def test_a_log_has_the_command_and_what_it_says(packing, tmp_path, capfd):
    log = tmp_path / "a.log"
    command = [
        "moduli",
        str(packing),
        "--omega",
        "1",
        "--no-prestress",
        "-o",
        str(tmp_path / "g.h5"),
        "--log",
        str(log),
    ]
    assert main(command) == 0
    out, err = capfd.readouterr()
    first, *rest = log.read_text().splitlines()
    assert shlex.split(first)[1:] == ["petscjam", *command]
    assert set(out.splitlines()) | set(err.splitlines()) == set(rest)
    assert main(command) == 2
    assert log.read_text().splitlines()[-1] == capfd.readouterr().err.strip()


@pytest.mark.parametrize("name", ["p.h5", "g.h5", "none/a.log", "."])
def test_a_log_that_cannot_be_written(packing, tmp_path, capfd, name):
    before = packing.read_bytes()
    command = ["export", packing, "--config", tmp_path / "s.toml", "-o", tmp_path / "g.h5"]
    (tmp_path / "s.toml").write_text("")
    refused(capfd, *command, "--log", tmp_path / (name if name != "p.h5" else "s.toml"))
    assert packing.read_bytes() == before


# JSON


@pytest.mark.parametrize(
    "path", [*sorted(FORMATS.glob("*.h5")), FORMATS / "library", FORMATS / "flows"], ids=lambda p: p.name
)
def test_info_as_json(path, capsys):
    assert main(["info", str(path), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["file"] == str(path)
    if said["kind"] == "results":
        for name, r in read_results(path).items():
            assert said["results"][name]["origin"]["checksum"] == r.origin.checksum
            if hasattr(r, "eta0"):
                assert said["results"][name]["eta0"] == (None if np.isnan(r.eta0) else r.eta0)  # all digits
    elif said["kind"] == "packing":
        p = pj.Packing.read(path)
        assert (said["checksum"], said["certificate"]["Z"]) == (p.checksum, p.certificate.Z)
    elif said["kind"] == "run":
        assert said["means"]["Z"]["value"] == pj.md.read(path).mean("contacts").value


# Completion


def completed(*words):
    """What bash completes the last of ``words`` to."""
    line = ["petscjam", *words]
    text = script(build_parser()) + "\n".join(
        [
            f"COMP_WORDS=({shlex.join(line)})",
            f"COMP_CWORD={len(words)}",
            "_petscjam",
            'printf "%s\\n" "${COMPREPLY[@]}"',
        ]
    )
    return subprocess.run(["bash", "-c", text], capture_output=True, text=True, check=True).stdout.split()


def test_bash_completes_verbs_options_and_choices():
    assert completed("mod") == ["moduli", "modes"]
    assert completed("shear", "--stra") == ["--strain"]
    assert completed("moduli", "--damping", "st") == ["stokes"]
    assert completed("moduli", "p.h5", "-o", "") == []  # files: by bash itself
    assert completed("oscillate", "--amp") == ["--amplitude"]


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_the_command_prints_the_completion(shell, capsys):
    text = helped(capsys, "--completion", shell)
    assert script(build_parser()) in text
    assert ("bashcompinit" in text.splitlines()[0]) == (shell == "zsh" or "completion of" in text.splitlines()[0])


# Compilation


def test_compilation_is_said_and_is_no_part_of_the_time_left(monkeypatch, capsys):
    clock = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(reports, "_Compiling", type("Fresh", (reports._Compiling,), {}))
    with reports.progress("shear", show=True) as report:
        reports.compiling(begins=True)
        reports.compiling(begins=True)
        clock[0] = 20.0
        reports.compiling(begins=False)
        clock[0] = 30.0
        reports.compiling(begins=False)
        clock[0] = 40.0
        report(0.5, "half")
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith("shear: compiling for this processor")
    assert second == "shear: 50 %, 40 s, 10 s left; half"


@pytest.mark.slow
def test_the_first_run_of_a_new_cache_compiles(tmp_path):
    with TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        command = [sys.executable, "-m", "petscjam", "shear", "--particles", "16", "--phi", "0.8", "--rate", "1e-2"]
        for name, times in (("a", 1), ("b", 0)):
            out = [*command, "--strain", "0.1", "-o", str(tmp_path / f"{name}.h5")]
            done = subprocess.run(out, capture_output=True, text=True, check=True, env=environment)
            assert done.stderr.count("compiling for this processor") == times


def test_no_option_of_every_verb_hides_one_of_a_verb():
    for parser in VERBS.values():
        parser.complete()
        names = [name for action in parser._actions for name in action.option_strings]
        assert len(names) == len(set(names))
        assert all(isinstance(action, argparse.Action) for action in parser._actions)
