"""Robots, and what computes with them: cards."""

from typing import TYPE_CHECKING

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.forward_dynamics import ForwardDynamics
from deltaid.joint_forces.constraint_forces import ConstraintForces
from deltaid.mechanism.kinematics import Kinematics
from deltaid.robot.description import RobotDescription
from deltaid.robot.limits import DriveLimits
from deltaid.robot.load import yaml_text
from deltaid.view import style
from deltaid.view.card import Card
from deltaid.view.numbers import number
from deltaid.view.page import Table
from deltaid.view.robot_shape import outline_points

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from deltaid.view.page import Page


_Robot = RobotDescription | Kinematics | Dynamics | ForwardDynamics | ConstraintForces
_METHODS: dict[type, tuple[str, ...]] = {
    Kinematics: (".inverse(z)", ".forward(q)", ".jacobian(z)", ".condition(z)", ".plot()"),
    Dynamics: (".inverse_dynamics(q, qd, qdd)", ".mass_matrix(q)", ".regressor(q, qd, qdd)",
               ".plot()"),
    ForwardDynamics: (".drive_acceleration(q, qd, tau, p)", ".plot()"),
    ConstraintForces: (".names", ".evaluate(z, qd, qdd, p)"),
    RobotDescription: (".plot()", '.report("x.html")', '.changed(name="…")'),
}  # fmt: skip
# How much nearer than in a report, whose picture is higher.
_NEARER = 0.92
_TITLES: dict[type, str] = {
    Kinematics: "Kinematics of ", Dynamics: "Dynamics of ", RobotDescription: "",
    ForwardDynamics: "Forward dynamics of ", ConstraintForces: "Constraint forces of ",
}  # fmt: skip


def robot_card(value: _Robot) -> Card:
    """Kind, drives, bodies, workspace, and what it can do."""
    robot = value if isinstance(value, RobotDescription) else value.robot
    kind = next(kind for kind in _METHODS if isinstance(value, kind))
    unit = next(iter(robot.drive_units.values()))
    home = zip(robot.task.names, robot.home, strict=True)
    facts = [
        ("drives", f"{len(robot.drives)} ({unit.force})"),
        ("bodies", ", ".join(robot.body_names)),
        ("home", ", ".join(f"{name} {number(float(x), 3)}" for name, x in home)),
    ]
    if isinstance(value, Dynamics):
        facts.append(("parameters", str(len(value.layout.names))))
    if isinstance(value, ConstraintForces):
        facts.append(("channels", str(len(value.names))))
    return Card(
        f"{_TITLES[kind]}{robot.title or robot.name}"
        + (f" ({robot.name})" if robot.title and robot.name != robot.title else ""),
        facts=tuple(facts),
        more=(
            ("drives and limits", _drives(robot)),
            ("workspace", yaml_text(robot.workspace.model_dump(mode="json")).rstrip()),
        ),
        methods=_METHODS[kind],
    )


def _drives(robot: RobotDescription) -> Table:
    """Each drive with its limits."""
    rows = list[tuple[str, ...]]()
    for drive, unit in robot.drive_units.items():
        limits = robot.drive_limits.get(drive, DriveLimits())
        span, speed, effort = limits.range, limits.top_speed, limits.effort
        ends = " … ".join(number(unit.per_shown * x, 3) for x in span or ())
        rows.append(
            (drive, f"{ends} {unit.shown}" if span else "—",
             f"{number(unit.per_shown * speed, 3)} {unit.shown}/s" if speed else "—",
             f"{number(effort, 3)} {unit.force}" if effort else "—")
        )  # fmt: skip
    return Table(("drive", "range", "speed", "largest effort"), tuple(rows))


def robot_figure(value: _Robot) -> "go.Figure":
    """Lines of the robot at its home pose, and the edges of its workspace."""
    import plotly.graph_objects as go

    from deltaid.mechanism.skeleton import Skeleton
    from deltaid.view.animation import CAMERA, fix_scene, robot_lines, workspace_line

    robot = value if isinstance(value, RobotDescription) else value.robot
    skeleton = Skeleton(robot, compiled(robot).kinematics.mechanism)
    shape = skeleton.evaluate(robot.home[None])[0]
    edges = workspace_line(robot.workspace, {"color": style.PRIOR, "width": 3, "dash": "dot"})
    figure = go.Figure([*robot_lines(skeleton, shape).values(), edges])
    fix_scene(figure, shape.reshape(-1, 3), outline_points(robot.workspace), height=460, below=0)
    near = {axis: _NEARER * eye for axis, eye in CAMERA["eye"].items()}
    return figure.update_layout(scene_camera_eye=near, margin_t=30)


def robot_page(value: RobotDescription) -> "Page":
    """The page of `deltaid show`.

    Raises:
        KinematicsError: the robot does not move along x, y and z.
    """
    from deltaid.dynamics.at_rest import AtRest
    from deltaid.model.model import load
    from deltaid.view import robot_page
    from deltaid.view.reach import reach, require_space, survey

    require_space(value)
    model = load(value)
    at_rest = AtRest(model.dynamics, model.p)
    subtitle = "Robot at rest, with its prior parameters"
    return robot_page.robot_page(at_rest, reach(at_rest), survey(at_rest), subtitle)
