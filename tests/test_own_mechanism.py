"""Mechanisms of the user's own: a Python function from z to poses, drives and joints."""

from pathlib import Path

import numpy as np
import pytest

import deltaid
from command import accepted, refused
from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import DescriptionError
from deltaid.estimation.conic import Conic
from deltaid.estimation.information import active_columns, gather_samples
from deltaid.estimation.log_cholesky import LogCholesky
from deltaid.estimation.objective import pose
from deltaid.estimation.reduction import build_reduction
from deltaid.identification.demo import mass_matrix_error
from deltaid.identification.generic_motion import random_motion_base
from deltaid.identification.identify import identify
from deltaid.mechanism.kinematics import Kinematics
from deltaid.mechanism.skeleton import Skeleton
from deltaid.model.record import IdentifiedModel, Settings
from deltaid.motion.excitation.excite import ExcitationSettings, Exciter
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import simulate_recording, surrogate_parameters, write_recording
from deltaid.robot import own
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import bound, load_robot
from support import along, example

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "heli4"
HELI4, FILE = str(EXAMPLES / "robot.yaml"), str(EXAMPLES / "mechanism.py")
# A Delta of the user's own formulas, from angles and not from vectors.
DELTA = """
import casadi as ca
import numpy as np
import deltaid

BASE, PLATFORM, ARM, STRUT = 0.33, 0.125, 0.42, 1.055

def mechanism(z):
    drives, bodies = [], [deltaid.BodyPose("plate", ca.SX.eye(3), z)]
    for azimuth in np.deg2rad([0.0, 120.0, 240.0]):
        c, s = np.cos(azimuth), np.sin(azimuth)
        turn = ca.DM([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        x, y, down = ca.vertsplit(turn.T @ z * ca.DM([1, 1, -1]))
        x = x + PLATFORM - BASE
        swing = ca.acos((x**2 + y**2 + down**2 + ARM**2 - STRUT**2)
                        / (2 * ARM * ca.sqrt(x**2 + down**2)))
        q = ca.atan2(down, x) - swing
        arm = turn @ rotation_y(q)
        elbow = turn @ ca.vertcat(BASE + ARM * ca.cos(q), 0, -ARM * ca.sin(q))
        along = (z + turn @ ca.DM([PLATFORM, 0, 0]) - elbow) / STRUT
        in_limb = turn.T @ along
        strut = turn @ rotation_y(ca.atan2(-in_limb[2], in_limb[0])) @ rotation_z(
            ca.asin(in_limb[1]))
        drives.append(q)
        bodies.append(deltaid.BodyPose("arm", arm, turn @ ca.DM([BASE, 0, 0])))
        bodies.append(deltaid.BodyPose("rod", strut, elbow, count=2))
    return deltaid.MechanismParts(drives=drives, bodies=bodies)

def rotation_y(a):
    c, s = ca.cos(a), ca.sin(a)
    return ca.vertcat(ca.horzcat(c, 0, s), ca.horzcat(0, 1, 0), ca.horzcat(-s, 0, c))

def rotation_z(a):
    c, s = ca.cos(a), ca.sin(a)
    return ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))
"""


def returning(attribute: str, value: str) -> str:
    """The same function with one attribute of what it returns set past the tests' type checks."""
    return DELTA.replace(
        "    return deltaid.MechanismParts(drives=drives, bodies=bodies)",
        "    parts = deltaid.MechanismParts(drives=drives, bodies=bodies)\n"
        f"    object.__setattr__(parts, '{attribute}', {value})\n"
        "    return parts",
    )


@pytest.fixture
def heli4() -> RobotDescription:
    return example("heli4")


def own_delta(
    folder: Path, arm: str = "arm", rod: str = "rod", plate: str = "plate"
) -> RobotDescription:
    """The catalogue's Delta with its geometry as a function, saved and loaded again."""
    code = DELTA
    for name, body in (("arm", arm), ("rod", rod), ("plate", plate)):
        code = code.replace(f'BodyPose("{name}"', f'BodyPose("{body}"')
    (folder / "delta.py").write_text(code)
    deltaid.use_mechanism(folder / "delta.py")
    data = load_robot("clavel-delta3").model_dump(exclude_none=True)
    for key in ("limbs", "platform", "strut_swing_deg"):
        data.pop(key, None)
    names = {"U": arm, "S": rod, "P": plate}
    data["bodies"] = {names[name]: body for name, body in data["bodies"].items()}
    data["mechanism"] = {"drives": ["rotary"] * 3, "bodies": list(names.values())}
    return bound(RobotDescription.model_validate(data), "delta.yaml")


def test_a_function_of_ones_own_is_the_same_robot_as_the_composition(tmp_path):
    composed, own = Dynamics(load_robot("clavel-delta3")), Dynamics(own_delta(tmp_path))
    rng = np.random.default_rng(0)
    motion = random_motion(composed.kinematics, rng)
    z, zd, zdd = motion.evaluate(rng.uniform(0, 10, 300))
    q, qd, qdd = composed.kinematics.drive_motion(z, zd, zdd)
    for mine, theirs in zip(own.kinematics.drive_motion(z, zd, zdd), (q, qd, qdd), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-9 * np.abs(theirs).max())
    np.testing.assert_allclose(own.kinematics.forward(q), z, atol=1e-10)  # Newton's, not closed
    p = surrogate_parameters(composed.robot, rng)
    expected = composed.torque(z, qd, qdd, p)
    np.testing.assert_allclose(
        own.torque(z, qd, qdd, p), expected, atol=1e-10 * np.abs(expected).max()
    )
    M = composed.mass_matrix(q, p)
    np.testing.assert_allclose(own.mass_matrix(q, p), M, atol=1e-10 * np.abs(M).max())


def test_bodies_may_be_called_like_kinds_of_parameters(tmp_path):
    """Whatever tells parameters apart by their names takes these bodies for coefficients."""
    robot = own_delta(tmp_path, arm="rotor", rod="viscous", plate="load")
    dynamics, rng = Dynamics(robot), np.random.default_rng(3)
    z, _, qd, qdd = along(dynamics.kinematics, rng, 1000)
    truth = surrogate_parameters(robot, rng)
    truth[dynamics.layout.friction] *= 3.0
    tau = dynamics.torque(z, qd, qdd, truth)
    tau = tau + 0.01 * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
    information = gather_samples(dynamics, z, qd, qdd, tau)
    sizes = np.linalg.norm(information.factors[:, :, :-1], axis=(0, 1))
    visible = information.columns[sizes > 1e-9 * sizes.max()]
    objective = pose(information, build_reduction(robot, visible), Settings())
    conic, paper = Conic().solve(objective), LogCholesky().solve(objective)
    assert conic.duality_gap <= 1e-6 * conic.objective
    assert paper.objective == pytest.approx(conic.objective, rel=1e-6)
    np.testing.assert_allclose(
        paper.x / objective.reduction.scale, conic.x / objective.reduction.scale, atol=1e-5
    )
    p, friction = objective.reduction.parameters(paper.x), dynamics.layout.friction
    np.testing.assert_allclose(p[friction], truth[friction], rtol=0.1)
    expected = {"mcx_rotor + 0.84·m_viscous + 0.14·m_load", "viscous.drive1"}
    assert expected <= set(random_motion_base(dynamics).formulas)


def test_columns_that_cancel_only_in_numbers_are_not_visible(heli4):
    dynamics, rng = Dynamics(heli4), np.random.default_rng(2)
    visible = set(np.array(dynamics.layout.names)[active_columns(dynamics)])
    assert len(visible) == 28
    assert {n for n in visible if n.startswith("half")} == {"half.m"}  # only translates
    assert {n for n in visible if n.startswith("arm")} == {"arm.mcx", "arm.mcz", "arm.Iyy"}
    assert dynamics.equations.Y.nnz() > len(dynamics.regressor_pattern[0])
    z = dynamics.kinematics.home + rng.uniform(-0.03, 0.03, (5, 4))
    qd, qdd = rng.standard_normal((2, 5, 4))
    p = rng.uniform(0.1, 1, len(dynamics.layout.names))
    Y = dynamics.regressor(dynamics.kinematics.inverse(z), qd, qdd)
    np.testing.assert_allclose(Y @ p, dynamics.torque(z, qd, qdd, p), rtol=1e-9)


@pytest.mark.slow
def test_the_example_is_excited_within_its_limits(heli4):
    settings = ExcitationSettings(harmonics=2, duration=4.0, starts=1)
    result = Exciter(Dynamics(heli4), settings).optimise()
    assert all(limit.share <= 1.0 for limit in result.limits)


@pytest.mark.slow
def test_the_example_runs_the_whole_pipeline(heli4, tmp_path):
    dynamics, rng = Dynamics(heli4), np.random.default_rng(1)
    motion = random_motion(dynamics.kinematics, rng, period=4.0)
    truth = surrogate_parameters(heli4, rng)
    recording = simulate_recording(dynamics, truth, motion, rng, duration=8.0, rate=500.0)
    write_recording(recording, tmp_path / "log.csv")
    friction = dynamics.layout.friction
    model = identify(heli4, [tmp_path / "log.csv"]).model
    z, _, _ = motion.evaluate(np.linspace(0, motion.period, 200))
    diagonal, off = mass_matrix_error(dynamics, z, truth, model.p)
    assert max(diagonal, off) < 1e-4
    np.testing.assert_allclose(model.p[friction], truth[friction], rtol=1e-4)
    model.save(tmp_path / "model.yaml")
    assert IdentifiedModel.load(tmp_path / "model.yaml").robot == heli4
    assert np.all(np.isfinite(Skeleton(heli4, dynamics.kinematics.mechanism).evaluate(z)))
    deltaid.use_mechanism(_file(tmp_path, DELTA))
    with pytest.raises(DescriptionError, match="belongs to a Python file"):
        IdentifiedModel.load(tmp_path / "model.yaml")


def test_the_file_is_named_on_the_command_line_or_nothing_runs(tmp_path):
    done = accepted("--mechanism", FILE, "base", HELI4, "--json")
    assert '"base_parameters": 26' in done.out
    own._named.clear()  # another process
    assert "--mechanism FILE.py" in refused("base", HELI4, folder=tmp_path)


def _file(folder: Path, text: str) -> Path:
    (folder / "mine.py").write_text(text)
    return folder / "mine.py"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1\n", "defines no function `mechanism`"),
        ("def mechanism(z:\n", "fails: SyntaxError"),
        ("import numpy\n\nraise RuntimeError('no licence')\n", "line 3, RuntimeError: no licence"),
        ("def mechanism(z):\n    return 1 / 0\n", "line 2, ZeroDivisionError"),
        ("def mechanism(z):\n    return {}\n", "returns dict, not a deltaid.MechanismParts"),
        (
            "import deltaid\ndef mechanism(z):\n"
            "    return deltaid.MechanismParts(drives=[z[0]], bodies=[])\n",
            "returns 1 drives, but the description has 3",
        ),
        (
            DELTA.replace('deltaid.BodyPose("rod", strut, elbow, count=2)', "bodies[0]"),
            "returns no body 'rod'",
        ),
        (
            DELTA.replace("return deltaid.MechanismParts(", "z = ca.SX.sym('w', 3); drives[0] = "
                          "z[0]; return deltaid.MechanismParts("),
            "uses a symbol 'w_0' that is not an entry of z",
        ),
        (DELTA.replace('"plate", ca.SX.eye(3)', '"plate", ca.SX.eye(2)'), "rotation of shape"),
        ("raise SystemExit(0)\n", "line 1, SystemExit"),
        ("def mechanism(z):\n    raise SystemExit(0)\n", "line 2, SystemExit"),
        ("import functools\ndef f(a, z):\n    return a / 0\nmechanism = functools.partial(f, 1)\n",
         "mine.py, mechanism(z): fails: line 3, ZeroDivisionError"),
        (returning("drives", "3"), "returns drives as int, not as a list"),
        (returning("bodies", "None"), "returns bodies as NoneType, not as a list"),
        (returning("bodies", "['arm']"), "returns entry 1 of bodies as str, not as a del"),
        (returning("drives", "['a', 1, 2]"), "drive 1 is of type str; it must be numb"),
        (returning("drives", "[z, z, z]"), "drive 1 has the shape (3, 1); it must be"),
        (returning("drives", "[1.0, 2.0, 3.0]"), "drive 1 does not depend on z"),
        (returning("drives", "drives[:1] * 3"), "the drives do not hold z in the middle"),
        (returning("drives", "[d + ca.sqrt(z[2]) for d in drives]"), "drive 1 is nan in the mid"),
        (returning("drives", "[ca.erfinv(z[0])] + drives[1:]"), "drive 1 uses CasADi's erfinv"),
        (returning("joints", "None"), "returns joints as NoneType"),
        (returning("reach", "['x']"), "entry 1 of reach is of type str"),
        (returning("reach", "[-1]"), "entry 1 of reach is -1 m in the"),
        (returning("segments", "[(1, 2)]"), "that is not (body, start, end"),
        (returning("segments", "[('no', z, z)]"), "has a segment of 'no'"),
        (returning("segments", "[('arm', z, 1)]"), "not points of shape 3"),
        (DELTA.replace("count=2", "count=-2"), "body 'rod' has the count -2; it must be 1, 2, …"),
        (DELTA.replace('"plate", ca.SX.eye(3)', '"plate", ca.diag(ca.vertcat(-1, 1, 1))'),
         "the rotation of body 'plate' is no rotation matrix"),
        (DELTA.replace('eye(3), z)', 'eye(3), z / 0.0)'), "the origin of body 'plate' is inf"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_file_is_reported(tmp_path, text, message):
    robot = own_delta(tmp_path)

    def build() -> None:
        digest = deltaid.use_mechanism(_file(tmp_path, text))
        named = robot.mechanism.changed(sha256=digest)
        Dynamics(robot.changed(mechanism=named))

    with pytest.raises(DescriptionError) as caught:
        build()
    assert message in str(caught.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(DescriptionError, match="no such file"):
        deltaid.use_mechanism(tmp_path / "none.py")


GANTRY = """
import casadi as ca
import deltaid

def mechanism(z):
    bodies = [deltaid.BodyPose("plate", ca.SX.eye(3), z[:3])]
    return deltaid.MechanismParts(drives=[z[0], z[1], z[2], z[3]], bodies=bodies)
"""


def test_the_tools_range_need_not_contain_zero(heli4):
    data = heli4.model_dump(exclude_none=True)
    data["mechanism"] |= {"angle_deg": (20.0, 120.0), "sha256": None}
    robot = bound(RobotDescription.model_validate(data), "heli4.yaml")
    np.testing.assert_allclose(Kinematics(robot).home, [0, 0, -0.675, np.deg2rad(70.0)], atol=1e-12)


def test_drives_may_be_the_task_coordinates_themselves(heli4, tmp_path):
    digest = deltaid.use_mechanism(_file(tmp_path, GANTRY))
    data = heli4.model_dump(exclude_none=True)
    data["mechanism"] = {
        "drives": ["linear", "linear", "linear", "rotary"], "bodies": ["plate"], "sha256": digest,
    }  # fmt: skip
    data["bodies"] = {"plate": data["bodies"]["half"]}
    for key in ("friction", "drive_limits", "rotor_inertia", "springs"):
        data.pop(key, None)
    robot = RobotDescription.model_validate(data)
    p = np.array([2.0, 0, 0, 0, 0.1, 0.1, 0.3, 0, 0, 0])
    M = Dynamics(robot).mass_matrix(np.array([[0, 0, -0.6, 0.1]]), p)[0]
    np.testing.assert_allclose(M, np.diag([2.0, 2.0, 2.0, 0.0]), atol=1e-12)
