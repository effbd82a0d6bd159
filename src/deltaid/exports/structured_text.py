"""IEC 61131-3 structured text of a model: the functions that C has, as one file of units.

Functions return a status and have their results as outputs, which count only where it is OK. What
keeps something from one cycle to the next, the pose z, is a function block. A controller that
stops on floating-point exceptions meets none here (`st_statements`): numbers too large for any
robot are refused at the door, and nothing is divided or rooted unseen.
"""

import re
from dataclasses import dataclass

from deltaid.errors import DeltaidError
from deltaid.exports.digits import care_for
from deltaid.exports.functions import parameter_table
from deltaid.exports.further_functions import further_cycles, further_functions
from deltaid.exports.model_functions import model_functions
from deltaid.exports.plcopen import plcopen_xml
from deltaid.exports.st_cycle import cycle_units, start_of
from deltaid.exports.st_helpers import helpers, pair_functions
from deltaid.exports.st_statements import plain
from deltaid.exports.st_units import Unit, Variable, comments, constants
from deltaid.exports.st_writer import Writer
from deltaid.exports.text import DOUBLE, SINGLE, Precision
from deltaid.model.model import Model
from deltaid.online.settings import OnlineSettings

DEFAULT = OnlineSettings()


@dataclass(frozen=True)
class PlcProgram:
    """Functions and function blocks of a model.

    Attributes:
        prefix: what all names begin with.
        notes: comments at the head.
        listed: global constants.
        units: functions and blocks, those that are called first.
    """

    prefix: str
    notes: tuple[str, ...]
    listed: tuple[Variable, ...]
    units: tuple[Unit, ...]

    @property
    def text(self) -> str:
        """As one file of structured text."""
        units = [unit.text() for unit in self.units]
        return "\n".join([*comments(self.notes), "", constants(self.listed), *units])

    @property
    def xml(self) -> str:
        """As a file that development systems import."""
        return plcopen_xml(self.prefix, "\n".join(self.notes), self.listed, self.units)


def structured_text(
    subject: Model,
    prefix: str,
    precision: Precision = DOUBLE,
    further: tuple[str, ...] = (),
    online: OnlineSettings = DEFAULT,
) -> str:
    """`plc_program` as one file of structured text."""
    return plc_program(subject, prefix, precision, further, online).text


def plc_program(
    subject: Model,
    prefix: str,
    precision: Precision = DOUBLE,
    further: tuple[str, ...] = (),
    online: OnlineSettings = DEFAULT,
) -> PlcProgram:
    """The units of a model; their names are PREFIX_….

    Args:
        further: names of functions beside those that every export has (`options.FURTHER`).
        online: of the function of that name.

    Raises:
        DeltaidError: the prefix is no identifier, or the robot has not what a further function
            needs.
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*", prefix) or len(prefix) > 20:
        raise DeltaidError(
            f"'{prefix[:60]}' cannot begin the names of functions of structured text",
            where="name of the output",
            cure="use at most 20 letters, digits and single _ between them, a letter first",
        )
    table = parameter_table(subject, f"{prefix}_p", precision)
    functions = [
        *model_functions(subject, table, precision),
        *further_functions(subject, table, further),
    ]
    single = precision is SINGLE
    care = care_for(subject, table.array.name) if single else None
    writer = Writer(subject, prefix, precision, care)
    cycles = further_cycles(subject, further, online)
    pairs = pair_functions(prefix) if single else []
    units = [*helpers(prefix, precision), *pairs, *map(writer.unit, functions)]
    units += [unit for cycle in cycles for unit in cycle_units(writer, cycle)]
    values = tuple(plain(precision, x) for x in subject.p if x)
    parameters = Variable(
        f"{prefix}_p",
        precision.st_type,
        len(values),
        values,
        tuple(f"{name}, {unit}" for name, unit, _ in table.rows),
    )
    starts = [start_of(writer, cycle) for cycle in cycles]
    return PlcProgram(
        prefix,
        (subject.provenance, *_conventions(subject, precision)),
        (*writer.statuses(), writer.home(f"{prefix}_home"), parameters, *starts),
        tuple(units),
    )


def _conventions(subject: Model, precision: Precision) -> list[str]:
    robot = subject.robot
    drives = [
        f"  [{k}] {drive}: "
        + ("m, m/s, m/s^2, N" if robot.is_linear(drive) else "rad, rad/s, rad/s^2, N m")
        for k, drive in enumerate(robot.drives)
    ]
    turn = ", turn psi of the tool [rad]" if subject.dynamics.dof > 3 else ""
    return [
        f"IEC 61131-3 structured text, {precision.st_type}. Functions return a status of the list "
        "below; its outputs mean something only where that is OK.",
        "Drive coordinates q, rates qd, qdd, torques tau, in the order of the drives:",
        *drives,
        "at the joint, behind the gear; positive as in docs/conventions.md of deltaid.",
        f"Task coordinates z: x, y, z of the platform point in the world [m]{turn}.",
        "Equation of motion: M(q) qdd + C(q, qd) qd + g(q) + f(qd) = tau.",
    ]
