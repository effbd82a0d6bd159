"""Forces in struts, joints and bearings of a robot, for batches of samples."""

from functools import cached_property

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import WithParameters
from deltaid.dynamics.force_equations import ForceEquations, build_forces, splits, unknown_joints
from deltaid.dynamics.parameters import Parameters
from deltaid.errors import Doubt, unknown
from deltaid.kernel.batch import RowKernel
from deltaid.mechanism.kinematics import Samples
from deltaid.mechanism.one_or_many import one_or_many
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import RobotLike, load_robot
from deltaid.shown import Shown

_SUMS = "only the sum of the forces of a limb's two struts is given"


class ConstraintForces(WithParameters, Shown):
    """Constraint forces of a described robot. Arrays have one sample per row, or are one sample.

    Every force is linear in the parameters: F = C(z, q̇, q̈) p. `docs/forces.md` lists names,
        frames
    and signs of the channels; `dynamics.force_equations` has the equations.

    Attributes:
        names: of the channels, such as 'strut1a.platform.x'.
        units: of the channels, N or N m.
        struts: names of the struts 'strut1a', 'strut1b', …; 'strut1', … for pairs of which only the
            sum of forces is determined.
        note: why forces of single struts are undetermined; empty if they are not.
        socket_force: spring force at each ball joint [N], None if it is not described.
        equations: CasADi graphs of the forces.

    Raises:
        DescriptionError: the robot has a user-defined mechanism, whose joints are unknown.
    """

    def __init__(self, robot: RobotLike) -> None:
        limbs = load_robot(robot).limbs
        if limbs is None:
            raise unknown_joints("constraint forces", "mechanism")
        super().__init__(robot)
        self.equations: ForceEquations = build_forces(self.robot, self.kinematics.mechanism)
        channels = self.equations.channels
        self.names, self.units = (tuple(getattr(c, k) for c in channels) for k in ("name", "unit"))
        self._values = ca.vertcat(*(channel.value for channel in channels))
        self.struts, self.note = self.equations.struts, _why_sums(self.robot)
        self.socket_force = limbs.socket_force if splits(self.robot) else None

    def index(self, name: str) -> int:
        """Index of a channel.

        Raises:
            UnknownNameError: there is no such channel; the message suggests the nearest.
        """
        if name not in self.names:
            raise unknown(name, self.names, "channel", self.robot.name)
        return self.names.index(name)

    @one_or_many("z", "qd", "qdd")
    def evaluate(
        self, z: Samples, qd: Samples, qdd: Samples, p: Parameters | None = None
    ) -> Float[np.ndarray, "samples channels"]:
        """All channels at some samples of a motion; without p, with the parameters given at
        construction or those of the prior."""
        return self._kernel.rows(z, qd, qdd, uniform=self._parameters(p))[0]

    @one_or_many("z", "qd", "qdd")
    def coefficients(
        self, z: Samples, qd: Samples, qdd: Samples
    ) -> Float[np.ndarray, "samples channels parameters"]:
        """C with F = C p, for a few samples."""
        C, rows = self._coefficients, zip(z, qd, qdd, strict=True)
        return np.stack([np.array(C(*row)) for row in rows])

    @cached_property
    def _kernel(self) -> RowKernel:
        e = self.equations
        return RowKernel((e.z, e.qd, e.qdd), [self._values], e.p)

    @cached_property
    def _coefficients(self) -> ca.Function:
        e = self.equations
        return ca.Function("C", [e.z, e.qd, e.qdd], [ca.densify(ca.jacobian(self._values, e.p))])


def _why_sums(robot: RobotDescription) -> str:
    limbs = robot.limbs
    if limbs is None or limbs.struts_per_limb == 1:
        return Doubt(
            "forces of what keeps the platform from turning are not given",
            cause="limbs of one strut leave open what it is",
            cure="where limbs have two struts, describe both (limbs.struts_per_limb)",
        )
    if not robot.platform.determines_struts:
        return Doubt(
            _SUMS,
            cause=f"a platform of kind {robot.platform.kind} has one joint less than its eight "
            "struts need, so how they share their force depends on how stiff they are",
            cure="for single struts, share the sum out by their stiffness",
        )
    if limbs.strut_spacing is None:
        return Doubt(
            _SUMS,
            cause="limbs.strut_spacing is not described",
            cure="describe it, or give --strut-spacing",
        )
    return ""
