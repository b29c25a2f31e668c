"""Many packings and laws: teams, resuming, failures, averages, and one model for a sweep over β or ηF."""

from pathlib import Path

import numpy as np
import pytest

import petscjam as pj
from petscjam.analysis.statistics import average
from petscjam.base.errors import InputError
from petscjam.base.files import atomic_h5
from petscjam.cli import main
from petscjam.io.jobs import Ensemble, ModulusAnalysis, analyse

OMEGA = np.geomspace(1e-4, 10, 6)
ROUNDING = 1e-10  # of the direct solves that are compared with


@pytest.fixture(scope="module")
def packings(three_packings):
    return sorted(three_packings.glob("*.h5"))


ROLLING = [pj.ContactDamping()]


def run(files, output, comm, *, laws=ROLLING, log=lambda line: None, settings=None, **options):
    analysis = ModulusAnalysis(OMEGA, **(settings or {}))
    return analyse(Ensemble(files, output, laws, **options), analysis, comm=comm, log=log)


def shared(tmp_path, comm):
    return comm.bcast(tmp_path / "g.h5")


@pytest.mark.parallel(nprocs=[1, 2, 3])
@pytest.mark.parametrize("team_size", [None, 2])
def test_every_packing_law_and_prestress_gets_its_modulus(packings, tmp_path, comm, team_size):
    output = shared(tmp_path, comm)
    laws = [pj.ContactDamping(), pj.ContactDamping(0.01), pj.StokesDrag()]
    assert run(packings, output, comm, laws=laws, prestress=[True, False], team_size=team_size) == (18, [])
    results = pj.read_moduli(output)
    assert len(results) == 18
    comm.barrier()
    for g in list(results.values())[comm.rank :: comm.size]:
        file = next(file for file in packings if file.stem == g.origin.name)
        law = g.damping
        exact = pj.complex_modulus(
            pj.Packing.read(file), OMEGA, damping=law, prestress=g.prestress, comm=_alone()
        ).values
        assert (abs(g.values / exact - 1) <= g.errors + ROUNDING).all()
        assert g.errors.max() <= 1.1e-6


def _alone():
    from mpi4py import MPI

    return MPI.COMM_SELF


@pytest.mark.parallel(nprocs=[1, 2])
def test_a_packing_that_cannot_be_solved_stops_no_other(packings, tmp_path, comm):
    output = shared(tmp_path, comm)
    loose = output.with_name("loose.h5")
    if comm.rank == 0:
        p = pj.Packing.read(packings[0])
        pj.Packing(p.positions, p.radii / 2, p.box).write(loose)
    comm.barrier()
    made, failures = run([loose, *packings], output, comm)
    assert made == 3
    assert len(failures) == 1
    assert "loose.h5" in failures[0]
    assert "no contacts" in failures[0]
    assert len(pj.read_moduli(output)) == 3


def test_one_packing_that_cannot_be_solved_is_an_error(packings, tmp_path, comm):
    p = pj.Packing.read(packings[0])
    pj.Packing(p.positions, p.radii / 2, p.box).write(tmp_path / "loose.h5")
    with pytest.raises(InputError, match="no contacts"):
        run([tmp_path / "loose.h5"], tmp_path / "g.h5", comm)


def test_resume_makes_the_laws_that_are_missing(packings, tmp_path, comm):
    lines = []
    laws = [pj.StokesDrag(1.0), pj.StokesDrag(0.5), pj.ContactDamping()]
    run(packings[:1], tmp_path / "g.h5", comm, laws=laws)
    run(packings, tmp_path / "g.h5", comm, laws=laws, resume=True, log=lines.append)
    assert len(lines) == 6
    assert not [line for line in lines if line.startswith("p1-")]
    assert len(pj.read_moduli(tmp_path / "g.h5")) == 9


def test_resume_refuses_another_law(packings, tmp_path, comm):
    run(packings[:1], tmp_path / "g.h5", comm)
    with pytest.raises(InputError, match="stokes"):
        run(packings, tmp_path / "g.h5", comm, laws=[pj.StokesDrag()], resume=True)


@pytest.mark.parallel(nprocs=2)
def test_overwrite_replaces_all_of_an_older_file(packings, tmp_path, comm):
    output = shared(tmp_path, comm)
    run(packings, output, comm)
    run(packings[:2], output, comm, overwrite=True)
    assert len(pj.read_moduli(output)) == 2
    comm.barrier()
    assert sorted(file.name for file in output.parent.iterdir()) == ["g.h5"]


def test_resume_with_more_laws_makes_no_result_twice(packings, tmp_path, comm):
    run(packings[:1], tmp_path / "g.h5", comm)
    made, _ = run(packings[:1], tmp_path / "g.h5", comm, laws=[pj.ContactDamping(), pj.StokesDrag()], resume=True)
    assert made == 1
    assert len(pj.read_moduli(tmp_path / "g.h5")) == 2


@pytest.mark.parametrize(
    ("first", "then", "named"),
    [({"rtol": 1e-2}, {"rtol": 1e-8}, "rtol"), ({}, {"direct": True}, "reduced"), ({"direct": True}, {}, "solve")],
)
def test_resume_refuses_what_was_found_in_another_way(packings, tmp_path, comm, first, then, named):
    run(packings[:1], tmp_path / "g.h5", comm, settings=first)
    with pytest.raises(InputError, match=named):
        run(packings, tmp_path / "g.h5", comm, resume=True, settings=then)


@pytest.mark.parametrize(
    "laws", [[pj.ContactDamping(b) for b in (0.1, 1, 10, 100)], [pj.StokesDrag(0), pj.StokesDrag(9)]]
)
def test_results_do_not_depend_on_resuming(packings, tmp_path, comm, laws):
    settings = {"rtol": 1e-2, "family": True}
    run(packings[:1], tmp_path / "whole.h5", comm, laws=laws, settings=settings)
    run(packings[:1], tmp_path / "parts.h5", comm, laws=laws, settings=settings)
    with atomic_h5(tmp_path / "parts.h5", existing=True) as h5:
        del h5[next(iter(h5))]
    run(packings[:1], tmp_path / "parts.h5", comm, laws=laws, settings=settings, resume=True)
    whole, parts = (pj.read_moduli(tmp_path / name) for name in ("whole.h5", "parts.h5"))
    assert whole.keys() == parts.keys()
    for name, g in whole.items():
        assert (parts[name].values == g.values).all()


def test_overwrite_takes_the_place_of_any_file(packings, tmp_path, comm):
    (tmp_path / "g.h5").write_text("not HDF5")
    run(packings[:1], tmp_path / "g.h5", comm, overwrite=True)
    assert len(pj.read_moduli(tmp_path / "g.h5")) == 1


def test_a_line_of_the_log_says_what_it_cost(packings, tmp_path, comm):
    lines = []
    run(packings[:1], tmp_path / "g.h5", comm, log=lines.append)
    g = pj.read_modulus(tmp_path / "g.h5")
    assert f"{g.performance['factorisations']} factorisations" in lines[0]
    assert f"error bound {g.errors.max():.1e}" in lines[0]
    for word in ("MUMPS", "MB", "flops", " s"):
        assert word in lines[0]


def test_direct_moduli_of_several_laws(packings, tmp_path, comm):
    laws = [pj.ContactDamping(beta) for beta in (0.1, 0.2, 0.3, 0.4)]
    run(packings[:1], tmp_path / "g.h5", comm, laws=laws, settings={"direct": True})
    results = pj.read_moduli(tmp_path / "g.h5").values()
    assert {g.damping for g in results} == set(laws)
    assert all(g.model is None and g.performance["factorisations"] == len(OMEGA) for g in results)


# --- averages


@pytest.fixture(scope="module")
def moduli(packings):
    return {
        file.stem: pj.ComplexModulus.sampled(pj.spectrum(pj.Packing.read(file), (1e-4, 10.0)), OMEGA)
        for file in packings
    }


def test_mean_scatter_and_error(moduli):
    mean = average(moduli)
    values = np.array([g.values for g in moduli.values()])
    assert mean.count == 3
    assert np.allclose(mean.mean, values.sum(0) / 3, rtol=1e-14)
    deviations = values - values.sum(0) / 3
    assert np.allclose(mean.scatter.real, np.sqrt((deviations.real**2).sum(0) / 2), rtol=1e-12)
    assert np.allclose(mean.scatter.imag, np.sqrt((deviations.imag**2).sum(0) / 2), rtol=1e-12)
    assert np.allclose(mean.error, mean.scatter / 3**0.5, rtol=1e-14)


def test_models_average_on_any_common_grid(moduli):
    omega = np.array([3e-4, 0.7])
    mean = average(moduli, omega)
    assert np.allclose(mean.mean, sum(g.model(omega) for g in moduli.values()) / 3, rtol=1e-14)


def test_no_average_outside_what_is_known(moduli):
    with pytest.raises(InputError, match="grid"):
        average(moduli, [1e3])


def test_unstable_packings_are_left_out_and_named(moduli):
    from dataclasses import replace

    name, g = next(iter(moduli.items()))
    mixed = {**moduli, name: replace(g, G0=-1.0)}
    assert average(mixed).excluded == (name,)
    assert average(mixed).count == 2
    assert average(mixed, unstable=True).count == 3
    with pytest.raises(InputError, match="none of 1"):
        average({name: mixed[name]})


def test_an_average_is_exported(packings, moduli, tmp_path):
    arguments = [*map(str, packings), "--omega", "1e-4:10:6"]
    assert main(["moduli", *arguments, "-o", str(tmp_path / "g.h5")]) == 0
    assert main(["export", str(tmp_path / "g.h5"), "--average", "-o", str(tmp_path / "mean.csv")]) == 0
    columns = np.loadtxt(tmp_path / "mean.csv", delimiter=",", skiprows=3).T
    mean = average(moduli)
    assert np.allclose(columns[0], OMEGA, rtol=1e-11)
    for values, (storage, loss) in zip(
        (mean.mean, mean.scatter, mean.error), columns[1:].reshape(3, 2, -1), strict=True
    ):
        assert np.allclose(storage + 1j * loss, values, rtol=1e-5)
    pattern = ["export", str(tmp_path / "g.h5"), "--average", "--group"]
    assert main([*pattern, "p[12]-*", "-o", str(tmp_path / "two.csv")]) == 0
    assert "mean of 2 packings" in (tmp_path / "two.csv").read_text()
    assert main([*pattern, "none*", "-o", str(tmp_path / "none.csv")]) == 2


def test_different_laws_do_not_average(moduli, packings):
    other = pj.ComplexModulus.sampled(
        pj.spectrum(pj.Packing.read(packings[0]), (1e-4, 10.0), damping=pj.StokesDrag()), OMEGA
    )
    with pytest.raises(InputError, match="different laws"):
        average({**moduli, "other": other})


# --- a sweep over β


@pytest.fixture(scope="module", params=[True, False], ids=["pre-stress", "no pre-stress"])
def family(request, packings):
    packing = pj.Packing.read(packings[0])
    return packing, request.param, pj.beta_family(packing, (1e-5, 1e2), prestress=request.param)


@pytest.mark.parametrize("beta", [1e-5, 3e-4, 0.02, 0.5, 1.0, 7.0, 100.0])
def test_a_family_holds_at_every_beta(family, beta):
    packing, prestress, models = family
    omega = np.geomspace(1e-8, 1e2, 21)
    exact = pj.complex_modulus(packing, omega, damping=pj.ContactDamping(beta), prestress=prestress).values
    s = models(beta)
    assert (abs(s(omega) / exact - 1) <= s.error(omega) + ROUNDING).all()
    storage, loss = s.part_errors(omega)
    assert (abs(s(omega).real / exact.real - 1) <= storage + ROUNDING).all()
    assert (abs(s(omega).imag / exact.imag - 1) <= loss + ROUNDING).all()
    assert s.error(omega).max() <= 2e-6
    assert not s.definite  # an estimate


def test_a_family_needs_far_fewer_factorisations_than_its_members(family):
    packing, prestress, models = family
    betas = np.geomspace(1e-5, 1e2, 8)
    alone = sum(
        pj.spectrum(packing, damping=pj.ContactDamping(beta), prestress=prestress).factorisations for beta in betas
    )
    assert models.factorisations < alone / 2


def test_limits_of_a_family(family):
    packing, prestress, models = family
    exact = pj.complex_modulus(packing, [1.0], damping=pj.ContactDamping(0.3), prestress=prestress)
    s = models(0.3)
    for ours, theirs in ((s.G0, exact.G0), (s.eta0, exact.eta0), (s.eta_inf, exact.eta_inf)):
        assert ours == pytest.approx(theirs, rel=1e-6)


def test_displacements_of_a_family(family):
    packing, prestress, models = family
    field = pj.complex_modulus(
        packing, [0.1], damping=pj.ContactDamping(0.3), prestress=prestress, fields_at=[0.1]
    ).fields[0]
    ours = models(0.3).displacement(0.1)
    seen = ~np.isnan(field.real)
    assert abs(ours - field)[seen].max() < 1e-3 * abs(field)[seen].max()


def test_a_family_knows_its_range(family):
    with pytest.raises(InputError, match="outside"):
        family[2](1e-6)


def test_a_family_promises_nothing_outside_its_span(packings):
    models = pj.beta_family(pj.Packing.read(packings[0]), (1.0, 4.0), (1.0, 10.0))
    assert models(2.0).error(3.0) < 1e-5
    assert models(2.0).error(1e-4) == np.inf


def test_limits_beyond_the_span_of_a_family_are_not_made_up(packings):
    packing = pj.Packing.read(packings[0])
    s = pj.beta_family(packing, (1.0, 4.0), (1.0, 10.0))(2.0)
    exact = pj.complex_modulus(packing, [1.0], damping=pj.ContactDamping(2.0))
    assert s.G0 == pytest.approx(exact.G0, rel=1e-8)  # the same for all β: solved for
    assert np.isnan([s.eta0, s.eta_inf]).all()
    assert "beyond the span" in " ".join(s.notes)


@pytest.mark.parallel(nprocs=3)
def test_a_family_with_a_rank_that_owns_nothing(comm):
    triangle = pj.Packing([[0.0, 0.0], [0.5, 0.0]], [0.26, 0.26], pj.Box([[1.0, 0.0], [0.2, 0.45]]))
    models = pj.beta_family(triangle, (0.1, 1.0), (1e-2, 1e2), prestress=False, comm=comm)
    exact = pj.complex_modulus(triangle, [1.0], damping=pj.ContactDamping(0.5), prestress=False, comm=comm)
    assert models(0.5)(1.0) == pytest.approx(exact.values[0], rel=1e-9)


@pytest.mark.parametrize(
    ("betas", "options", "named"),
    [
        ((0.0, 1.0), {}, "betas: must be 0 < low ≤ high, not 0 and 1"),
        ((1.0, 0.1), {}, "betas: must be 0 < low ≤ high, not 1 and 0.1"),
        ((1.0, 1e6), {}, r"betas: at most 1000, not 1e\+06"),
        ((0.1, 1.0), {"rtol": 0.0}, "rtol: .* not 0.0"),
        ((0.1, 1.0), {"span": (1.0, 1.0)}, "span: must be 0 < low < high, not 1 twice"),
    ],
)
def test_bad_ranges_are_refused(packings, betas, options, named):
    with pytest.raises(InputError, match=named):
        pj.beta_family(pj.Packing.read(packings[0]), betas, **options)


@pytest.mark.parallel(nprocs=[2, 3])
def test_a_family_does_not_depend_on_the_ranks(packings, comm):
    packing = pj.Packing.read(packings[0])
    ours = pj.beta_family(packing, (1e-2, 1e1), comm=comm)
    alone = pj.beta_family(packing, (1e-2, 1e1), comm=_alone())
    omega = np.geomspace(1e-8, 1e2, 11)
    assert ours.factorisations == alone.factorisations
    assert abs(ours(0.2)(omega) / alone(0.2)(omega) - 1).max() < 1e-10


@pytest.mark.parametrize("family", [True, False])
def test_several_beta_are_one_model_if_that_is_asked_for(packings, tmp_path, capsys, family):
    output = tmp_path / "g.h5"
    arguments = ["moduli", str(packings[0]), "--beta", "1e-3:10:5", "-o", str(output)]
    assert main([*arguments, "--beta-family"] if family else arguments) == 0
    results = list(pj.read_moduli(output).values())
    assert {g.damping for g in results} == {pj.ContactDamping(beta) for beta in (1e-3, 1e-2, 0.1, 1.0, 10.0)}
    assert len({tuple(g.model.nodes) for g in results}) == (1 if family else 5)
    assert [g.model.definite for g in results] == [not family] * 5  # estimates, or bounds
    way = "one model in (omega, beta) for each packing; its errors are estimates" if family else "one model for each"
    assert f"5 values of beta: {way}\n" in capsys.readouterr().out


def test_all_viscosities_of_the_fluid_are_one_model(packings, tmp_path):
    output = tmp_path / "g.h5"
    arguments = ["moduli", str(packings[0]), "--damping", "stokes", "--eta-fluid", "0,1,10", "-o", str(output)]
    assert main(arguments) == 0
    results = list(pj.read_moduli(output).values())
    assert len({tuple(g.model.nodes) for g in results}) == 1
    for g in results:
        exact = pj.complex_modulus(pj.Packing.read(Path(packings[0])), g.omega[::20], damping=g.model.damping).values
        assert (abs(g.values[::20] / exact - 1) <= g.errors[::20] + ROUNDING).all()
