"""A description whose prior are given parameters: to plan with a model, to keep a truth."""

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.joint_columns import joint_columns
from deltaid.dynamics.parameters import parameter_layout
from deltaid.robot.body import ExplicitInertia
from deltaid.robot.description import RobotDescription


def with_prior(
    robot: RobotDescription, p: Float[np.ndarray, " parameters"], **changes: object
) -> RobotDescription:
    """The same robot with parameters p as its prior, and other changes of its keys.

    Constant offsets of friction are left out: their prior is zero in any description.

    Raises:
        DescriptionError: the parameters are not those of a robot that can be.
    """
    layout, data = parameter_layout(robot), robot.model_dump()
    for name in layout.bodies:
        data["bodies"][name]["prior"] = ExplicitInertia.of(p[layout.body(name)]).model_dump()
    for column, value in zip(joint_columns(robot), p[layout.coefficients].tolist(), strict=True):
        column.describe(data, value)
    return RobotDescription.model_validate(data | changes)
