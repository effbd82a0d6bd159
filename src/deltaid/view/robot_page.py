"""What a robot can do, as a page: picture, drives, workspace, reach."""

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.at_rest import AtRest
from deltaid.errors import Doubt
from deltaid.robot.limits import DriveLimits
from deltaid.view.numbers import number, percent
from deltaid.view.page import Fact, Page, Section, Table, Text
from deltaid.view.reach import Reach, WorkspaceSurvey
from deltaid.view.reach_figures import NOTHING, picture, sections

_COLUMNS_DRIVES = (
    "drive",
    "unit",
    "at home",
    "workspace",
    "limit",
    "held at home",
    "held",
    "largest",
    "unit ",
)


def robot_page(robot: AtRest, found: Reach, surveyed: WorkspaceSurvey, subtitle: str) -> Page:
    """Everything about a robot at rest."""
    described = robot.robot
    return Page(
        title=described.title or described.name,
        subtitle=subtitle,
        facts=facts(robot, found, surveyed),
        warnings=warnings(robot, surveyed),
        sections=(
            Section("Robot", (picture(robot, found), drive_table(robot, surveyed))),
            Section("Workspace", (sections(robot, found, surveyed), use_table(robot, surveyed))),
            Section("Reach", (*_reach_text(robot, found), end_table(robot, found))),
        ),
    )


def facts(robot: AtRest, found: Reach, surveyed: WorkspaceSurvey) -> tuple[Fact, ...]:
    """Condition, holding torque, reach."""
    condition = surveyed.poses.condition
    home = robot(robot.home[None])
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
        Fact("reach", f"{found.volume:.3g} m³", f"up to {found.distance.max():.3g} m from home"),
        Fact(
            "workspace within all limits",
            percent_of(surveyed.within),
            f"{percent_of(surveyed.standing)} can be stood at",
        ),
    )


def warnings(robot: AtRest, surveyed: WorkspaceSurvey) -> tuple[str, ...]:
    """What of the described workspace the machine's limits forbid."""
    if surveyed.within == 1.0:
        return ()
    uses = zip(robot.limits, surveyed.poses.shares.max(axis=0, initial=0.0), strict=True)
    broken = [name for name, use in uses if use > 1 and not name.startswith("workspace")]
    because = [f"beyond {', '.join(broken)}"] if broken else []
    if surveyed.standing < 1:
        because.append("out of reach")
    doubt = Doubt(
        f"{percent_of(1 - surveyed.within)} of the described workspace cannot be used",
        cause=f"poses lie {' or '.join(because)}" if because else "limits differ from pose to pose",
        cure="make 'workspace' smaller, or correct the limits; `deltaid check` says by how much",
    )
    return (doubt,)


def drive_table(robot: AtRest, surveyed: WorkspaceSurvey) -> Table:
    """Drive coordinates and holding torques, at home and over the workspace."""
    described, home, poses = robot.robot, robot(robot.home[None]), surveyed.poses
    torques = _without_rounding(np.concatenate([home.torque, poses.torque]))
    rows = []
    for i, drive in enumerate(described.drives):
        units = described.units(drive)
        limits, scale = described.drive_limits.get(drive, DriveLimits()), units.per_shown
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
        _COLUMNS_DRIVES,
        tuple(rows),
        "Drive coordinates, and the torques or forces that hold the robot still against gravity "
        "and springs, without friction but its offset; at home and over the whole workspace.",
    )


def use_table(robot: AtRest, surveyed: WorkspaceSurvey) -> Table:
    """Largest use of each limit within the workspace, and where."""
    poses = surveyed.poses
    rows = []
    for k in range(robot.of_workspace, len(robot.limits)):
        worst = int(np.argmax(poses.shares[:, k]))
        z = poses.z[worst]
        place = ", ".join(f"{value:.3f}" for value in z[:3])
        angles = (f"{np.rad2deg(psi):.0f}" for psi in z[3:])
        rows.append((robot.limits[k], f"{100 * poses.shares[worst, k]:.1f}", place, *angles))
    rows.sort(key=lambda row: -float(row[1]))
    turned = ("tool [deg]",) if robot.dynamics.dof > 3 else ()
    return Table(
        ("limit", "largest use [%]", "at x, y, z [m]", *turned),
        tuple(rows),
        "Largest use of each limit in the described workspace, at rest, and where that is.",
    )


def end_table(robot: AtRest, found: Reach) -> Table:
    """Which limit ends how many of the ways from home."""
    rows = []
    for k, share in sorted(found.shares.items(), key=lambda item: -item[1]):
        distances = found.distance[found.ended_by == k]
        ends = number(distances.min(), 3), number(distances.max(), 3)
        rows.append((robot.limits[k] if k >= 0 else NOTHING, percent_of(share), *ends))
    return Table(
        ("limit", "share of directions", "nearest [m]", "farthest [m]"),
        tuple(rows),
        "What ends straight ways from home, by solid angle, and how far from home it does.",
    )


def percent_of(share: float) -> str:
    """A share in per cent that says 100 only when it is all, and 0 only when it is none."""
    if share in (0.0, 1.0):
        return f"{100 * share:.0f} %"
    return f"{min(100 * share, 99.9):.1f} %" if share > 0.1 else percent(share)


def _reach_text(robot: AtRest, found: Reach) -> tuple[Text, ...]:
    text = (
        "From the home pose the platform is moved straight in all directions, the tool's angle "
        "kept, until a limit of the machine ends the way: a drive's range or torque at rest, the "
        "swing of a strut, the telescope's stroke, or the largest condition. What lies behind a "
        "bend does not count."
    )
    if found.turn is None:
        return (Text(text),)
    if all(k < 0 for _, k in found.turn):
        return (Text(f"{text}\n\nNothing ends the turning of the tool."),)
    ends = [
        f"{np.rad2deg(angle):.4g}° ({robot.limits[k] if k >= 0 else 'nothing ends it'})"
        for angle, k in found.turn
    ]
    return (Text(f"{text}\n\nAt home the tool turns from {ends[0]} to {ends[1]}."),)


def _without_rounding(torques: Float[np.ndarray, "samples drives"]) -> np.ndarray:
    """Torques that are zero but for rounding as zeros."""
    return np.where(np.abs(torques) < 1e-9 * np.abs(torques).max(initial=0.0), 0.0, torques)


def _span(values: np.ndarray) -> str:
    return f"{number(values.min(), 3)} … {number(values.max(), 3)}"
