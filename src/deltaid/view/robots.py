"""Robots and their computations: a card, a figure, and the page of a robot at rest."""

import numpy as np
import plotly.graph_objects as go

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.forward_dynamics import ForwardDynamics
from deltaid.dynamics.limits import AtRest
from deltaid.errors import Doubt
from deltaid.joint_forces.constraint_forces import ConstraintForces
from deltaid.mechanism.kinematics import Kinematics
from deltaid.mechanism.skeleton import Skeleton
from deltaid.model.model import load
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import yaml_text
from deltaid.view import style
from deltaid.view.animation import fix_scene, robot_lines, still_line
from deltaid.view.drawing import outline, outline_points
from deltaid.view.numbers import number, percent
from deltaid.view.page import Fact, Page, Section, Table, Text
from deltaid.view.reach import NOTHING, Reach, WorkspaceSurvey, reach, require_space, survey
from deltaid.view.reach_figures import picture, sections
from deltaid.view.show import Card

_Robot = RobotDescription | Kinematics | Dynamics | ForwardDynamics | ConstraintForces
# Beginning of a card's title, and methods that the card lists.
_KINDS: dict[type, tuple[str, tuple[str, ...]]] = {
    Kinematics: ("Kinematics of ", (".inverse(z)", ".forward(q)", ".jacobian(z)", ".condition(z)",
                                    ".plot()")),
    Dynamics: ("Dynamics of ", (".inverse_dynamics(q, qd, qdd)", ".mass_matrix(q)",
                                ".regressor(q, qd, qdd)", ".plot()")),
    ForwardDynamics: ("Forward dynamics of ", (".drive_acceleration(q, qd, tau, p)", ".plot()")),
    ConstraintForces: ("Constraint forces of ", (".names", ".evaluate(z, qd, qdd, p)")),
    RobotDescription: ("", (".plot()", '.report("x.html")', '.changed(name="…")')),
}  # fmt: skip


def robot_card(value: _Robot) -> Card:
    robot = value if isinstance(value, RobotDescription) else value.robot
    title, methods = next(both for kind, both in _KINDS.items() if isinstance(value, kind))
    facts = {
        "drives": f"{len(robot.drives)} ({robot.units(robot.drives[0]).force})",
        "bodies": ", ".join(robot.body_names),
        "home": ", ".join(
            f"{name} {number(float(x), 3)}"
            for name, x in zip(robot.task.names, robot.home, strict=True)
        ),
        "parameters": str(len(value.layout.names)) if isinstance(value, Dynamics) else "",
        "channels": str(len(value.names)) if isinstance(value, ConstraintForces) else "",
    }
    named = f" ({robot.name})" if robot.title and robot.name != robot.title else ""
    return Card(
        f"{title}{robot.label}{named}",
        facts=tuple(fact for fact in facts.items() if fact[1]),
        more=(
            ("drives and limits", _drives(robot)),
            ("workspace", yaml_text(robot.workspace.model_dump(mode="json")).rstrip()),
        ),
        methods=methods,
    )


def _drives(robot: RobotDescription) -> Table:
    rows = list[tuple[str, ...]]()
    for drive, unit in robot.drive_units.items():
        limits, scale = robot.limits_of(drive), unit.per_shown
        ends = " … ".join(number(scale * x, 3) for x in limits.range or ())
        speed, effort = limits.top_speed, limits.effort
        rows.append(
            (drive, f"{ends} {unit.shown}" if ends else "—",
             f"{number(scale * speed, 3)} {unit.shown}/s" if speed else "—",
             f"{number(effort, 3)} {unit.force}" if effort else "—")
        )  # fmt: skip
    return Table(("drive", "range", "speed", "largest effort"), tuple(rows))


def robot_figure(value: _Robot) -> go.Figure:
    """The robot at its home pose, with the edges of its workspace."""
    robot = value if isinstance(value, RobotDescription) else value.robot
    skeleton = Skeleton(robot, compiled(robot).kinematics.mechanism)
    shape = skeleton.evaluate(robot.home[None])[0]
    edges = still_line(
        "workspace", outline(robot.workspace), {"color": style.PRIOR, "width": 3, "dash": "dot"}
    )
    figure = go.Figure([*robot_lines(skeleton, shape).values(), edges])
    fix_scene(figure, shape.reshape(-1, 3), outline_points(robot.workspace), height=460, below=0)
    return figure.update_layout(margin_t=30)


def robot_page(value: RobotDescription) -> Page:
    """The page of `deltaid show`.

    Raises:
        KinematicsError: the robot does not move along x, y and z.
    """
    require_space(value)
    model = load(value)
    return rest_page(AtRest(model.dynamics, model.p), "Robot at rest, with its prior parameters")


def rest_page(robot: AtRest, subtitle: str) -> Page:
    reached, surveyed = reach(robot), survey(robot)
    return Page(
        title=robot.robot.label,
        subtitle=subtitle,
        facts=rest_facts(robot, reached, surveyed),
        warnings=rest_warnings(robot, surveyed),
        sections=(
            Section("Robot", (picture(robot, reached), rest_table(robot, surveyed))),
            Section("Workspace", (sections(robot, reached, surveyed), use_table(robot, surveyed))),
            Section("Reach", (_reach_text(robot, reached), end_table(robot, reached))),
        ),
    )


def rest_facts(robot: AtRest, reached: Reach, surveyed: WorkspaceSurvey) -> tuple[Fact, ...]:
    condition, home = surveyed.poses.condition, robot(robot.home[None])
    hardest = int(np.argmax(np.abs(home.torque[0])))
    drive = robot.robot.drives[hardest]
    return (
        Fact(
            "condition in the workspace",
            f"{np.median(condition):.3g}",
            f"median; {condition.min():.3g} … {condition.max():.3g}, "
            f"limit {robot.robot.largest_condition:.3g}",
        ),
        Fact("condition at home", f"{home.condition[0]:.3g}"),
        Fact(
            "held at home",
            f"{abs(home.torque[0, hardest]):.3g} {robot.robot.units(drive).force}",
            f"by {drive}, the most of all drives",
        ),
        Fact(
            "reach", f"{reached.volume:.3g} m³", f"up to {reached.distance.max():.3g} m from home"
        ),
        Fact(
            "workspace within all limits",
            percent_of(surveyed.within),
            f"{percent_of(surveyed.standing)} can be stood at",
        ),
    )


def rest_lines(robot: AtRest, reached: Reach, surveyed: WorkspaceSurvey) -> list[str]:
    """A robot's title and its key figures at rest, one per line."""
    return [
        robot.robot.label,
        *(
            f"{fact.label}: {fact.value}" + (f" ({fact.note})" if fact.note else "")
            for fact in rest_facts(robot, reached, surveyed)
        ),
    ]


def rest_warnings(robot: AtRest, surveyed: WorkspaceSurvey) -> tuple[str, ...]:
    """A warning if the machine's limits forbid a part of the described workspace."""
    if surveyed.within == 1.0:
        return ()
    uses = zip(robot.limits, surveyed.poses.shares.max(axis=0, initial=0.0), strict=True)
    broken = [name for name, use in uses if use > 1 and not name.startswith("workspace")]
    because = [f"beyond {', '.join(broken)}"] * bool(broken)
    because += ["out of reach"] * (surveyed.standing < 1)
    doubt = Doubt(
        f"{percent_of(1 - surveyed.within)} of the described workspace cannot be used",
        cause=f"poses lie {' or '.join(because)}" if because else "limits differ from pose to pose",
        cure="make 'workspace' smaller, or correct the limits; `deltaid check` says by how much",
    )
    return (doubt,)


def rest_table(robot: AtRest, surveyed: WorkspaceSurvey) -> Table:
    """Drive coordinates and holding torques, at home and over the workspace."""
    home, poses, rows = robot(robot.home[None]), surveyed.poses, list[tuple[str, ...]]()
    torques = np.concatenate([home.torque, poses.torque])
    # Torques that are zero except for rounding.
    torques[np.abs(torques) < 1e-9 * np.abs(torques).max(initial=0.0)] = 0.0
    for i, (drive, units) in enumerate(robot.robot.drive_units.items()):
        limits, scale = robot.robot.limits_of(drive), units.per_shown
        rows.append(
            (
                drive,
                units.shown,
                number(scale * home.q[0, i]),
                _span(scale * poses.q[:, i]),
                _span(scale * np.array(limits.range)) if limits.range else "—",
                number(torques[0, i], 3),
                _span(torques[1:, i]),
                number(limits.effort) if limits.effort else "—",
                units.force,
            )
        )
    return Table(
        ("drive", "unit", "at home", "workspace", "limit", "held at home", "held", "largest",
         "unit "),
        tuple(rows),
        "Drive coordinates, and the torques or forces that hold the robot still against gravity "
        "and springs, without friction but its offset; at home and over the whole workspace.",
    )  # fmt: skip


def use_table(robot: AtRest, surveyed: WorkspaceSurvey) -> Table:
    """Largest use of each limit in the workspace, with its place."""
    shares = surveyed.poses.shares
    places = surveyed.poses.z[shares.argmax(axis=0)]
    rows = [
        (
            robot.limits[k],
            f"{100 * shares[:, k].max():.1f}",
            ", ".join(f"{value:.3f}" for value in places[k, :3]),
            *(f"{np.rad2deg(psi):.0f}" for psi in places[k, 3:]),
        )
        for k in range(robot.of_workspace, len(robot.limits))
    ]
    turned = ("tool [deg]",) if robot.dynamics.dof > 3 else ()
    return Table(
        ("limit", "largest use [%]", "at x, y, z [m]", *turned),
        tuple(sorted(rows, key=lambda row: -float(row[1]))),
        "Largest use of each limit in the described workspace, at rest, and where that is.",
    )


def end_table(robot: AtRest, reached: Reach) -> Table:
    """Share of the rays from home that each limit ends."""
    rows = []
    for k, share in sorted(reached.shares.items(), key=lambda item: -item[1]):
        distances = reached.distance[reached.ended_by == k]
        ends = number(distances.min(), 3), number(distances.max(), 3)
        rows.append((robot.limits[k] if k >= 0 else NOTHING, percent_of(share), *ends))
    return Table(
        ("limit", "share of directions", "nearest [m]", "farthest [m]"),
        tuple(rows),
        "What ends straight ways from home, by solid angle, and how far from home it does.",
    )


def percent_of(share: float) -> str:
    """A share in per cent, with 100 and 0 only if they are exact."""
    if share in (0.0, 1.0):
        return f"{100 * share:.0f} %"
    return f"{min(100 * share, 99.9):.1f} %" if share > 0.1 else percent(share)


def _reach_text(robot: AtRest, reached: Reach) -> Text:
    text = (
        "From the home pose the platform is moved straight in all directions, the tool's angle "
        "kept, until a limit of the machine ends the way: a drive's range or torque at rest, the "
        "swing of a strut, the telescope's stroke, or the largest condition. What lies behind a "
        "bend does not count."
    )
    if reached.turn is not None and all(k < 0 for _, k in reached.turn):
        text += "\n\nNothing ends the turning of the tool."
    elif reached.turn is not None:
        low, high = (
            f"{np.rad2deg(angle):.4g}° ({robot.limits[k] if k >= 0 else 'nothing ends it'})"
            for angle, k in reached.turn
        )
        text += f"\n\nAt home the tool turns from {low} to {high}."
    return Text(text)


def _span(values: np.ndarray) -> str:
    return f"{number(values.min(), 3)} … {number(values.max(), 3)}"
