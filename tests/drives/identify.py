"""The identification of a case, told what the case says is told; else without options."""

from deltaid.checks.identify import Judged, identify
from deltaid.model.record import Settings
from deltaid.recording.carried import Load
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.body import InertiaTensor
from deltaid.robot.description import RobotDescription
from deltaid.robot.tolerances import Tolerances
from drives.rows import HOMING, LENGTHS, Case, lever


def identified(case: Case, settings: Settings | None = None) -> Judged:
    """What `deltaid identify` makes of a case."""
    return identify(described(case), list(case.logs), columns=columns(case), settings=settings)


def described(case: Case) -> RobotDescription:
    """The robot as an identification is told of it."""
    robot = case.robot
    if "tolerances" not in case.tells:
        return robot
    zeros = dict(zip(robot.drives, (HOMING * lever(case.machine)).tolist(), strict=True))
    tolerances = Tolerances(lengths=LENGTHS, homing=zeros)
    return robot.model_copy(update={"tolerances": tolerances})


def columns(case: Case) -> list[ColumnMapping] | None:
    """Which load is held when, one mapping a recording."""
    if "gripper" in case.tells:
        return [ColumnMapping(load=Load(column="gripper"))]
    if "known" not in case.tells:
        return None
    load = case.happenings[1].load
    moment = load.mass * load.gyration**2
    known = Load(
        always=True,
        mass=load.mass,
        centre=tuple(load.centre.tolist()),
        inertia=InertiaTensor(xx=moment, yy=moment, zz=moment),
    )
    return [ColumnMapping(), ColumnMapping(load=known)]
