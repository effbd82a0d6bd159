"""What sensors see of bodies with all ten entries free: ranks, what stays open, and its words."""

from dataclasses import dataclass, field
from functools import cache
from typing import Any, get_args

import numpy as np
import pytest

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import parameter_layout
from deltaid.robot.body import Entry
from deltaid.robot.inertia import RigidBody, pseudo_inertia
from deltaid.robot.load import load_robot
from deltaid.robot.platform import RigidPlatform
from deltaid.robot.sensors import BaseWrench, Sensor, StrutForce
from deltaid.sensors.planning.exchange import Exchange
from deltaid.sensors.planning.null_space import null_space
from deltaid.sensors.robot_sensors import sensor_rows
from sensor_rows import dense
from support import along

# Singular values of rows with columns of equal length: rounding is below 1e-14, signal above 1e-3.
ZERO = 1e-9
GAUGE = {"kind": "strut-force", "bias": 0}


@dataclass(frozen=True, eq=False)
class Moved:
    """A catalogue robot along a random motion, and its torques' rows."""

    dynamics: Dynamics
    states: tuple[np.ndarray, np.ndarray, np.ndarray]
    Y: np.ndarray
    known: dict[str, np.ndarray] = field(default_factory=dict)

    def rows(self, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
        """C and D, one row a channel and sample."""
        key = sensor.model_dump_json()
        if key not in self.known:
            found = dense(sensor_rows(self.dynamics, "s", sensor), self.states)
            self.known[key] = found.reshape(-1, found.shape[2])
        found = self.known[key]
        return found[:, : self.Y.shape[1]], found[:, self.Y.shape[1] :]


@cache
def moved(name: str) -> Moved:
    robot = load_robot(name)
    bodies = {k: body.changed(free=get_args(Entry)) for k, body in robot.bodies.items()}
    dynamics = Dynamics(robot.changed(bodies=bodies))
    z, _, qd, qdd = along(dynamics.kinematics, np.random.default_rng(0), 500)
    Y = dynamics.regressor(dynamics.kinematics.inverse(z), qd, qdd)
    return Moved(dynamics, (z, qd, qdd), Y.reshape(-1, Y.shape[2]))


def plate(**more: Any) -> BaseWrench:
    tared = {"kind": "base-wrench", "force_bias": 0, "moment_bias": 0, "motor_turns": 20}
    return BaseWrench.model_validate(tared | more)


def visible(A: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(A, axis=0)
    return size > ZERO * size.max()


def rank(A: np.ndarray) -> int:
    """Rank of the columns that are not zero, each of length one."""
    seen = A[:, visible(A)]
    sizes = np.linalg.svd(seen / np.linalg.norm(seen, axis=0), compute_uv=False)
    return int((sizes > ZERO * sizes[0]).sum())


def stacked(first: np.ndarray, C: np.ndarray, D: np.ndarray) -> np.ndarray:
    """Rows of p alone above rows of p and more unknowns."""
    above = np.hstack([first, np.zeros((len(first), D.shape[1]))])
    return np.vstack([above, np.hstack([C, D])])


def point(place: tuple[float, float, float]) -> np.ndarray:
    """The ten parameters of one kilogram at a point."""
    x, y, z = place
    xx, yy, zz = x * x, y * y, z * z
    return np.array([1, x, y, z, yy + zz, xx + zz, xx + yy, -x * y, -y * z, -x * z])


def transfers(robot: Moved) -> dict[str, np.ndarray]:
    """Changes of p that nothing but a cut at that joint can see."""
    layout, description = robot.dynamics.layout, robot.dynamics.robot
    limb = description.limb_geometry[0]
    found = {}

    def change(**parts: np.ndarray) -> np.ndarray:
        p = np.zeros(len(layout.parameters))
        for body, ten in parts.items():
            p[layout.body(body)] = ten
        return p

    driven = "U" if limb.upper_arm else "C"
    found["elbow"] = change(
        **{driven: limb.struts * point((limb.upper_arm, 0, 0)), "S": -point((0, 0, 0))}
    )
    platform, geometry = description.platform, list(enumerate(description.limb_geometry))
    if not isinstance(platform, RigidPlatform):  # a half turn takes one half to the other
        geometry = [(i, limb_geometry) for i, limb_geometry in geometry if platform.on_first(i)]
    places = [limb_geometry.attachment.tolist() for _, limb_geometry in geometry]
    others = np.sum([limb.struts * point((x, y, z)) for x, y, z in places], axis=0)
    found["platform"] = change(S=-point((limb.strut, 0, 0)), **{platform.bodies[0]: others})
    return found


@pytest.mark.parametrize(
    ("name", "open_after"),
    [("clavel-delta3", 2), ("linear-delta", 2), ("irb360-6-1600", 12), ("par4", 6), ("h4", 6)],
)
def test_what_a_plate_leaves_open_is_what_joints_may_pass_on(name: str, open_after: int) -> None:
    robot = moved(name)
    plated = np.vstack([robot.Y, robot.rows(plate())[0]])
    assert visible(plated).sum() - rank(plated) == open_after
    for sensor in (None, "platform", "elbow", "middle"):
        rows = np.zeros((0, plated.shape[1])), np.zeros((0, 0))
        if sensor is not None:
            rows = robot.rows(StrutForce.model_validate(GAUGE | {"strut": "strut1", "at": sensor}))
        A = stacked(plated, *rows)
        for joint, p in transfers(robot).items():
            C, D = rows
            u = np.linalg.lstsq(D, -C @ p)[0] if D.size else np.zeros(D.shape[1])
            left = A @ np.append(p, u)
            seen = np.abs(left).max() / np.abs(A * np.append(p, u)).max()
            assert (seen > 1e-3) if sensor == joint else (seen < 1e-12)


@pytest.mark.parametrize("bias", [0, None])
@pytest.mark.parametrize("name", ["clavel-delta3", "linear-delta", "irb360-6-1600", "par4", "h4"])
def test_only_a_cut_at_a_joint_parts_what_it_joins(name: str, bias: float | None) -> None:
    """A gauge at either joint closes one direction, both close two; one in the middle none."""
    robot = moved(name)
    plated = np.vstack([robot.Y, robot.rows(plate())[0]])

    def rank_measured(*places: str) -> int:
        A, own = plated, 0
        for place in places:
            sensor = GAUGE | {"strut": "strut1", "at": place, "bias": bias}
            C, D = robot.rows(StrutForce.model_validate(sensor))
            C = np.hstack([C, np.zeros((len(C), own))])
            A, own = stacked(A, C, D), own + D.shape[1]
        return rank(A) - own

    before = rank(plated)
    assert rank_measured("platform") == rank_measured("elbow") == before + 1
    assert rank_measured("platform", "elbow") == before + 2
    assert rank_measured("middle") == before


def test_what_no_proposal_explains_is_reported_by_its_entries() -> None:
    layout = parameter_layout(load_robot("clavel-delta3"))
    names, rng = layout.names, np.random.default_rng(0)
    at = [names.index(name) for name in ("U.m", "S.mcx", "P.Izz")]
    rows = np.zeros((40, len(names)))
    rows[:, at[:2]] = rng.standard_normal((40, 2))
    rows[:, at[2]] = rows[:, at[0]] - 2 * rows[:, at[1]]
    null = null_space(rows, layout, ())
    assert (null.visible, null.rank) == (3, 2)
    assert null.directions[0].words == "a combination of U.m, S.mcx, P.Izz"
    d = null.directions[0].direction[at]
    assert d / d[2] == pytest.approx([-1.0, 2.0, 1.0])
    assert len(null.invisible) == len(names) - 3


def test_what_is_left_beside_named_directions_is_reported_sparsely() -> None:
    layout = parameter_layout(load_robot("clavel-delta3"))
    rng = np.random.default_rng(1)
    rows = np.zeros((40, len(layout.names)))
    a, b, c, d = 0, 1, 10, 11
    rows[:, [a, c]] = rng.standard_normal((40, 2))
    rows[:, b], rows[:, d] = rows[:, a], rows[:, c]
    named = np.zeros(len(layout.names))
    named[[a, b]] = 1.0, -1.0
    null = null_space(rows, layout, [Exchange("the first two", named)])
    assert [direction.words for direction in null.directions] == [
        "the first two",
        f"a combination of {layout.names[c]}, {layout.names[d]}",
    ]


def test_a_point_mass_is_a_body() -> None:
    r = np.array([0.3, -0.2, 0.5])
    M = pseudo_inertia(2.0 * RigidBody.point(1.0, r).p)
    assert np.allclose(M, 2.0 * np.outer([*r, 1.0], [*r, 1.0]))


def test_a_whole_null_space_holds_what_is_not_identifiable_at_all() -> None:
    layout = parameter_layout(load_robot("clavel-delta3"))
    rows = np.zeros((5, len(layout.names)))
    rows[:, 3:5] = np.random.default_rng(0).standard_normal((5, 2))
    basis = null_space(rows, layout, ()).basis
    assert basis.shape == (len(layout.names), len(layout.names) - 2)
    assert np.abs(rows * [parameter.scale for parameter in layout.parameters] @ basis).max() < 1e-9


def test_what_is_weaker_than_a_billionth_of_the_strongest_is_open() -> None:
    """n columns of length 1 that are nearly the same have singular values √n and √n ε."""
    layout = parameter_layout(load_robot("clavel-delta3"))
    scale = np.array([parameter.scale for parameter in layout.parameters])
    n = len(scale)
    for small, dimension in ((3e-9, n - 1), (3e-8, n - 2)):
        turned = small / np.sqrt(n) * np.where(np.arange(n) % 2, 1.0, -1.0)
        rows = np.vstack([np.ones(n), turned]) / scale
        assert null_space(rows, layout, ()).basis.shape == (n, dimension)
