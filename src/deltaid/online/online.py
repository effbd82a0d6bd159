"""Online estimation of payload, friction and contact, and feedforward torques with the
estimates."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.errors import DeltaidError
from deltaid.estimation.scatter import NORMAL
from deltaid.kernel.batch import Recurrence, RowKernel
from deltaid.mechanism.one_or_many import as_rows, real_numbers
from deltaid.model.model import Model, ModelLike, load
from deltaid.online.cycle import MorePart, standard_parts, step_graph
from deltaid.online.graph import StepGraph
from deltaid.online.instant import UNKNOWN
from deltaid.online.settings import IDENTIFY_FIRST, OnlineKnowledge, OnlineSettings, knowledge
from deltaid.shown import Named

Rows = Float[np.ndarray, "samples dof"]


@dataclass(frozen=True, repr=False)
class OnlineEstimate(Named):
    """Estimates after one cycle, or after each of many, one row per cycle.

    Attributes:
        names: of the load's entries, such as m, mcx, mcy, Izz.
        held: whether a load is held.
        changed: whether the load changed in this cycle.
        load, load_std: consistent entries of the load, and their standard deviations; zero while
            nothing is held.
        friction: followed coefficients.
        unnoticed: mass that may be held without being detected [kg].
        residual: filtered torque beyond the model without a load [N m or N].
        unexplained: its remainder after load and model errors [N m or N].
        good: whether the cycle was used: all numbers finite, loops closed, the row new and
            possible.
        outputs: all fields by name, including those of additional parts.
    """

    names: tuple[str, ...]
    held: np.ndarray
    changed: np.ndarray
    load: Float[np.ndarray, "*samples entries"]
    load_std: Float[np.ndarray, "*samples entries"]
    friction: Float[np.ndarray, "*samples coefficients"]
    unnoticed: Float[np.ndarray, "*samples"]
    residual: Float[np.ndarray, "*samples dof"]
    unexplained: Float[np.ndarray, "*samples dof"]
    good: np.ndarray
    outputs: dict[str, np.ndarray]

    @property
    def mass(self) -> Float[np.ndarray, "*samples"]:
        """Mass of the load [kg]."""
        return np.asarray(self.load[..., 0])

    @property
    def grip_offset(self) -> Float[np.ndarray, "*samples"]:
        """Delay of the gripper's last signal against the torques [s], negative if early, or NaN."""
        return np.where((off := self.outputs["grip_offset"][..., 0]) == UNKNOWN, np.nan, off)

    @property
    def contact(self) -> np.ndarray:
        """Whether the robot is pushed.

        Raises:
            DeltaidError: contacts were not searched.
        """
        return np.asarray(self._of_contact("contact")[..., 0] > 0.5)

    @property
    def contact_limb(self) -> np.ndarray:
        """Drive whose limb is pushed, from 1 on; 0 for the platform, −1 without a contact.

        Raises:
            DeltaidError: contacts were not searched.
        """
        return np.asarray(self._of_contact("contact_limb")[..., 0].astype(int))

    @property
    def contact_force(self) -> Float[np.ndarray, "*samples moves"]:
        """Force on the platform point, if that is pushed [N].

        Raises:
            DeltaidError: contacts were not searched.
        """
        return np.asarray(self._of_contact("contact_force"))

    def _of_contact(self, name: str) -> np.ndarray:
        if name not in self.outputs:
            raise DeltaidError(
                "was not searched: the robot is at its prior, and without an identification "
                "nothing says what is a contact",
                where="contact",
                cure=IDENTIFY_FIRST,
            )
        return self.outputs[name]

    @property
    def mass_interval(self) -> Float[np.ndarray, "*samples 2"]:
        """95 % interval of the mass [kg]; while no load is detected, from zero to the mass that may
        be held undetected."""
        half, mass = NORMAL * self.load_std[..., 0], self.mass
        return np.maximum(np.stack([mass - half, mass + half + self.unnoticed], axis=-1), 0.0)


class CommandTorques:
    """Feedforward torques τ(z, q̇, q̈, load, friction) of one model, as commands of the drives.

    Attributes:
        z, qd, qdd, load, friction: symbols of the motion and of a cycle's estimates.
        tau: the expression; its friction reverses with the planned motion, not with a noisy
            measurement.
    """

    def __init__(self, model: Model, known: OnlineKnowledge) -> None:
        e, p = model.dynamics.equations, ca.SX(model.p)
        self.z, self.qd, self.qdd = e.z, e.qd, e.qdd
        self.load = ca.SX.sym("load", len(known.entries.shown))
        self.friction = ca.SX.sym("friction", len(known.followed))
        p[list(known.followed)] = self.friction
        p[known.entries.places(model.layout)] += self.load
        self.tau: ca.SX = ca.substitute([e.torque], [e.p], [p])[0] / ca.SX(model.gains)
        self._kinematics = model.dynamics.kinematics

    def __call__(
        self,
        q: Float[np.ndarray, " dof"],
        qd: Float[np.ndarray, " dof"],
        qdd: Float[np.ndarray, " dof"],
        load: Float[np.ndarray, " entries"],
        friction: Float[np.ndarray, " coefficients"],
    ) -> Float[np.ndarray, " dof"]:
        """Torques for one instant of a motion.

        Raises:
            KinematicsError: q closes no loop or is singular.
        """
        motion = np.concatenate([self._kinematics.forward(q), qd, qdd])[None]
        return self._kernel.rows(motion, uniform=np.concatenate([load, friction]))[0][0]

    @cached_property
    def _kernel(self) -> RowKernel:
        uniform = ca.vertcat(self.load, self.friction)
        return RowKernel((self.z, self.qd, self.qdd), [self.tau], uniform)


class Online(Named):
    """Estimator of load, friction and contact that runs with a controller.

    Args:
        model: a robot with its parameters; best an identified model, because its intervals
            enter the load's.
        settings: of the estimator; or `rate` alone.
        rate: cycles per second [Hz], in place of the settings' (`OnlineSettings.at_rate`).
        more: additional parts of the cycle. Contact is added if the model is identified; without
            its intervals contacts and model errors look alike.

    Raises:
        DeltaidError: settings and robot do not fit each other.
    """

    def __init__(
        self,
        model: ModelLike,
        settings: OnlineSettings | None = None,
        *,
        rate: float | None = None,
        more: tuple[MorePart, ...] = (),
    ) -> None:
        self.model: Model = load(model)
        asked = settings or OnlineSettings()
        self.settings = asked if rate is None else asked.at_rate(rate)
        self.known: OnlineKnowledge = knowledge(self.model, self.settings)
        more = (*standard_parts(self.model), *more)
        self.graph: StepGraph = step_graph(self.model, self.settings, more, self.known)
        self.reset()

    def reset(self) -> None:
        """Reset the estimator to its initial state."""
        self.state: Float[np.ndarray, " state"] = self.graph.state.initial

    @cached_property
    def feedforward(self) -> CommandTorques:
        """Torques of a motion with the estimated load and friction."""
        return CommandTorques(self.model, self.known)

    def step(
        self,
        q: Float[np.ndarray, " dof"],
        qd: Float[np.ndarray, " dof"] | None,
        tau: Float[np.ndarray, " dof"],
        gripper: bool | None = None,
        elapsed: float | None = None,
    ) -> OnlineEstimate:
        """Advance by one cycle.

        Args:
            q: measured drive coordinates.
            qd: velocities; None where these are differenced.
            tau: torques as the drives report them.
            gripper: whether it holds; None if unknown.
            elapsed: since the last new row by its stamp, 0 if this row is not new [s]; None without
                stamps.
        """
        rows = self._inputs(q, qd, tau, gripper=gripper, elapsed=elapsed)
        if len(rows) != 1:
            raise DeltaidError(f"has {len(rows)} rows, and a cycle one", where="q", cure="use run")
        return self._estimate(self._advance(rows)[0])

    def run(
        self,
        q: Rows,
        qd: Rows | None,
        tau: Rows,
        gripper: Float[np.ndarray, " samples"] | None = None,
        elapsed: Float[np.ndarray, " samples"] | None = None,
    ) -> OnlineEstimate:
        """Advance by many cycles, one per row.

        Args:
            q: as in `step`.
            qd: as in `step`.
            tau: as in `step`.
            gripper: 1 holds, 0 empty, -1 unknown.
            elapsed: as in `step`, -1 unknown.
        """
        rows = self._inputs(q, qd, tau, gripper=gripper, elapsed=elapsed)
        return self._estimate(self._advance(rows))

    def _inputs(
        self, q: Any, qd: Any, tau: Any, **signals: Any
    ) -> Float[np.ndarray, "samples inputs"]:
        """Inputs of cycles, one per row.

        Raises:
            DeltaidError: an input has a wrong shape, or velocities contradict the settings.
        """
        if (qd is None) != (self.settings.speed == "differenced"):
            given = "were not given" if qd is None else "were given"
            raise DeltaidError(
                f"velocities are {self.settings.speed} by the settings, but {given}",
                where="qd",
                cure="set OnlineSettings.speed to 'measured' or to 'differenced'",
            )
        velocity = {} if qd is None else {"qd": qd}
        q, *motion = as_rows(self.model.dynamics.dof, q=q, **velocity, tau=tau)
        columns = [q, *motion]
        for name, given in signals.items():
            values = np.asarray(UNKNOWN if given is None else given).ravel()
            values = real_numbers(values.astype(float) if values.dtype == bool else values, name)
            if values.size not in (1, len(q)):
                raise DeltaidError(
                    f"has {values.size} values, but q has {len(q)} rows",
                    where=name,
                    cure="give one a cycle",
                )
            columns.append(np.broadcast_to(values, len(q)))
        return np.column_stack(columns)

    def _advance(
        self, inputs: Float[np.ndarray, "samples inputs"]
    ) -> Float[np.ndarray, "samples outputs"]:
        self.state, outputs = self._kernel(self.state, inputs)
        return outputs

    @cached_property
    def _kernel(self) -> Recurrence:
        return Recurrence(self.graph.x, self.graph.u, self.graph.following, self.graph.y)

    def _estimate(self, y: Float[np.ndarray, "*samples outputs"]) -> OnlineEstimate:
        fields = self.graph.outputs.split(y)
        return OnlineEstimate(
            names=self.known.entries.names,
            held=np.asarray(fields["held"][..., 0] > 0.5),
            changed=np.asarray(fields["changed"][..., 0] > 0.5),
            load=fields["load"],
            load_std=fields["load_std"],
            friction=fields.get("friction", np.zeros((*y.shape[:-1], 0))),
            unnoticed=np.asarray(fields["unnoticed"][..., 0]),
            residual=fields["residual"],
            unexplained=fields["unexplained"],
            good=np.asarray((fields["status"] + fields["skipped"])[..., 0] < 0.5),
            outputs=fields,
        )
