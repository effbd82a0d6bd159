"""The whole identification against recordings that the oracle made."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deltaid.checks.identify import identify as judged_identify
from deltaid.dynamics.dynamics import compiled
from deltaid.identification.demo import demonstrate, mass_matrix_error
from deltaid.identification.fit import with_geometry
from deltaid.identification.identify import identify
from deltaid.identification.least_squares import identify_base
from deltaid.identification.prediction import validate
from deltaid.model.record import IdentifiedModel, Settings
from deltaid.motion.surrogate import surrogate_parameters
from deltaid.robot.load import load_robot
from identified import identified
from logs import tabled
from recordings import KnownRobot, oracle_motion, stored_robot

slow = pytest.mark.slow


# Without noise a lag of microseconds, which is rounding, would be beyond chance.
EXACT = Settings(lag="none")


def errors_of(model: IdentifiedModel, z: np.ndarray, truth: np.ndarray) -> tuple[float, ...]:
    """Of M on and off the diagonal along a motion, and of friction."""
    layout = model.layout
    friction = slice(layout.viscous.start, layout.coulomb.stop)
    worst = float(np.max(np.abs(model.p[friction] / truth[friction] - 1)))
    return *mass_matrix_error(compiled(model.robot), z, truth, model.p), worst


@pytest.mark.parametrize(("name", "share"), [("delta3", 1.4), ("delta4", 0.7)])
def test_conic_recovers_the_stored_robots(tmp_path, name: str, share: float) -> None:
    known = stored_robot(name)
    motion = oracle_motion(known.oracle, np.random.default_rng(1), rate=100.0)
    exact = motion.write_exact(tmp_path / "exact.csv")
    result = identify(known.described(share), [exact], settings=EXACT)
    assert max(errors_of(result.model, motion.z, known.p)) < 1e-4
    assert result.model.consistent
    assert result.model.fit.duality_gap < 1e-6 * result.model.fit.objective


@slow
@pytest.mark.parametrize("share", [0.7, 1.4])
def test_log_cholesky_reaches_the_papers_figures(tmp_path, share: float) -> None:
    known = stored_robot("delta4")
    motion = oracle_motion(known.oracle, np.random.default_rng(2), rate=100.0)
    exact = motion.write_exact(tmp_path / "exact.csv")
    settings = EXACT.changed(method="log-cholesky")
    result = identify(known.described(share), [exact], settings=settings)
    errors = errors_of(result.model, motion.z, known.p)
    np.testing.assert_array_less(errors, (0.01, 0.02, 0.022))
    fit = result.model.fit
    assert fit.objective >= fit.lower_bound


def noisy(name: str, folder: Path) -> KnownRobot:
    """A stored robot that leaves recordings of two motions: identify.csv, verify.csv."""
    known, rng = stored_robot(name), np.random.default_rng(3)
    for log in ("identify", "verify"):
        oracle_motion(known.oracle, rng, rate=250.0).write_noisy(folder / f"{log}.csv", rng)
    return known


@pytest.mark.parametrize(
    ("name", "share"), [("delta3", 0.7), pytest.param("delta4", 1.4, marks=slow)]
)
def test_noisy_log_predicts_as_well_as_the_truth(name: str, share: float, tmp_path: Path) -> None:
    folder, known = tmp_path, noisy(name, tmp_path)
    result = identify(known.described(share), [folder / "identify.csv"])
    truth = known.p.copy()
    # The platform is a disc without thickness, which to rounding is no body; no torque shows it.
    truth[result.model.layout.names.index("P.Izz")] *= 0.999
    rows = [
        parameter.changed(value=float(value))
        for parameter, value in zip(result.model.parameters, truth, strict=True)
    ]
    true_model = result.model.changed(parameters=tuple(rows))
    ours, _ = validate(result.model, folder / "verify.csv")
    theirs, _ = validate(true_model, folder / "verify.csv")
    assert np.all(ours.rms < 1.05 * theirs.rms)
    assert np.all(ours.rms_unfiltered < 1.05 * theirs.rms_unfiltered)
    # Of the truth all of the noise is left, white and ripple.
    tau = np.loadtxt(folder / "verify.csv", delimiter=",", skiprows=1)[:, 1 + known.oracle.dof :]
    noise = np.hypot(0.02, 0.005 / np.sqrt(2)) * np.abs(tau).max(axis=0)
    np.testing.assert_allclose(theirs.rms_unfiltered, noise, rtol=0.15)


def test_demonstration_comes_close_to_the_truth(tmp_path) -> None:
    result = demonstrate(load_robot("clavel-delta3"), tmp_path, seed=3)
    assert result.mass_error_diagonal < 0.05
    assert result.mass_error_off_diagonal < 0.05
    assert result.friction_error < 0.03
    assert np.all(result.verification.nrmse < 0.03)
    assert {path.name for path in tmp_path.iterdir()} == {
        "robot.yaml",
        "identify.csv",
        "verify.csv",
        "model.yaml",
        "truth.yaml",
    }


def test_two_logs_together_are_more_certain_than_one() -> None:
    made = identified("two logs")
    single, both = (identified(name).result.problem for name in ("clavel-delta3", "two logs"))
    assert both.information.mean_samples > 1.9 * single.information.mean_samples
    logs = [made.log, made.folder / "log-2.csv"]
    estimates = [identify_base(made.dynamics, log)[1] for log in logs]
    # Intervals are estimates themselves, so a single one may come out larger. By white noise the
    # median would be at most 1/√2, against the better of the two.
    alone = with_geometry(replace(both, moves=()), made.result.recordings)  # by noise
    ratios = alone.estimate.interval / np.min([estimate.interval for estimate in estimates], axis=0)
    assert np.median(ratios) < 0.85


@pytest.fixture
def plain() -> IdentifiedModel:
    """Identified without any choice."""
    return identified("clavel-delta3").result.model


def test_model_file_gives_the_same_torques_to_the_last_bit(plain, tmp_path) -> None:
    rng = np.random.default_rng(1)
    plain.save(tmp_path / "saved.yaml")
    loaded = IdentifiedModel.load(tmp_path / "saved.yaml")
    assert loaded == plain
    dynamics = compiled(plain.robot)
    z = np.array([[0.1, -0.05, -0.9]])
    q = dynamics.kinematics.inverse(np.repeat(z, 5, axis=0))
    qd, qdd = rng.standard_normal((2, 5, 3))
    before = dynamics.inverse_dynamics(q, qd, qdd, plain.p)
    after = compiled(loaded.robot).inverse_dynamics(q, qd, qdd, loaded.p)
    assert before.tobytes() == after.tobytes()
    assert loaded.sources[0].sha256 == plain.sources[0].sha256


@pytest.mark.parametrize("regularizer", [pytest.param("entropic", marks=slow), "riemannian"])
def test_other_metrics_fit_as_well(plain: IdentifiedModel, regularizer) -> None:
    settings = Settings(regularizer=regularizer, method="log-cholesky")
    made = identified("clavel-delta3")
    other = identify(made.robot, [made.log], settings=settings).model
    assert np.allclose(other.fit.rms, plain.fit.rms, rtol=0.01)
    assert other.consistent


@pytest.mark.filterwarnings("error")
def test_drives_that_rest_keep_their_prior_and_are_named(tmp_path: Path) -> None:
    """Their positions are constant to the last bit, as of drives on brakes."""
    dynamics, rng = compiled(load_robot("irb360-6-1600")), np.random.default_rng(3)
    p, t = surrogate_parameters(dynamics.robot, rng), np.arange(4000) / 500
    q, qd, qdd = np.zeros((3, len(t), dynamics.dof))
    q[:] = dynamics.kinematics.inverse(dynamics.robot.home[None])
    for drive, (f, a) in enumerate(((0.7, 0.3), (1.1, 0.25))):
        w = 2 * np.pi * f
        q[:, drive] += a * np.sin(w * t)
        qd[:, drive], qdd[:, drive] = a * w * np.cos(w * t), -a * w**2 * np.sin(w * t)
    tau = dynamics.inverse_dynamics(q, qd, qdd, p) + rng.normal(scale=0.1, size=q.shape)
    tabled(t=t, q=q, tau=tau).write_csv(tmp_path / "log.csv")
    result = judged_identify(dynamics.robot, [tmp_path / "log.csv"])
    assert any("drive3 and drive4 hardly move" in warning for warning in result.model.warnings)
    assert result.model.fit.nrmse[3] == 0.0
    assert not any("of drive4's torque" in warning for warning in result.model.warnings)
    assert max(result.model.fit.nrmse[:2]) < 0.05
