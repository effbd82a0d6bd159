"""The paper's surrogate: what `deltaid reproduce` promises, read from what it writes."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from rich.cells import cell_len

from command import Outcome, refused, run
from deltaid import load_robot
from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.identification.identify import identify
from deltaid.model.record import IdentifiedModel
from deltaid.motion.random_motion import random_motion
from deltaid.reproduce.accuracy import (
    Accuracy,
    DriveMotion,
    accuracy,
    drive_motion,
    motion_terms,
    sweep,
)
from deltaid.reproduce.descent import WAYS, descend
from deltaid.reproduce.files import IRB360_FILES, SURROGATE_FILES
from deltaid.reproduce.surrogate import SurrogateSettings
from deltaid.reproduce.table_one import ABOVE, BELOW, nominal_robot, regularisation
from deltaid.robot.inertia import consistency
from identified import identified

# The motion of the default run; fewer points, steps and solvers, and a quarter of the samples with
# half of the noise, which tell as much.
SETTINGS = SurrogateSettings(
    methods=("conic",), points=100, gammas=(1e-12, 1e-8, 1e-5, 1e-2), iterations=60,
    repeats=1, rate=500.0, torque_noise=0.01,
)  # fmt: skip
STARTS = 1


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("reproduced") / "surrogate"


@pytest.fixture(scope="module")
def outcome(folder: Path) -> Iterator[Outcome]:
    with patch("deltaid.reproduce.surrogate.QUICK", SETTINGS):
        yield run("reproduce", "surrogate", "--quick", "--starts", STARTS, "-o", folder)


@pytest.fixture(scope="module")
def results(folder: Path, outcome: Outcome) -> dict:
    assert outcome.code == 0, outcome.err
    return json.loads((folder / "results.json").read_text(encoding="utf-8"))


def motion(dynamics: Dynamics) -> DriveMotion:
    found = random_motion(dynamics.kinematics, np.random.default_rng(3))
    return drive_motion(dynamics, found, np.linspace(0.0, found.period, 50))


def test_terms_add_up_to_the_torque(irb360: Dynamics) -> None:
    along, p = motion(irb360), prior_parameters(irb360.robot)
    terms, gravity = motion_terms(irb360, along, p), irb360.terms(along.q, along.qd, p).g
    total = terms.coriolis + terms.acceleration + gravity + terms.friction
    expected = irb360.inverse_dynamics(along.q, along.qd, along.qdd, p)
    np.testing.assert_allclose(total, expected, atol=1e-9)


def test_errors_of_a_tenth_are_called_so(irb360: Dynamics) -> None:
    along, truth = motion(irb360), prior_parameters(irb360.robot)
    found = accuracy(irb360, along, truth, 1.1 * truth)
    for share in (found.coriolis, found.acceleration, found.friction, found.coefficients):
        np.testing.assert_allclose(share, 0.1, rtol=1e-9)
    M = irb360.mass_matrix(along.q, truth)
    diagonal = [0.1 * M[:, k, k].max() / M[:, k, k].mean() for k in range(4)]
    assert found.mass_diagonal == pytest.approx(max(diagonal))
    assert (found.definite, found.samples) == (50, 50)
    assert accuracy(irb360, along, truth, -truth).definite == 0


def test_weights_and_ways_down_are_judged_by_the_truth() -> None:
    known = identified("clavel-delta3")
    along, objective = motion(known.dynamics), known.result.problem.objective
    judged: list[np.ndarray] = []

    def judge(x: np.ndarray) -> Accuracy:
        judged.append(x)
        return accuracy(known.dynamics, along, known.p, objective.reduction.parameters(x))

    light, heavy = sweep(objective, judge, (1e-8, 1e-2))
    assert (light.gamma, heavy.gamma) == (1e-8, 1e-2)
    assert heavy.accuracy.mass_diagonal > 3 * light.accuracy.mass_diagonal
    judged.clear()
    found = descend(objective, judge, iterations=5)
    assert [way.way for way in found.ways] == list(WAYS)
    ends = iter(judged)
    for way in found.ways:
        if way.usual is not None:
            next(ends)
        apart = (next(ends) - found.conic.x) / objective.reduction.scale
        assert way.distance == pytest.approx(np.linalg.norm(apart))
        assert way.objective[0] > way.objective[-1] >= found.conic.objective * (1 - 1e-9)
        assert way.at_end.samples == 50


def fits(results: dict, *, noise: bool) -> list[dict]:
    found = [fit for fit in results["fits"] if fit["noise"] == noise and fit["method"] == "conic"]
    assert {fit["prior"] for fit in found} == {"RG1", "RG2"}
    return found


@pytest.mark.slow
def test_without_noise_the_truth_comes_out_from_both_sides(results: dict) -> None:
    for fit in fits(results, noise=False):
        for checked in (fit, fit["verification"]):
            assert checked["mass_diagonal"] < 1e-4
            assert checked["mass_off_diagonal"] < 1e-4
            assert max(map(abs, checked["friction_coefficients"])) < 1e-4
            assert max(checked["coriolis"] + checked["acceleration"]) < 1e-3
        assert fit["duality_gap"] <= 1e-6 * fit["objective"]


@pytest.mark.slow
def test_with_noise_the_model_is_still_right(results: dict) -> None:
    for fit in fits(results, noise=True):
        for checked in (fit, fit["verification"]):
            assert checked["mass_diagonal"] < 0.01
            assert checked["mass_off_diagonal"] < 0.02
            assert max(map(abs, checked["friction_coefficients"])) < 0.03
        assert 1e-3 < fit["noise_level"] < 0.02  # white 1 %, most of it beyond the filter's cut-off


@pytest.mark.slow
def test_mass_matrix_is_positive_definite_along_all_motions(results: dict) -> None:
    for fit in results["fits"]:
        for checked in (fit, fit["verification"]):
            assert checked["samples"] > 10_000
            assert checked["cholesky_succeeds"] == checked["samples"]


@pytest.mark.slow
def test_numbers_are_those_of_the_saved_models(
    results: dict, folder: Path, irb360: Dynamics
) -> None:
    # Recomputed from the model files and the recording, along the motion of the data.
    truth = IdentifiedModel.load(folder / "ID1.yaml").p
    log = np.genfromtxt(folder / "identify.csv", delimiter=",", names=True)
    q = np.column_stack([log[f"q{i}"] for i in (1, 2, 3, 4)])
    model = IdentifiedModel.load(folder / "ID2-noisy.yaml")
    M_true, M = irb360.mass_matrix(q, truth), irb360.mass_matrix(q, model.p)
    error = np.abs(M - M_true).max(axis=0) / np.abs(M_true.mean(axis=0))
    fit = next(f for f in results["fits"] if f["prior"] == "RG2" and f["noise"])
    np.testing.assert_allclose(np.diag(error), np.diag(fit["mass"]), rtol=0.05)
    assert np.isclose(error[0, 1], fit["mass"][0][1], rtol=0.05)


@pytest.mark.slow
def test_files_repeat_the_fit(results: dict, folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} == set(SURROGATE_FILES)
    again = identify(load_robot(folder / "RG1.yaml"), [folder / "identify-noisy.csv"])
    saved = IdentifiedModel.load(folder / "ID1-noisy.yaml")
    np.testing.assert_allclose(again.model.p, saved.p, rtol=1e-9)


@pytest.mark.slow
def test_regularisations_lie_below_and_above_the_truth(results: dict) -> None:
    for parameter in results["parameters"]:
        below, above = (parameter[rg] / parameter["nominal"] for rg in ("RG1", "RG2"))
        assert 0.6 <= below <= 0.8, parameter["name"]
        assert 1.25 <= above <= 1.6, parameter["name"]


def test_bodies_are_consistent_and_without_accidental_symmetry() -> None:
    nominal = nominal_robot(load_robot("irb360-6-1600"))
    rng = np.random.default_rng(3)
    robots = [nominal, *(regularisation(nominal, "RG", share, rng) for share in (BELOW, ABOVE))]
    for robot in robots:
        for name, body in robot.bodies.items():
            p = body.prior_parameters()
            assert consistency(p) > 0, name
            if name != "P":  # only its mass shows
                assert len(set(np.round(p[4:7], 12))) == 3, name
            moments = {f"mc{axis}": p[1 + k] for k, axis in enumerate("xyz")}
            assert all((value != 0) == (entry in body.free) for entry, value in moments.items())


@pytest.mark.slow
def test_other_minimisers_end_above_the_certified_optimum(results: dict) -> None:
    for descents in results["minimisers"]:
        best = descents["conic"]
        assert best["duality_gap"] <= 1e-6 * best["objective"]
        ends = {way["way"]: way["objective"] for way in descents["ways"]}
        assert set(ends) == {"newton", "levenberg-marquardt", "bfgs", "relaxed"}
        assert min(ends.values()) >= best["objective"] * (1 - 1e-9)
        assert ends["relaxed"] < 1.1 * best["objective"]
        assert max(ends.values()) > 1.5 * best["objective"]


@pytest.mark.slow
def test_errors_grow_with_gamma_without_noise(results: dict) -> None:
    for swept in results["gamma_sweep"]:
        gammas = [point["gamma"] for point in swept["points"]]
        assert gammas == list(SETTINGS.gammas)
        errors = [point["mass_diagonal"] for point in swept["points"]]
        if swept["noise"]:
            assert errors[-1] > 10 * errors[0]
            assert 1e-9 < swept["chosen_gamma"] < 1e-6
        else:
            assert errors == sorted(errors)
            assert errors[0] < 1e-6


@pytest.mark.slow
def test_table_and_report_hold_the_papers_numbers_beside_ours(
    outcome: Outcome, results: dict, folder: Path
) -> None:
    lines = {line.split("  ")[0]: line for line in outcome.out.splitlines()}
    assert "below 1 %" in lines["M on the diagonal"]
    assert "under 2.2 %" in lines["friction coefficients"]
    samples = results["fits"][0]["samples"]
    assert f"Cholesky factor at {samples} of {samples} samples" in outcome.out
    assert max(cell_len(line) for line in outcome.out.splitlines()[:7]) <= 80
    text = (folder / "report.html").read_text(encoding="utf-8")
    for figure in ("Fig. 3", "Fig. 4", "Fig. 5", "Fig. 6"):
        assert f"{figure} of the paper" in text


@pytest.mark.parametrize("example", ["surrogate", "irb360"])
def test_folder_that_cannot_be_made_is_refused(tmp_path: Path, example: str) -> None:
    (tmp_path / "taken").write_text("")
    message = refused("reproduce", example, "-o", tmp_path / "taken", folder=tmp_path)
    assert "taken" in message


@pytest.mark.parametrize(
    ("example", "names"), [("surrogate", SURROGATE_FILES), ("irb360", IRB360_FILES)]
)
def test_a_file_that_cannot_be_written_is_reported_before_any_work(
    tmp_path: Path, example: str, names: Sequence[str]
) -> None:
    for name in names:
        place = tmp_path / name.replace(".", "-")
        (place / name).mkdir(parents=True)
        assert f"{name}: is a folder" in refused("reproduce", example, "-o", place, folder=tmp_path)
