"""Effects beside the robot as a model file has them."""

from deltaid.robot.part import Part


class FittedEffect(Part):
    """Something that takes torques of the drives all the time, such as a hose.

    Attributes:
        name: of the effect, such as 'platform-force'.
        values: of its coefficients.
        drives: that it acts on; empty where it acts on the platform.
        orders: of ripples, one a drive [1/rad or 1/m].
        fastest: speed of the platform that a drag is smoothed with [m/s].
    """

    name: str
    values: tuple[float, ...]
    drives: tuple[str, ...] = ()
    orders: tuple[float, ...] = ()
    fastest: float = 0.0
