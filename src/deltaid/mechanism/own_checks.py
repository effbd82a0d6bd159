"""Checks of a user-defined mechanism: types, shapes, symbols, and mobility."""

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.errors import DescriptionError
from deltaid.kernel.llvm_ir import operations_unknown
from deltaid.levels import NEGLIGIBLE
from deltaid.mechanism.mechanism import Mechanism
from deltaid.mechanism.regularity import written
from deltaid.robot.description import RobotDescription

# Number of random poses, besides the middle of the workspace, at which rotations are checked.
_POSES = 8


class Checker:
    """Checks of a mechanism's parts; messages name the user's file."""

    def __init__(self, where: str, z: ca.SX) -> None:
        self._where, self._z = where, z

    def wrong(self, what: str) -> DescriptionError:
        """An error that names the user's file."""
        return DescriptionError(what, where=self._where, cure="correct the Python file")

    def kind(self, value: object, wanted: type, name: str, words: str) -> None:
        """Raise for a value of another type, and for text in place of a list."""
        if not isinstance(value, wanted) or isinstance(value, str):
            raise self.wrong(f"returns {name} as {type(value).__name__}, not as {words}")

    def names(self, kind: str, given: Sequence[object], wanted: Sequence[str]) -> None:
        """Raise for names other than those of the description."""
        for name in wanted:
            if name not in given:
                raise self.wrong(f"returns no {kind} '{name}', which the description has")
        for name in given:
            if name not in wanted:
                raise self.wrong(f"returns a {kind} '{name}', which the description does not have")

    def expression(self, value: Any, what: str) -> ca.SX:
        """A value as an expression of z."""
        try:
            expression = ca.SX(value)
        except (NotImplementedError, TypeError, ValueError):
            raise self.wrong(
                f"{what} is of type {type(value).__name__}; it must be numbers or a CasADi SX "
                "expression of z, several of them joined by ca.vertcat and ca.horzcat"
            ) from None
        n = self._z.numel()
        for symbol in ca.symvar(expression):
            if not any(ca.is_equal(symbol, self._z[i]) for i in range(n)):
                raise self.wrong(
                    f"{what} uses a symbol '{symbol.name()}' that is not an entry of z"
                )
        unknown = operations_unknown(ca.Function("f", [self._z], [expression]))
        if unknown:
            raise self.wrong(
                f"{what} uses CasADi's {', '.join(unknown)}, which cannot be compiled; write it "
                "with elementary functions"
            )
        return expression

    def scalar(self, value: Any, what: str) -> ca.SX:
        """A value as one expression of z."""
        expression = self.expression(value, what)
        if expression.shape != (1, 1):
            raise self.wrong(f"{what} has the shape {expression.shape}; it must be one value")
        return expression

    def motion(self, mechanism: Mechanism, robot: RobotDescription) -> None:
        """Raise for a motion that is not finite in the middle of the workspace, not rigid, or not
        controlled by the drives there."""
        home = robot.home
        for i in range(mechanism.dof):
            if ca.jacobian(mechanism.q[i], mechanism.z).nnz() == 0:
                raise self.wrong(f"drive {i + 1} does not depend on z")
        for i, value in enumerate(self._evaluated(mechanism.reach, home).ravel()):
            if not value > 0:
                raise self.wrong(
                    f"entry {i + 1} of reach is {value:.4g} m in {_middle(home)}, so out of reach; "
                    "check the formulas, or the workspace in the description"
                )
        self._require_finite(mechanism, home)
        self._require_rigid(mechanism, robot, home)
        J = self._evaluated(mechanism.scaled_jacobian, home)
        sizes = np.linalg.svd(J, compute_uv=False) if np.isfinite(J).all() else np.zeros(1)
        if not sizes[-1] > NEGLIGIBLE * sizes[0]:
            raise self.wrong(
                f"the drives do not hold z in {_middle(home)}: ∂q/∂z is singular there; check the "
                "drives' formulas, or move the workspace in the description"
            )

    def _require_finite(self, mechanism: Mechanism, home: Float[np.ndarray, " dof"]) -> None:
        named = [(f"drive {i + 1}", mechanism.q[i]) for i in range(mechanism.dof)]
        named += [(f"joint '{name}'", joint) for name, joint in mechanism.joints.items()]
        for body in mechanism.bodies:
            named.append((f"the rotation of body '{body.name}'", body.rotation.R))
            named.append((f"the origin of body '{body.name}'", body.origin.at))
        named += [(f"a segment of body '{n}'", ca.vertcat(*ends)) for n, *ends in mechanism.drawing]
        for what, expression in named:
            values = self._evaluated(expression, home)
            for wrong in values[~np.isfinite(values)]:
                raise self.wrong(f"{what} is {wrong} in {_middle(home)}; check its formula there")

    def _require_rigid(
        self, mechanism: Mechanism, robot: RobotDescription, home: Float[np.ndarray, " dof"]
    ) -> None:
        half = robot.within(0.0, 0.5 * (robot.turn.high - robot.turn.low))[1]
        aside = np.random.default_rng(0).uniform(-1, 1, (_POSES, mechanism.dof)) * half
        for body in mechanism.bodies:
            for pose in (home, *(home + aside)):
                R = self._evaluated(body.rotation.R, pose)
                if not np.isfinite(R).all():  # out of reach
                    continue
                if np.abs(R.T @ R - np.eye(3)).max() > NEGLIGIBLE or np.linalg.det(R) < 0:
                    raise self.wrong(
                        f"the rotation of body '{body.name}' is no rotation matrix (RᵀR = 1, "
                        f"det R = 1) at z = {written(pose)}"
                    )

    def _evaluated(self, expression: ca.SX, z: Float[np.ndarray, " dof"]) -> np.ndarray:
        return np.array(ca.Function("f", [self._z], [ca.densify(expression)])(z))


def _middle(home: Float[np.ndarray, " dof"]) -> str:
    return f"the middle of the workspace, z = {written(home)}"
