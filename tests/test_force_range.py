"""Ranges of constraint forces that are compatible with recordings of torques."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.estimation.ranges import ConsistentBall
from deltaid.estimation.reduction import Block
from deltaid.estimation.scatter import NORMAL
from deltaid.identification.generic_motion import random_motion_base
from deltaid.identification.identify import identify
from deltaid.joint_forces.constraint_forces import ConstraintForces
from deltaid.joint_forces.ranges import Determinacy, ForceEvidence, Ranges, evidence
from deltaid.joint_forces.unknowns import unknowns
from deltaid.model.model import load
from deltaid.model.record import IdentifiedModel
from deltaid.motion.surrogate import (
    surrogate_parameters,
    write_recording,
)
from deltaid.robot.inertia import consistency
from deltaid.robot.load import load_robot
from identified import simulated
from poor_priors import PLAIN
from support import along

SPREAD = 0.5  # default of a prior's relative standard deviation


@dataclass(frozen=True, eq=False)
class Job:
    """A surrogate robot, its identified model, and forces at some samples of another motion."""

    truth: np.ndarray
    model: IdentifiedModel
    forces: ConstraintForces
    evidence: ForceEvidence
    known: Determinacy
    coefficients: np.ndarray

    @property
    def ranges(self) -> Ranges:
        return Ranges(self.evidence, self.known, self.model.p)

    def row(self, name: str, sample: int = 0) -> np.ndarray:
        return self.coefficients[sample, self.forces.index(name)]


def identified_job(folder: Path, noise: float | None) -> Job:
    robot = load_robot("irb360-6-1600")
    limbs = robot.limbs.changed(strut_spacing=0.12)
    exact = {"lengths": 0.0, "homing": 0.0, "mounting": 0.0}
    robot = robot.changed(limbs=limbs, **({} if noise else {"tolerances": exact}))
    rng, kinematics = np.random.default_rng(5), compiled(robot).kinematics
    truth = surrogate_parameters(robot, rng)
    recording = simulated(robot, truth, rng, noise, duration=10.0)
    write_recording(recording, folder / "log.csv")
    model = identify(robot, [folder / "log.csv"], settings=PLAIN).model
    forces = ConstraintForces(robot)
    z, _, qd, qdd = along(kinematics, rng, np.linspace(0, 9, 6))
    qd[0] = qdd[0] = 0.0  # the first one at rest
    found, known = evidence(model, [folder / "log.csv"])
    return Job(truth, model, forces, found, known, forces.coefficients(z, qd, qdd))


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> Job:
    return identified_job(tmp_path_factory.mktemp("noisy"), 0.02)


@pytest.fixture(scope="module")
def exact(tmp_path_factory: pytest.TempPathFactory) -> Job:
    return identified_job(tmp_path_factory.mktemp("exact"), None)


@pytest.mark.slow
def test_ranges_hold_truth_and_model_and_are_wide_where_torques_are_blind(noisy: Job) -> None:
    ranges, held, blind = noisy.ranges, [], 0
    for c in noisy.coefficients[1:].reshape(-1, len(noisy.truth)):
        found, open_ = ranges.force_range(c), noisy.known.openness(c)
        held.append(found.low <= c @ noisy.truth <= found.high)
        assert found.low <= c @ noisy.model.p <= found.high
        if open_.half_width:
            blind += 1
            assert open_.unknowns
            # Consistency and the noise of the rest change a prior's width, but not to nothing.
            assert found.high - found.low > 0.5 * open_.half_width
    assert blind > 0.5 * len(held)
    assert np.mean(held) > 0.95


def test_what_base_parameters_determine_has_their_interval(noisy: Job) -> None:
    """Without cones, and with a prior that says next to nothing: that of least squares with what
    the description holds at zero left out, from the regressor's rows themselves."""
    weak = noisy.model.settings.changed(prior_spread=100.0)
    model = noisy.model.changed(settings=weak)
    known, information = Determinacy(load(model), noisy.known.base), noisy.evidence.information
    known.unknowns = replace(known.unknowns, blocks=())
    ranges = Ranges(noisy.evidence, known, noisy.model.p)
    A = known.unknowns.A
    rows = information.weighted(information.torque_max**-2.0)[:, :-1] @ A[information.columns]
    covariance = np.linalg.pinv(rows, rcond=1e-12)
    covariance = covariance @ covariance.T
    for name in ("motor1.drive", "motor2.force.x", "motor3.force.y"):
        c = noisy.row(name, 3)
        assert known.openness(c).half_width == 0
        white = noisy.evidence.estimate.noise.sigma * np.sqrt(c @ A @ covariance @ A.T @ c)
        found = ranges.force_range(c)
        # The noise is white, so its scatter finds the same level, up to chance.
        assert 0.4 < (found.high - found.low) / (2 * 1.96 * white) < 2.5
        own = noisy.ranges.force_range(c)  # prior and consistency only add to what is known
        assert own.high - own.low < 1.2 * (found.high - found.low)


def test_exact_recordings_leave_what_torques_leave_open(exact: Job) -> None:
    ranges = exact.ranges
    for name in ("motor1.drive", "motor2.force.x"):
        c = exact.row(name, 2)
        found = ranges.force_range(c)
        np.testing.assert_allclose([found.low, found.high], c @ exact.truth, rtol=1e-3)
    for name in ("strut1a.platform.x", "strut2b.elbow.out", "telescope.platform.z"):
        c = exact.row(name, 2)
        found, half = ranges.force_range(c), exact.known.openness(c).half_width
        assert 0.5 * half < 0.5 * (found.high - found.low) < 1.001 * half
        assert found.low < c @ exact.truth < found.high


def test_a_range_counts_what_consistency_costs_the_best_of_all() -> None:
    """One unknown u ≥ −1 that data and prior would have at −3, where ‖R u − b‖ is zero: the best
    consistent one is 2 away, so all within √(2² + 1.96²) are compatible."""
    identity = np.eye(1)
    block = Block(np.zeros((1, 1), dtype=int), identity, identity)
    rows, right = np.array([[1.0], [1.0]]), np.array([-6.0, 0.0])  # R = √2, R u_best = b
    ends = ConsistentBall(rows, right, [block], np.ones(1)).ends(np.ones(1), NORMAL)
    reach = np.hypot(2 * np.sqrt(2), 1.959964) / np.sqrt(2)
    np.testing.assert_allclose(ends, [-1.0, -3.0 + reach], rtol=1e-5)


def test_weight_of_an_arm_that_no_torque_shows(exact: Job) -> None:
    """At rest the motor carries the arm: of its mass only the prior is known, and that the body
    with this mass must exist."""
    c = exact.row("motor1.force.z")
    open_ = exact.known.openness(c)
    mass = exact.model.robot.bodies["U"].prior_parameters()[0]
    assert open_.unknowns[0] == "U.m"
    assert open_.half_width == pytest.approx(1.96 * SPREAD * mass * 9.81, rel=0.05)
    found = exact.ranges.force_range(c)
    known = c @ exact.truth - 9.81 * exact.truth[0]
    U = exact.truth[:10].copy()
    least = U[1] ** 2 / (0.5 * (U[5] + U[6] - U[4]))  # m ≥ mc_x² / S_xx
    assert found.low > known + 9.81 * 0.95 * least > known + 9.81 * (1 - 1.96 * SPREAD) * mass
    assert found.high == pytest.approx(known + 9.81 * mass * (1 + 1.96 * SPREAD), rel=0.06)


def test_without_recordings_the_same_is_known_to_be_open(noisy: Job) -> None:
    model = load(noisy.model)
    structural = Determinacy(model, random_motion_base(model.dynamics))
    for c in noisy.coefficients[4]:
        openness, other = structural.openness(c), noisy.known.openness(c)
        assert openness.half_width == pytest.approx(other.half_width, rel=1e-6, abs=1e-9)
        assert set(openness.unknowns) == set(other.unknowns)


def test_unknowns_start_from_a_consistent_prior() -> None:
    """What the description leaves out and no torque shows is open; what it calls symmetric not."""
    robot = load_robot("irb360-6-1600")
    base = random_motion_base(compiled(robot))
    visible = np.ones(len(base.layout.names), dtype=bool)
    visible[list(base.invisible)] = False
    unknown = unknowns(robot, visible, SPREAD)
    assert {"EE.mcz", "P.mcx", "U.m", "U.mcy", "S.m"} <= set(unknown.names)
    assert not {"S.mcy", "S.Sxy", "TL.mcx"} & set(unknown.names)
    layout = base.layout
    assert all(consistency(unknown.p_0[layout.body(body)]) > 0 for body in layout.bodies)
    # The tool's centre of mass, 0.3 kg at −0.02 m, which the reduced prior has dropped.
    assert unknown.p_0[layout.names.index("EE.mcz")] == pytest.approx(-0.006)
    rng = np.random.default_rng(0)
    for _ in range(20):
        u = rng.standard_normal(len(unknown.names))
        p = unknown.A @ u + unknown.p_0
        margins = [consistency(p[layout.body(body)]) > 0 for body in layout.bodies]
        margins += list(p[10 * len(layout.bodies) :] > 0)
        x = unknown.prior + unknown.size * u
        assert all(margins) == all(np.linalg.eigvalsh(b.matrix(x))[0] > 0 for b in unknown.blocks)
