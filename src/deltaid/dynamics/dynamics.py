"""Numeric dynamics of a robot in batches: regressor, inverse dynamics, and the terms of (1)."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, TypeVar

import casadi as ca
import numpy as np
from jaxtyping import Float, Int

from deltaid.dynamics.equations import Equations, beyond_rounding, build_equations
from deltaid.dynamics.parameters import (
    ParameterLayout,
    Parameters,
    known_parameters,
    parameter_layout,
    prior_parameters,
)
from deltaid.errors import DescriptionError
from deltaid.kernel.batch import BatchKernel, row_kernel
from deltaid.mechanism.kinematics import Kinematics, Samples
from deltaid.mechanism.one_or_many import one_or_many, real_numbers
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import RobotLike, load_robot
from deltaid.shown import Plotted, Shown


@dataclass(frozen=True, repr=False)
class Terms(Shown):
    """The terms of M(q) q̈ + C(q, q̇) q̇ + g(q) + f(q̇) = τ, eq. (1), sample by sample."""

    M: Float[np.ndarray, "*samples dof dof"]
    C: Float[np.ndarray, "*samples dof dof"]
    g: Float[np.ndarray, "*samples dof"]
    f: Float[np.ndarray, "*samples dof"]


@dataclass(frozen=True)
class SparseRegressor:
    """Structurally nonzero entries of Y(z, q̇, q̈), samples in columns.

    Attributes:
        values: one row for each nonzero entry, one column for each sample.
        rows, columns: drive and parameter of each entry, ordered by drive.
    """

    values: Float[np.ndarray, "entries samples"]
    rows: np.ndarray
    columns: np.ndarray


_Self = TypeVar("_Self", bound="WithParameters")


class WithParameters(Shown):
    """Base of computations with parameters p, given with the call or at construction.

    Attributes:
        robot: the description.
        kinematics: the robot's kinematics.
        layout: names and indices of its parameters.
    """

    # State of one instance. All instances of one robot share their `__dict__` with all compiled
    # kernels (`with_parameters`).
    __slots__ = ("_p",)
    _p: Parameters | None

    def __init__(self, robot: RobotLike) -> None:
        self._p = known_parameters(robot)
        self.robot: RobotDescription = load_robot(robot)
        self.kinematics = Kinematics(self.robot)
        self.layout: ParameterLayout = parameter_layout(self.robot)

    @property
    def dof(self) -> int:
        """Number of drives δ."""
        return self.kinematics.dof

    def with_parameters(self: _Self, p: Parameters) -> _Self:
        """The same computation with other default parameters; compiled kernels are shared."""
        other = object.__new__(type(self))
        other.__dict__ = self.__dict__
        other._p = p
        return other

    @property
    def p(self) -> Parameters:
        """Default parameters, for calls without p."""
        return prior_parameters(self.robot) if self._p is None else self._p

    def _parameters(self, p: Parameters | None) -> Parameters:
        """The given parameters, or the default ones.

        Raises:
            DescriptionError: their number is not that of the robot's parameters, or one is not
                finite.
        """
        if p is None:
            return self.p
        cure = "give one for each of layout.names, such as p of a model"
        p = real_numbers(p, "p", cure=cure, error=DescriptionError).astype(float, copy=False)
        if p.shape != (len(self.layout.names),):
            raise DescriptionError(
                f"p has shape {p.shape}, but the robot has {len(self.layout.names)} parameters",
                where=self.robot.name,
                cure=cure,
            )
        self.layout.require_finite(p)
        return p


@lru_cache(maxsize=24)
def _compiled(kind: type[Any], description: str) -> Any:
    return kind(RobotDescription.model_validate_json(description))


def compiled_as(kind: type[_Self], robot: RobotDescription) -> _Self:
    """An instance of `kind` for a robot, cached with its compiled kernels.

    All of its state follows from the description, so sharing it changes no result.
    """
    return _compiled(kind, robot.model_dump_json())


def compiled(robot: RobotDescription) -> "Dynamics":
    """Dynamics of a robot, cached with its compiled kernels."""
    return compiled_as(Dynamics, robot)


class Dynamics(WithParameters, Plotted):
    """Dynamics of a described robot. Arrays have one sample a row; kernels compile on first use."""

    @cached_property
    def equations(self) -> Equations:
        """The symbolic equations."""
        return build_equations(self.robot, self.kinematics.mechanism)

    @one_or_many("q", "qd", "qdd", "load")
    def regressor(
        self, q: Samples, qd: Samples, qdd: Samples, load: Samples | None = None
    ) -> Float[np.ndarray, "samples dof parameters"]:
        """The full regressor Y(q, q̇, q̈) of (2)–(7), τ = Y p.

        Friction that depends on load needs the torques that the gears carry (`carried`).

        Raises:
            KinematicsError: q closes no loop or is singular.
            DescriptionError: friction depends on load, and `load` is None.
        """
        return self.regressor_at(self.kinematics.forward(q), qd, qdd, load)

    def regressor_at(
        self, z: Samples, qd: Samples, qdd: Samples, load: Samples | None = None
    ) -> Float[np.ndarray, "samples dof parameters"]:
        """The full regressor at task coordinates z."""
        sparse = self.sparse_regressor(z, qd, qdd, load)
        Y = np.zeros((sparse.values.shape[1], self.dof, len(self.layout.names)))
        Y[:, sparse.rows, sparse.columns] = sparse.values.T
        return Y

    def sparse_regressor(
        self, z: Samples, qd: Samples, qdd: Samples, load: Samples | None = None
    ) -> SparseRegressor:
        """Nonzero entries of Y at task coordinates z, as used for all recorded data.

        Raises:
            DescriptionError: friction depends on load, and `load` is None.
        """
        parts = [z, qd, qdd]
        if self.robot.load_drives:
            if load is None:
                raise DescriptionError(
                    "friction that depends on load has a regressor only where the load is known",
                    where=f"friction.{self.robot.load_drives[0]}.load",
                    cure="pass what the gears carry as well, Dynamics.carried",
                )
            parts.append(np.atleast_2d(load))
        values = self._regressor_kernel(np.hstack(parts).T)
        return SparseRegressor(values, *self.regressor_pattern)

    @property
    def regressor_pattern(self) -> tuple[np.ndarray, np.ndarray]:
        """Drive and parameter of every entry of Y that can be nonzero, drive by drive."""
        return self._pattern

    @cached_property
    def _pattern(self) -> tuple[np.ndarray, np.ndarray]:
        columns, rows = self.equations.Y.T.sparsity().get_triplet()
        return np.array(rows)[self._nonzero], np.array(columns)[self._nonzero]

    @cached_property
    def _nonzero(self) -> Int[np.ndarray, " entries"]:
        """Structural entries of Y that are nonzero beyond rounding.

        For a described robot, entries without effect on torques are zero by structure. Rotations of
        a user-defined mechanism cancel only numerically, so its entries are evaluated in generic
        states.
        """
        if self.robot.mechanism is None:
            return np.arange(self.equations.Y.nnz())
        e = self.equations
        return beyond_rounding(self.kinematics, ca.vertcat(e.z, e.qd, e.qdd, e.load), e.Y.T.nz[:])

    @one_or_many("q", "qd", "qdd")
    def inverse_dynamics(
        self, q: Samples, qd: Samples, qdd: Samples, p: Parameters | None = None
    ) -> Samples:
        """Drive torques τ = Y(q, q̇, q̈) p, eq. (2).

        Raises:
            KinematicsError: q closes no loop or is singular.
        """
        return self.torque(self.kinematics.forward(q), qd, qdd, p)

    @one_or_many("z", "qd", "qdd")
    def torque(self, z: Samples, qd: Samples, qdd: Samples, p: Parameters | None = None) -> Samples:
        """Drive torques at task coordinates z."""
        return self._torque_kernel.rows(z, qd, qdd, uniform=self._parameters(p))[0]

    @one_or_many("z", "qd", "qdd")
    def carried(
        self, z: Samples, qd: Samples, qdd: Samples, p: Parameters | None = None
    ) -> Samples:
        """Torques that the gears carry at task coordinates z: drive torques without the motors' own
        friction and rotors."""
        return self._carried_kernel.rows(z, qd, qdd, uniform=self._parameters(p))[0]

    @one_or_many("q")
    def mass_matrix(
        self, q: Samples, p: Parameters | None = None
    ) -> Float[np.ndarray, "samples dof dof"]:
        """M(q) of (1).

        Raises:
            KinematicsError: q closes no loop or is singular.
        """
        return self._mass_kernel.rows(self.kinematics.forward(q), uniform=self._parameters(p))[0]

    @one_or_many("q", "qd")
    def terms(self, q: Samples, qd: Samples, p: Parameters | None = None) -> Terms:
        """M, C, g and f of (1) in drive coordinates.

        C comes from Christoffel symbols, so Ṁ = C + Cᵀ. f excludes friction that depends on load.

        Raises:
            KinematicsError: q closes no loop or is singular.
        """
        z = self.kinematics.forward(q)
        return Terms(*self._terms_kernel.rows(z, qd, uniform=self._parameters(p)))

    @cached_property
    def _regressor_kernel(self) -> BatchKernel:
        e = self.equations
        load = [e.load] if self.robot.load_drives else []
        entries = e.Y.T.nz[self._nonzero.tolist()]
        return BatchKernel(ca.vertcat(e.z, e.qd, e.qdd, *load), entries)

    _torque_kernel = row_kernel("equations", lambda e: ((e.z, e.qd, e.qdd), [e.torque], e.p))
    _carried_kernel = row_kernel("equations", lambda e: ((e.z, e.qd, e.qdd), [e.carried], e.p))
    _mass_kernel = row_kernel("equations", lambda e: ([e.z], [ca.horzsplit(e.M)], e.p))
    _terms_kernel = row_kernel(
        "equations",
        lambda e: ((e.z, e.qd), (ca.horzsplit(e.M), ca.horzsplit(e.C), e.g, e.f), e.p),
    )
