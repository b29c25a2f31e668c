"""Quasi-static shear: a published series, the slow twin, symmetries, and what is refused."""

from dataclasses import fields, replace

import numpy as np
import pytest
from helpers import DATA, jammed, refused, sixteen

import petscjam as pj
from petscjam.base.errors import InputError
from petscjam.cli import main
from petscjam.io.results import append_result, read_results
from petscjam.reference import aqs as twin

SERIES = np.loadtxt(DATA / "jambashbulk-dataN16-P1e-3-SR003-step007-0001.txt", skiprows=5)
SERIES = SERIES[np.argsort(SERIES[:, 0])]  # bisections jump back and forth
PUBLISHED = (594.7e-6, 2.1257e-3, 13.3964e-3)  # strains of the three changes, roughly

# γ is in units of the edge of a square of the same area; the height of the cell is larger
CELL = sixteen().box.cell
GAMMA, STRESS, CONTACTS, PRESSURE, Z = SERIES[:, [0, 1, 2, 6, 7]].T
GAMMA = GAMMA * sixteen().box.area ** 0.5 / CELL[1, 1]


# --- against others


@pytest.mark.parametrize("locate", [True, False])
def test_published_series_of_sixteen_disks(locate):
    """Every state of jamBashBulk's series: each continues from the one before it."""
    packing, now, events = sixteen(), 0.0, 0
    for gamma, *state in zip(GAMMA[1:], STRESS[1:], CONTACTS[1:], PRESSURE[1:], Z[1:], strict=True):
        path = pj.aqs(packing, gamma - now, gamma - now, locate=locate)
        packing, now, events = path.geometry, gamma, events + len(path.events)
        np.testing.assert_allclose([path.stress[-1], path.pressure[-1]], [state[0], state[2]], rtol=0, atol=1e-14)
        assert (path.contacts[-1], path.Z[-1]) == (state[1], state[3])
        assert path.proved.all()
    assert events == (3 if locate else 0)


def test_published_changes_of_contacts():
    path = pj.aqs(sixteen(), 1.4e-2, 1e-2)
    assert [path.kind(e) for e in range(3)] == ["lost", "made", "lost"]
    for k, rough in zip(path.events, PUBLISHED, strict=True):
        near = np.flatnonzero(abs(GAMMA - rough) < 0.01 * rough)
        change = near[np.flatnonzero(np.diff(CONTACTS[near]))]  # the last state before it
        assert len(change) == 1
        assert GAMMA[change[0]] < path.gamma[k + 1]
        assert path.gamma[k] < GAMMA[change[0] + 1]
        assert 0 < path.gamma[k + 1] - path.gamma[k] <= 1e-10


@pytest.mark.parametrize("strain", [2e-2, pytest.param(-3e-2, marks=pytest.mark.slow)])
def test_changes_and_instability_equal_the_slow_twin(strain):
    packing = jammed(1e-2, 16, 1)
    assert packing.certificate.rattlers == 0
    changes = twin.changes(packing.positions, packing.radii, packing.box.cell, strain, 1e-3)
    path = pj.aqs(packing, strain, 0.1, len(changes))
    assert len(path.events) == len(changes) > 1
    for e, (k, change) in enumerate(zip(path.events, changes, strict=True)):
        assert abs(path.gamma[k]) - 1e-11 < abs(change.strain) < abs(path.gamma[k + 1]) + 1e-11
        assert path.stress[k] == pytest.approx(change.stress, abs=1e-10)
        assert [e, *change[1:4]] in path.contact_changes.tolist()
        if change.eigenvalue > 0:
            assert path.kind(e) == ("made" if change.change == 1 else "lost")
            assert path.eigenvalue[k + 1] == pytest.approx(change.eigenvalue, rel=1e-7)
            assert abs(path.drop[e]) < 1e-10
    assert changes[-1].eigenvalue < 0
    assert path.kind(len(changes) - 1) == "instability"
    assert path.drop[-1] > 1e-6


# --- what a path obeys


def test_modulus_and_stress_are_derivatives_of_stress_and_energy():
    packing, h = jammed(1e-2, 64, 7, potential_name="hertzian"), 1e-6

    def energy(packing):
        network = pj.ContactNetwork.of(packing)
        sigma = packing.radii[network.i] + packing.radii[network.j]
        return packing.potential.energy(network.distance, sigma).sum() / packing.box.area

    ahead, back = pj.aqs(packing, h, h), pj.aqs(packing, -h, h)
    assert not len(ahead.events)
    assert not len(back.events)
    assert ahead.G0 == pytest.approx((ahead.stress[-1] - back.stress[-1]) / (2 * h), rel=1e-5)
    assert ahead.G0 == pytest.approx(pj.quasistatic_response(packing).G0, rel=1e-8)
    slope = (energy(ahead.geometry) - energy(back.geometry)) / (2 * h)
    assert ahead.stress[0] == pytest.approx(slope, rel=1e-5)


def same_path(a, b, sign=1, rel=1e-7):
    np.testing.assert_allclose(b.gamma, sign * a.gamma, rtol=0, atol=1.5e-10)
    np.testing.assert_allclose(b.stress, sign * a.stress, rtol=rel, atol=1e-10)
    np.testing.assert_allclose(b.eigenvalue, a.eigenvalue, rtol=1e-5)
    for name in ("contacts", "reversible", "events", "contact_changes"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_mirrored_packing_with_the_opposite_strain():
    packing = jammed(1e-2, 16, 1)
    mirrored = replace(packing, positions=packing.positions * [-1, 1], box=pj.Box(packing.box.cell * [-1, 1]))
    same_path(pj.aqs(packing, 1.5e-2, 1e-2), pj.aqs(mirrored, -1.5e-2, 1e-2), sign=-1)


def test_another_cell_of_the_same_lattice():
    packing = jammed(1e-2, 16, 1)
    tilted = replace(packing, box=pj.Box(np.array([[1, 0], [1, 1]]) @ packing.box.cell))
    same_path(pj.aqs(packing, 1.5e-2, 1e-2), pj.aqs(tilted, 1.5e-2, 1e-2))


def test_states_are_kept_at_every_step_and_beside_every_event():
    path = pj.aqs(sixteen(), -1e-3, 3e-4)
    beside = np.concatenate([path.events, path.events + 1])
    np.testing.assert_allclose(np.delete(path.gamma, beside), [0, -3e-4, -6e-4, -9e-4, -1e-3], rtol=1e-14)
    only = pj.aqs(sixteen(), -1e-3, 3e-4, locate=False)
    np.testing.assert_allclose(only.gamma, [0, -3e-4, -6e-4, -9e-4, -1e-3], rtol=1e-14)
    np.testing.assert_allclose(only.stress, np.delete(path.stress, beside), atol=1e-14)


def test_half_the_step_gives_the_same_events():
    packing = jammed(1e-3, 64, 3)
    whole, half = (pj.aqs(packing, 2e-3, step) for step in (1e-3, 5e-4))
    assert len(whole.events) == 3
    np.testing.assert_allclose(whole.gamma[whole.events], half.gamma[half.events], rtol=0, atol=1e-10)
    np.testing.assert_array_equal(whole.contact_changes, half.contact_changes)


def there_and_back(packing, strain):
    there = pj.aqs(packing, strain, strain)
    back = pj.aqs(there.geometry, -strain, strain)
    assert back.stress[-1] == pytest.approx(there.stress[0], abs=1e-12)
    return there, back, strain + back.gamma[back.events]


def test_a_reversible_change_is_undone_at_its_strain():
    there, back, at = there_and_back(jammed(1e-2, 16, 1), 1.15e-2)
    assert there.reversible.tolist() == back.reversible.tolist() == [True]
    assert there.contact_changes[0, 3] == -back.contact_changes[0, 3] == -1
    assert at[0] == pytest.approx(there.gamma[there.events[0]], abs=1.5e-10)


def test_an_instability_has_a_hysteresis():
    there, back, at = there_and_back(jammed(1e-2, 16, 1), 1.3e-2)
    (up,), (down,) = there.gamma[there.events[~there.reversible]], at[~back.reversible]
    assert down < up - 1e-3
    assert there.drop[-1] > 1e-4
    assert back.drop[0] > 1e-4


def test_lowest_eigenvalue_vanishes_as_the_square_root_before_an_instability():
    """With Hertzian contacts K is continuous along a path, and a minimum is lost in a saddle-node bifurcation."""
    packing = jammed(1e-2, 16, 9, potential_name="hertzian")
    path = pj.aqs(packing, 0.1, 0.1, 3)
    assert path.reversible.tolist() == [True, True, False]
    assert path.eigenvalue[-2] < 1e-5
    before = pj.aqs(packing, path.gamma[-1] - 1e-6, 0.1).geometry
    near = [pj.aqs(before, 1e-6 - d, 0.1) for d in (4e-8, 1e-8)]
    assert near[0].eigenvalue[-1] / near[1].eigenvalue[-1] == pytest.approx(2, rel=0.02)
    assert near[1].modulus[-1] / near[0].modulus[-1] == pytest.approx(2, rel=0.02)


def test_a_path_ends_where_the_packing_unjams():
    packing = jammed(1e-4, 64, 1, shear_stabilised=True)
    path = pj.aqs(packing, 1e-3, 1e-3)
    assert "unjams" in path.notes[-1]
    assert len(path.gamma) == 2
    assert path.proved.all()
    F = np.array([[1, 1e-8], [0, 1]])
    last = path.geometry
    with pytest.raises(InputError, match="not jammed"):
        pj.relax_packing(replace(last, positions=last.positions @ F.T, box=last.box.deformed(F)))


# --- files and command


def test_stored_and_exported(tmp_path, capsys):
    path = pj.aqs(jammed(1e-2, 16, 1), 1.5e-2, 5e-3)
    append_result(path, tmp_path / "path.h5", "one")
    again = read_results(tmp_path / "path.h5")["one"]
    for item in fields(path):
        a, b = getattr(path, item.name), getattr(again, item.name)
        assert a.checksum == b.checksum if item.name == "geometry" else np.array_equal(a, b), item.name
    assert main(["export", str(tmp_path / "path.h5")]) == 0
    table = np.genfromtxt(tmp_path / "path.csv", delimiter=",", names=True, skip_header=2, dtype=None, encoding=None)
    np.testing.assert_array_equal(table["stress"], path.stress)
    assert table["event"][path.events + 1].tolist() == [path.kind(e) for e in range(len(path.events))]
    assert (table["event"] != "").sum() == len(path.events)


def test_a_path_without_events_is_stored_drawn_and_exported(tmp_path, capsys):
    path = pj.aqs(sixteen(), -1e-4, 1e-4)
    append_result(path, tmp_path / "path.h5", "one")
    assert len(read_results(tmp_path / "path.h5")["one"].events) == 0
    for verb in ("info", "plot", "export"):
        assert main([verb, str(tmp_path / "path.h5")]) == 0


def test_unproved_packing_is_sheared_with_a_note():
    assert any("no certificate" in note for note in pj.aqs(sixteen(), 1e-4, 1e-4).notes)
    packing = jammed(1e-2, 16, 1)
    pushed = replace(packing, positions=packing.positions + np.outer(np.arange(16) == 0, [1e-4, 0]))
    path = pj.aqs(pushed, 1e-4, 1e-4)
    assert any("not in balance" in note for note in path.notes)
    assert any("relaxed packing" in note for note in path.notes)
    assert path.stress[0] == pytest.approx(-pj.ContactNetwork.of(packing).stress[0, 1], rel=1e-9)
    assert path.proved.all()


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"strain": 0}, "strain must be from 1e-10 to 10, not 0"),
        ({"strain": np.nan}, "nan"),
        ({"strain": "far"}, "'far'"),
        ({"step": 0.0}, "step must be"),
        ({"step": np.nan}, "nan"),
        ({"events": 0}, "events must be"),
        ({"events": 3, "locate": False}, "without located events"),
        ({"strain": 1.0, "step": 1e-7}, "more than 1e6 states"),
        ({"prestress": False}, "pre-stress"),
    ],
)
def test_arguments_out_of_range_are_named(given, named):
    with pytest.raises(InputError, match=named):
        pj.aqs(sixteen(), **given)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--strain", "0"], "not 0"),
        (["--strain", "nan"], "nan"),
        (["--step", "0"], "0"),
        (["--events", "-1"], "-1"),
        (["--no-prestress"], "unknown argument --no-prestress"),
    ],
)
def test_command_refuses_the_same(options, named, tmp_path, capfd):
    jammed(1e-2, 16, 1).write(tmp_path / "p.h5")
    assert named in refused(capfd, "aqs", tmp_path / "p.h5", *options, "-o", tmp_path / "a.h5")
    assert not (tmp_path / "a.h5").exists()


def test_output_that_exists_is_kept(tmp_path, capfd):
    jammed(1e-2, 16, 1).write(tmp_path / "p.h5")
    (tmp_path / "a.h5").write_text("mine")
    assert "exists" in refused(capfd, "aqs", tmp_path / "p.h5", "-o", tmp_path / "a.h5")
    assert (tmp_path / "a.h5").read_text() == "mine"
