"""Uses of a list's offers on one robot, as rows over w."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from deltaid.errors import DescriptionError
from deltaid.estimation.information import triangle
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import RigidBody
from deltaid.robot.measured import Measured, Placed, placed_bodies
from deltaid.robot.part import Axis, Vector
from deltaid.robot.sensors import BaseWrench, JointTorque, Sensor, StrutForce
from deltaid.sensors.planning.offers import ACROSS, ALONG, CENTRE, EACH, LIMB, Offer, Offers, Weigh
from deltaid.sensors.planning.rows import Extended, PlannedRecording, planned_rows, weighing_row
from deltaid.sensors.robot_sensors import all_sensor_rows, sensor_rows
from deltaid.sensors.weighings import Weighing, weighing, weighings


@dataclass(frozen=True, eq=False)
class Use:
    """One use of an offer.

    Attributes:
        name: 'kitchen-scale:S', 'plate-tared'.
        title: in words.
        offer: its key in the list; its price is paid once.
        group: of offers of which one is bought; the offer's key where there is none.
        price: of the offer.
        work: additional cost of this use.
        likely, sure: rows over w, with all priors of a sensor's unknowns, and with stated
            tolerances alone.
    """

    name: str
    title: str
    offer: str
    group: str
    price: float
    work: float
    likely: Extended = field(repr=False)
    sure: Extended = field(repr=False)


def uses(recorded: PlannedRecording, offers: Offers) -> tuple[tuple[Use, ...], tuple[str, ...]]:
    """All uses of a list, and the offers that the robot has no place for, in words.

    Raises:
        DescriptionError: an entry names a body or a drive that the robot does not have.
    """
    possible, left_out = list[Use](), list[str]()
    for key, offer in offers.offers.items():
        try:
            if offer.sensors:
                possible.append(_of_sensors(recorded, offers, key, offer))
        except DescriptionError as error:
            places = {
                getattr(sensor, "strut", getattr(sensor, "drive", EACH))
                for sensor in offer.sensors.values()
            }
            if places != {EACH}:  # it names something of a certain robot
                raise
            left_out.append(f"{offer.title}: {error.what}")
        possible += _of_weighings(recorded, offers, key, offer)
    return tuple(possible), tuple(left_out)


def described_rows(recorded: PlannedRecording) -> tuple[Extended, Extended]:
    """Rows of the description's measured values and sensors, likely and sure."""
    weighed = weighings(recorded.dynamics.robot)
    rows = [np.zeros((0, recorded.width)), *(weighing_row(recorded, row) for row in weighed)]
    shown = [planned_rows(recorded, sensor) for sensor in all_sensor_rows(recorded.dynamics)]
    likely, sure = zip(*shown, strict=True) if shown else ((), ())
    return np.vstack([*rows, *likely]), np.vstack([*rows, *sure])


def _of_weighings(
    recorded: PlannedRecording, offers: Offers, key: str, offer: Offer
) -> Iterator[Use]:
    robot, layout = recorded.dynamics.robot, recorded.dynamics.layout
    paid = key, offer.group or key, offer.price, offer.hours * offers.hourly
    if offer.measured:
        for measured in offer.measured:
            _require_bodies(robot, measured.placed, key)
        values = (weighing(each, each.placed, layout, recorded.p) for each in offer.measured)
        rows = np.vstack([weighing_row(recorded, value) for value in values])
        yield Use(key, offer.title, *paid, rows, rows)
    names = list[str]()
    for weigh in offer.weighs:
        for placed in _placed(robot, weigh):
            _require_bodies(robot, placed, key)
            value = planned(recorded, weigh, placed)
            if value is not None:
                row = weighing_row(recorded, value)
                bodies = "+".join(f"{p.count}{p.body}" if p.count > 1 else p.body for p in placed)
                names.append(bodies)
                again = f":{names.count(bodies)}" if names.count(bodies) > 1 else ""
                yield Use(f"{key}:{bodies}{again}", f"{offer.title}: {value.name}", *paid, row, row)
            elif weigh.of != EACH:
                bodies = " + ".join(part.body for part in placed)
                raise DescriptionError(
                    f"a share of {bodies}'s value is no standard deviation: the value is zero at "
                    "the prior",
                    where=f"offers.{key}.weigh",
                    cure="give std as well",
                )


def planned(recorded: PlannedRecording, weigh: Weigh, placed: Sequence[Placed]) -> Weighing | None:
    """A value that could be measured, at the prior.

    None where its standard deviation is a share of a value that is zero.
    """
    layout, p = recorded.dynamics.layout, recorded.p
    first = p[layout.body(placed[0].body)]
    axis = _axis(weigh.axis, first)
    about = first[1:4] / first[0] if weigh.about == CENTRE else np.array(weigh.about)
    given = {} if axis is None else {"axis": axis}
    if weigh.quantity == "inertia":
        given["about"] = tuple(about.tolist())

    def row(quantity: str, value: float, std: float) -> Weighing:
        axes = given if quantity != "mass" else {}
        measured = Measured.model_validate({quantity: value, "std": std, **axes})
        return weighing(measured, placed, layout, p)

    if weigh.quantity == "centre":
        moment = float(row("first_moment", 0.0, 1.0).coefficients @ p)
        return row("centre", moment / float(row("mass", 1.0, 1.0).coefficients @ p), weigh.std)
    value = float(row(weigh.quantity, 1.0, 1.0).coefficients @ p)
    std = float(np.hypot(weigh.std, weigh.share * abs(value)))
    return row(weigh.quantity, value, std) if std > 0 else None


def _axis(axis: Axis | str | Vector | None, p: np.ndarray) -> Axis | Vector | None:
    """An axis of the link frame; among equally long ones the first."""
    if axis not in (ALONG, ACROSS):
        return axis  # pyright: ignore[reportReturnType]
    spread = np.diag(RigidBody(p).second_moments)
    wanted = spread if axis == ALONG else spread.sum() - spread
    names: tuple[Axis, Axis, Axis] = ("x", "y", "z")
    return names[int(np.argmax(wanted > (1 - 1e-9) * wanted.max()))]


def _placed(robot: RobotDescription, weigh: Weigh) -> Iterator[tuple[Placed, ...]]:
    """Groups of bodies measured together; known bodies are excluded from `each`."""
    if weigh.of == EACH:
        for name in robot.body_names:
            if robot.bodies[name].free:
                yield (Placed(body=name),)
    elif weigh.of == LIMB:
        pairs = ((robot.limb_bodies(i), limb.struts) for i, limb in enumerate(robot.limb_geometry))
        for (driven, strut), count in dict.fromkeys(pairs):
            yield Placed(body=driven), Placed(body=strut, count=count)
    else:
        yield placed_bodies(weigh.of)


def _require_bodies(robot: RobotDescription, placed: Sequence[Placed], key: str) -> None:
    for part in placed:
        if part.body not in robot.body_names:
            raise DescriptionError(
                f"{robot.name} has no body '{part.body}'; it has {', '.join(robot.body_names)}",
                where=f"offers.{key}",
                cure=f"name one of these, {EACH} or {LIMB}",
            )


def _of_sensors(recorded: PlannedRecording, offers: Offers, key: str, offer: Offer) -> Use:
    dynamics = recorded.dynamics
    fitted = [each for given in offer.sensors.items() for each in _each(dynamics.robot, *given)]
    if not fitted:
        raise DescriptionError(
            "the robot has no place for it", where=f"offers.{key}.sensors", cure="leave it out"
        )
    count = len(fitted) / len(offer.sensors)
    rows = [planned_rows(recorded, sensor_rows(dynamics, *each)) for each in fitted]
    likely, sure = (triangle(np.vstack(parts)) for parts in zip(*rows, strict=True))
    paid = key, offer.group or key, count * offer.price, count * offer.hours * offers.hourly
    return Use(key, offer.title, *paid, likely, sure)


def _each(robot: RobotDescription, name: str, sensor: Sensor) -> Iterator[tuple[str, Sensor]]:
    match sensor:
        case StrutForce(strut="each"):
            for i in range(len(robot.limb_geometry)):
                yield f"{name}{i + 1}", sensor.changed(strut=f"strut{i + 1}")
        case JointTorque(drive="each"):
            for drive in robot.drives:
                yield f"{name}.{drive}", sensor.changed(drive=drive)
        case StrutForce() | JointTorque() | BaseWrench():
            yield name, sensor
