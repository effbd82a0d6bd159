"""Loads that a robot carries in a recording, as the user declares them.

A column shows when a load is held, or it is held in spans of time, or always. Over a span it may
empty or fill steadily. The user states known properties; the others are identified. Loads of one
name are the same load in all recordings.
"""

from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from deltaid.errors import RecordingError
from deltaid.robot.body import InertiaTensor
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import RigidBody
from deltaid.robot.part import Coordinate, Mass, Part, Point, Positive, require_one

Time = Annotated[float, Field(ge=-1e12, le=1e12)]


class Load(Part):
    """One load: when it is held, and what is known of it.

    Centre and inertia are in the frame of the body that carries it: the end effector EE where the
    robot has one, else the platform P; of other mechanisms the body is named.
    """

    column: str | None = Field(
        default=None,
        min_length=1,
        description="column that is 1 while the load is held and 0 while it is not, such as the "
        "signal of a gripper",
    )
    when: Coordinate | tuple[Coordinate, ...] | None = Field(
        default=None,
        description="the column's number, or numbers, while the load is held, if it has others "
        "than 0 and 1",
    )
    spans: tuple[tuple[Time, Time], ...] | None = Field(
        default=None, description="in place of a column: from when to when it is held [s]"
    )
    course: Literal["empties", "fills"] | None = Field(
        default=None,
        description="over each span it falls steadily to nothing, as glue that is dispensed, or "
        "grows from nothing; the same all the time by default",
    )
    always: Literal[True] | None = Field(
        default=None, description="in place of both: held in the whole recording"
    )
    name: str = Field(
        default="load",
        pattern=r"^[A-Za-z_][A-Za-z0-9_-]{0,39}$",
        description="loads of one name are the same, in one recording or in several",
    )
    body: str | None = Field(
        default=None, description="what carries it; EE, or P where there is no EE, by default"
    )
    mass: Mass | None = Field(default=None, description="kg; identified by default")
    mass_tolerance: Positive | None = Field(
        default=None, description="standard deviation of the mass, kg; known exactly by default"
    )
    centre: Point | None = Field(
        default=None, description="centre of mass, m; identified as far as it shows by default"
    )
    inertia: InertiaTensor | None = Field(
        default=None, description="inertia tensor about the load's own centre of mass, kg m²"
    )

    @property
    def known(self) -> dict[str, object]:
        named = ("body", "mass", "mass_tolerance", "centre", "inertia")
        return {key: value for key in named if (value := getattr(self, key)) is not None}

    @property
    def holding(self) -> tuple[float, ...] | None:
        """Numbers of the column while the load is held; None if the column is 0 or 1."""
        return (self.when,) if isinstance(self.when, float | int) else self.when

    def held(
        self, time: Float[np.ndarray, " samples"], column: Float[np.ndarray, " samples"] | None
    ) -> Float[np.ndarray, " samples"]:
        """The share of the load that is held at each sample: 0 or 1, or between them on a course.

        Args:
            time: time of the recording [s].
            column: numbers of the load's column, if it has one.
        """
        if column is not None:
            return np.isin(column, self.holding or (1.0,)).astype(float)
        if self.spans is None:
            return np.ones(len(time))
        ends = np.ravel(self.spans)
        inside = (np.searchsorted(ends, time, side="right") % 2).astype(float)
        if self.course is None:
            return inside
        levels = [1.0, 0.0] if self.course == "empties" else [0.0, 1.0]
        return inside * np.interp(time, ends, np.tile(levels, len(self.spans)))

    @model_validator(mode="after")
    def _check(self) -> "Load":
        require_one(self, "column", "spans", "always")
        if self.when is not None and (self.column is None or not self.holding):
            raise ValueError("when lists numbers of a column; give both, or neither")
        if self.course is not None and self.spans is None:
            raise ValueError("course needs spans, [from, to] of each course in s")
        if self.spans == ():
            raise ValueError("spans needs at least one span, [from, to]")
        last = -np.inf
        for start, end in self.spans or ():
            if not last <= start < end:
                raise ValueError(
                    f"span [{start:g}, {end:g}] does not follow the one before it, or ends before "
                    "it starts; list spans in order, each as [from, to] in s"
                )
            last = end
        for key, needed in (
            ("mass_tolerance", "mass"),
            ("centre", "mass"),
            ("inertia", "mass"),
            ("inertia", "centre"),
        ):
            if getattr(self, key) is not None and getattr(self, needed) is None:
                raise ValueError(f"gives {key} but no {needed}; give the {needed} too")
        if self.mass_tolerance is not None and self.mass_tolerance > 0.5 * (self.mass or np.inf):
            raise ValueError(
                "mass_tolerance is more than half the mass; leave the mass out to have it found"
            )
        if (I := self.inertia) is not None:  # about the load's own centre of mass
            ten = [self.mass, 0, 0, 0, I.xx, I.yy, I.zz, I.xy, I.yz, I.xz]
            body = RigidBody(np.array(ten, dtype=float)).with_thickness()
            if body.why_inconsistent:
                raise ValueError(f"the load is not a physical body: {body.why_inconsistent}")
        return self


def carrier(load: Load, robot: RobotDescription) -> str:
    """Name of the body that carries a load.

    Raises:
        RecordingError: the robot has no such body, or none is named and it has no EE or P.
    """
    name = load.body or robot.load_carrier
    if name in robot.body_names:
        return name
    what = f"{load.body} is no body of the robot" if load.body else "it does not say what carries"
    raise RecordingError(
        f"load {load.name}: {what}",
        where="load.body",
        cure=f"name one of {', '.join(robot.body_names)} by the line `body: NAME`",
    )
