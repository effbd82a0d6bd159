"""What a robot holds, as columns of the fit: the body that carries it, while it is held.

A load adds its ten parameters p_L to those of its carrier, so its columns are the carrier's times
the state, 1 while it is held. What is unknown of it is free within its own cone, about a wide
prior, and is one thing in all recordings that name it. The columns have p_L less what has been
taken out of the recordings already (`loads.py`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.estimation.additions import Addition, Own, Values
from deltaid.estimation.free_body import Free, free_body
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter as Judged
from deltaid.recording.carried import Load, carrier
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples
from deltaid.robot.inertia import (
    INERTIA_NAMES,
    INERTIA_UNITS,
    PSEUDO_INERTIA_ENTRIES,
    entry_map,
    inertia_parameters,
)
from deltaid.robot.parameter import Parameter

Ten = Float[np.ndarray, " 10"]

# An unknown load is about as heavy as the body that carries it, and as dense as water [kg/m³];
# deviations are compared with so many times this.
_DENSITY, _WIDE = 1000.0, 20.0
_SECOND = tuple(entry for entry in PSEUDO_INERTIA_ENTRIES if entry.startswith("S"))
_FIRST = ("mcx", "mcy", "mcz")
# A mass that is known no better than this says less of torques than torque constants do.
_SURE = 0.02
# A mass whose interval is wider than so many times itself is hardly known.
_VAGUE = 1.0


@dataclass(frozen=True, eq=False)
class LoadColumns(Addition):
    """One load.

    Attributes:
        dynamics: of the robot.
        load: what is declared of it.
        prior_spread: of the fit, which all scales of parameters are relative to.
        taken: p_L as far as it has been taken out of the recordings.
    """

    dynamics: Dynamics
    load: Load
    prior_spread: float
    taken: Ten

    @cached_property
    def body(self) -> str:
        """What carries it."""
        return carrier(self.load, self.dynamics.robot)

    @cached_property
    def prior(self) -> Ten:
        """p_L before any recording: a compact body, about its centre if that is known."""
        weight = self.dynamics.robot.bodies[self.body].prior_parameters()[0]
        mass = self.load.mass or weight
        c = np.array(self.load.centre or (0.0, 0.0, 0.0))
        own = mass * _radius(mass) ** 2 * np.eye(3)
        if self.load.inertia is not None:
            I = self.load.inertia
            tensor = np.array([[I.xx, I.xy, I.xz], [I.xy, I.yy, I.yz], [I.xz, I.yz, I.zz]])
            own = 0.5 * np.trace(tensor) * np.eye(3) - tensor
        M = np.zeros((4, 4))
        M[:3, :3] = own + mass * np.outer(c, c)
        M[:3, 3] = M[3, :3] = mass * c
        M[3, 3] = mass
        return inertia_parameters(M)

    @cached_property
    def is_fixed(self) -> bool:
        """Whether all that torques show of it is known exactly."""
        return not self._entries and self.load.mass_tolerance is None

    def on(self, dynamics: Dynamics) -> "LoadColumns":
        return replace(self, dynamics=dynamics)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        if self.is_fixed:
            return ()
        mass, tolerance = float(self.prior[0]), self.load.mass_tolerance
        radius = _radius(mass)
        sizes = _WIDE * mass * np.array([1.0, *[radius] * 3, *[radius**2] * 6])
        if tolerance is not None:
            sizes[0] = tolerance / self.prior_spread
        low = [-self.taken[0], *[-np.inf] * 3, *(-self.taken[4:7]), *[-np.inf] * 3]
        return tuple(
            Parameter("load", self.load.name, symbol, unit, float(least), np.inf, float(p), size)
            for symbol, unit, least, p, size in zip(
                INERTIA_NAMES, INERTIA_UNITS, low, self.prior - self.taken, sizes.tolist(),
                strict=True,
            )
        )  # fmt: skip

    @cached_property
    def _own(self) -> np.ndarray:
        """Which of the robot's entries are the carrier's."""
        if self.is_fixed:
            return np.zeros(0, dtype=int)
        part, (_, columns) = self.dynamics.layout.body(self.body), self.dynamics.regressor_pattern
        return np.flatnonzero((columns >= part.start) & (columns < part.stop))

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        drives, columns = self.dynamics.regressor_pattern
        return drives[self._own], columns[self._own] - self.dynamics.layout.body(self.body).start

    def entries(self, w: Samples, own: Own, recording: Recording) -> Values:
        columns = recording.log.columns
        names = [load.name for load in columns.loads]
        if self.load.name not in names:
            return np.zeros((len(self._own), len(w.time)))
        held = columns.held(w.time, w.extra)[names.index(self.load.name)]
        return own[self._own] * held

    @property
    def free(self) -> Free:
        if self.is_fixed:
            return Free((), np.zeros((0, 0)), np.zeros(0), ())
        name, shown = self.load.name, self._visible
        found, _ = free_body("load", name, self.prior, self._entries, shown)
        A, variables = found.A, found.variables
        if self.load.mass_tolerance is not None:
            mass = self.parameters[0]
            A = np.column_stack([A, self._of_mass])
            variables = (*variables, replace(mass, low=0.0, prior=float(self.prior[0])))
            found = replace(found, p_0=found.p_0 - self._of_mass * self.prior[0])
        return Free(variables, A, found.p_0 - self.taken, found.blocks)

    @property
    def _of_mass(self) -> Ten:
        """How p_L changes with a mass that is known but for its tolerance."""
        load, m = self.load, self.prior[0]
        if load.centre is None:
            return np.eye(10)[0]
        if load.inertia is not None:
            return self.prior / m
        M, c = np.zeros((4, 4)), np.array([*load.centre, 1.0])
        M += np.outer(c, c)
        return inertia_parameters(M)

    @cached_property
    def _visible(self) -> Bool[np.ndarray, " 10"]:
        """Which of the carrier's ten parameters torques show."""
        first = self.dynamics.layout.body(self.body).start
        return np.isin(first + np.arange(10), self.dynamics.regressor_pattern[1])

    @cached_property
    def _entries(self) -> tuple[str, ...]:
        """Entries of M̄ that are neither known nor out of sight with all of their row."""
        to_p = entry_map()
        shown = {
            ends
            for k, ends in enumerate(PSEUDO_INERTIA_ENTRIES.values())
            if self._visible[np.abs(to_p[:, k]) > 0].any()
        }
        rows = {i for i, j in shown if i == j}
        load = self.load
        unknown = (
            *(("m",) if load.mass is None else ()),
            *(_FIRST if load.centre is None else ()),
            *(_SECOND if load.inertia is None else ()),
        )
        return tuple(one for one in unknown if rows.issuperset(PSEUDO_INERTIA_ENTRIES[one]))

    @property
    def is_absolute(self) -> bool:
        mass, tolerance = self.load.mass, self.load.mass_tolerance or 0.0
        return mass is not None and tolerance <= _SURE * mass

    @property
    def witness(self) -> str:
        return "what the known load weighs and how it resists"

    def told(self, judged: Sequence[Judged]) -> tuple[Correction, ...]:
        mass = self.whole(judged)[0]
        known = self.load.mass is not None and not self.load.mass_tolerance
        how = "is known" if known else "was identified with the robot"
        low, high = (None, None) if known else (mass.low, mass.high)
        vague = low is not None and high is not None and high - low > _VAGUE * mass.value
        return (
            Correction(
                kind="load",
                subject=self.load.name,
                value=mass.value,
                low=low,
                high=high,
                unit="kg",
                text=f"{self.body} holds it where that is declared, and its mass {how}; the model "
                "is of the robot without it"
                + (
                    f"; torques hardly tell it from {self.body} itself: record a part without it, "
                    "or give its mass"
                    if vague
                    else ""
                ),
            ),
        )

    def whole(self, judged: Sequence[Judged]) -> tuple[Judged, ...]:
        """Its parameters with their intervals, with what had been taken out put back."""
        if self.is_fixed:
            pairs = zip(INERTIA_NAMES, INERTIA_UNITS, self.prior.tolist(), strict=True)
            return tuple(
                Judged(name=f"{self.load.name}.{symbol}", value=value, std=0.0, low=value,
                       high=value, unit=unit, prior=value, determined_by="fixed")
                for symbol, unit, value in pairs
            )  # fmt: skip
        found: list[Judged] = []
        for one, taken in zip(judged, self.taken.tolist(), strict=True):
            low, high = (None if x is None else x + taken for x in (one.low, one.high))
            found.append(
                one.changed(value=one.value + taken, low=low, high=high, prior=one.prior + taken)
            )
        return tuple(found)


def _radius(mass: float) -> float:
    """Radius of gyration of something compact [m]."""
    return 0.3 * (mass / _DENSITY) ** (1 / 3)
