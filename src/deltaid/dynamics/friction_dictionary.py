"""A robot's regressor with more friction columns than its own: every term a law might have."""

from functools import cached_property

import casadi as ca
import numpy as np

from deltaid.dynamics.dynamics import Dynamics, Parameters, SparseRegressor
from deltaid.dynamics.equations import joint_regressor
from deltaid.dynamics.joint_columns import friction_columns
from deltaid.kernel.batch import BatchKernel
from deltaid.mechanism.kinematics import Kinematics, Samples
from deltaid.robot.friction import FrictionTerm


class FrictionDictionary:
    """The columns of `dynamics`, then one for each of `terms`.

    Args:
        dynamics: the robot, with its own friction.
        terms: further terms, of joints that have friction.
    """

    def __init__(self, dynamics: Dynamics, terms: tuple[FrictionTerm, ...]) -> None:
        self.dynamics, self.terms = dynamics, terms

    @property
    def kinematics(self) -> Kinematics:
        """The robot's kinematics."""
        return self.dynamics.kinematics

    @property
    def dof(self) -> int:
        """Number of drives δ."""
        return self.dynamics.dof

    @property
    def own_columns(self) -> int:
        """Number of the robot's own columns; term k stands in column own_columns + k."""
        return len(self.dynamics.layout.names)

    @property
    def regressor_pattern(self) -> tuple[np.ndarray, np.ndarray]:
        """Drive and column of every structurally nonzero entry, drive by drive."""
        rows, columns = self._all_entries
        return rows[self._order], columns[self._order]

    def sparse_regressor(
        self, z: Samples, qd: Samples, qdd: Samples, tau: Samples
    ) -> SparseRegressor:
        """The nonzero entries of all columns at task coordinates z."""
        own = self.dynamics.sparse_regressor(z, qd, qdd, tau).values
        more = self._kernel(np.hstack([z, qd, tau]).T)
        return SparseRegressor(np.vstack([own, more])[self._order], *self.regressor_pattern)

    def torque(self, z: Samples, qd: Samples, qdd: Samples, p: Parameters) -> Samples:
        """Torques of the robot with its own friction only."""
        return self.dynamics.torque(z, qd, qdd, p)

    @cached_property
    def _graph(self) -> tuple[ca.SX, ca.SX]:
        """Inputs (z, q̇, τ) and the terms' columns."""
        mechanism, columns = self.kinematics.mechanism, friction_columns(self.terms)
        return joint_regressor(self.dynamics.robot, mechanism, columns)

    @cached_property
    def _kernel(self) -> BatchKernel:
        inputs, columns = self._graph
        return BatchKernel(inputs, columns.T.nz[:])

    @cached_property
    def _all_entries(self) -> tuple[np.ndarray, np.ndarray]:
        """Drive and column of the entries, the robot's own first."""
        own_rows, own_columns = self.dynamics.regressor_pattern
        columns, rows = self._graph[1].T.sparsity().get_triplet()
        further = self.own_columns + np.array(columns)
        return np.append(own_rows, rows), np.append(own_columns, further)

    @cached_property
    def _order(self) -> np.ndarray:
        rows, columns = self._all_entries
        return np.lexsort((columns, rows))
