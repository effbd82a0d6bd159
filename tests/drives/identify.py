"""The identification of a case with the information in `Case.tells`, otherwise without options."""

from deltaid.checks.identify import Judged, identify
from deltaid.model.record import Settings
from deltaid.recording.carried import Load
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.body import InertiaTensor
from deltaid.robot.description import RobotDescription
from deltaid.robot.tolerances import Tolerances
from drives.rows import HOMING, LENGTHS, Case, lever


def identified(case: Case, settings: Settings | None = None) -> Judged:
    """Result of `deltaid identify` for a case."""
    return identify(described(case), list(case.logs), columns=columns(case), settings=settings)


def described(case: Case) -> RobotDescription:
    """The robot's description for the identification, with tolerances if the case has them."""
    robot = case.robot
    if "tolerances" not in case.tells:
        return robot
    zeros = dict(zip(robot.drives, (HOMING * lever(case.machine)).tolist(), strict=True))
    tolerances = Tolerances(lengths=LENGTHS, homing=zeros)
    return robot.model_copy(update={"tolerances": tolerances})


def columns(case: Case) -> list[ColumnMapping] | None:
    """Mappings with the declared loads, one for each recording."""
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
