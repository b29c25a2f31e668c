"""Every example runs, on one rank and on two, and its own assertions hold."""

from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("[0-9]*.py"))


@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_example(mpirun, example, ranks):
    run = mpirun(ranks, example)
    assert run.returncode == 0, run.stderr
    assert run.stdout


def test_there_are_examples():
    assert len(EXAMPLES) >= 3
