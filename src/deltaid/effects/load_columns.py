"""Loads as columns of the fit.

A load adds its ten parameters p_L to those of the body that carries it, so its columns are those of
this body while it is held, and zero otherwise. Its unknown entries are free within its own cone,
about a wide prior, and the same in all recordings that name it. Coefficients are p_L less the part
that has been subtracted from the recordings already (`identification.loads`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.estimation.additions import Addition, Own, Values
from deltaid.estimation.reduction import Free, free_body
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter
from deltaid.recording.carried import Load, carrier
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import SampleBlock
from deltaid.robot.inertia import (
    INERTIA_NAMES,
    INERTIA_UNITS,
    POSITIVE_NAMES,
    PSEUDO_INERTIA_ENTRIES,
    RigidBody,
    entry_map,
)
from deltaid.robot.parameter import PriorParameter

Ten = Float[np.ndarray, " 10"]

# Prior density of a load, that of water [kg/m³]; and how many times as wide the prior deviation is
# as a load as heavy as its carrier is large.
_DENSITY, WIDE = 1000.0, 20.0
# Entries of M̄ that are unknown where a load does not declare the quantity.
_ENTRIES = {
    "mass": ("m",),
    "centre": ("mcx", "mcy", "mcz"),
    "inertia": ("Sxx", "Syy", "Szz", "Sxy", "Syz", "Sxz"),
}
# Relative error up to which a known mass or gain fixes the scale of torques better than their
# torque constants do.
WELL_KNOWN = 0.02


@dataclass(frozen=True, eq=False)
class LoadColumns(Addition):
    """The columns of one load."""

    load: Load  # as declared
    prior_spread: float  # of the fit; scales of parameters are relative to it
    taken: Ten  # part of p_L that has been subtracted from the recordings
    is_detected: bool = False  # whether it was detected instead of declared

    @cached_property
    def body(self) -> str:
        return carrier(self.load, self.dynamics.robot)

    @cached_property
    def prior(self) -> Ten:
        """Prior p_L: a compact body about its centre, if that is known, else about the origin."""
        mass = self.load.mass or self.dynamics.robot.bodies[self.body].prior_parameters()[0]
        around = [2 * mass * _radius(mass) ** 2] * 3 + [0.0] * 3
        if (I := self.load.inertia) is not None:
            around = [I.xx, I.yy, I.zz, I.xy, I.yz, I.xz]
        return mass * self._kilogram + np.array([0.0] * 4 + around)

    @cached_property
    def is_fixed(self) -> bool:
        return not self._entries and self.load.mass_tolerance is None

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        if self.is_fixed:
            return ()
        mass, tolerance = float(self.prior[0]), self.load.mass_tolerance
        radius, names = _radius(mass), zip(INERTIA_NAMES, INERTIA_UNITS, strict=True)
        sizes = WIDE * mass * np.array([1.0, *[radius] * 3, *[radius**2] * 6])
        if tolerance is not None:
            sizes[0] = tolerance / self.prior_spread
        low = np.where(np.isin(INERTIA_NAMES, POSITIVE_NAMES), -self.taken, -np.inf)
        known = np.stack([low, np.full(10, np.inf), self.prior - self.taken, sizes], axis=1)
        return tuple(
            PriorParameter("load", self.load.name, symbol, unit, *numbers)
            for (symbol, unit), numbers in zip(names, known.tolist(), strict=True)
        )

    def carried(self, columns: Int[np.ndarray, " entries"]) -> Int[np.ndarray, " _"]:
        """Numbers of the entries that lie in the carrier's columns."""
        return np.flatnonzero(np.isin(columns, self._places))

    def held(self, w: SampleBlock, recording: PreparedRecording) -> Float[np.ndarray, " samples"]:
        columns = recording.log.columns
        names = [load.name for load in columns.loads]
        if self.load.name not in names:
            return np.zeros(len(w.time))
        return columns.held(w.time, w.extra)[names.index(self.load.name)]

    @cached_property
    def _places(self) -> Int[np.ndarray, " 10"]:
        return np.arange(len(self.dynamics.layout.names))[self.dynamics.layout.body(self.body)]

    @cached_property
    def _carried_entries(self) -> Int[np.ndarray, " entries"]:
        return self.carried(self.dynamics.regressor_pattern[1])[: 0 if self.is_fixed else None]

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        drives, columns = self.dynamics.regressor_pattern
        return drives[self._carried_entries], columns[self._carried_entries] - self._places[0]

    def entries(self, w: SampleBlock, own: Own, recording: PreparedRecording) -> Values:
        return own[self._carried_entries] * self.held(w, recording)

    @property
    def free(self) -> Free:
        if self.is_fixed:
            return Free((), np.zeros((0, 0)), np.zeros(0), ())
        body, _ = free_body("load", self.load.name, self.prior, self._entries, self._visible)
        A, variables, p_0 = body.A, body.variables, body.p_0
        if self.load.mass_tolerance is not None:
            per_mass = self._kilogram if self.load.inertia is None else self.prior / self.prior[0]
            mass = replace(self.parameters[0], low=0.0, prior=float(self.prior[0]))
            A, variables = np.column_stack([A, per_mass]), (*variables, mass)
            p_0 = p_0 - per_mass * mass.prior
        return Free(variables, A, p_0 - self.taken, body.blocks)

    @property
    def _kilogram(self) -> Ten:
        """p of 1 kg at the load's centre, or at the frame's origin where that is unknown."""
        return RigidBody.point(1.0, self.load.centre or (0.0, 0.0, 0.0)).p

    @cached_property
    def _visible(self) -> Bool[np.ndarray, " 10"]:
        """Which of the carrier's ten parameters torques determine."""
        return np.isin(self._places, self.dynamics.regressor_pattern[1])

    @cached_property
    def _entries(self) -> tuple[str, ...]:
        """Entries of M̄ that are unknown and in rows that torques determine."""
        visible = (entry_map() != 0)[self._visible].any(axis=0)
        pairs = zip(PSEUDO_INERTIA_ENTRIES.values(), visible, strict=True)
        rows = {i for (i, j), is_visible in pairs if i == j and is_visible}
        return tuple(
            entry
            for key, entries in _ENTRIES.items()
            for entry in entries
            if getattr(self.load, key) is None and rows.issuperset(PSEUDO_INERTIA_ENTRIES[entry])
        )

    @property
    def scale_reference(self) -> str | None:
        mass, tolerance = self.load.mass, self.load.mass_tolerance or 0.0
        is_known = mass is not None and tolerance <= WELL_KNOWN * mass
        return "what the known load weighs and how it resists" if is_known else None

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        mass, body = self.whole(judged)[0], self.body
        known = self.load.mass is not None and not self.load.mass_tolerance
        low, high = (None, None) if known else (mass.low, mass.high)
        when = "where that is declared"
        if self.is_detected:
            when = "in spans that were detected and no mapping declares"
        if self.is_detected and self.load.always:
            when = "in the whole recording, which no mapping declares"
        origin = "is known" if known else "was identified with the robot"
        without = "the model excludes it"
        empties = "" if self.load.course is None else f"; it {self.load.course} steadily"
        text = f"{body} holds it {when}, and its mass {origin}{empties}; {without}"
        if low is not None and high is not None and high - low > mass.value:
            text += (
                f"; torques hardly separate it from {body} itself: record a part without it, or "
                "give its mass"
            )
        return (
            Correction(kind="load", subject=self.load.name, value=mass.value, low=low, high=high,
                       unit="kg", text=text),
        )  # fmt: skip

    def whole(self, judged: Sequence[Parameter]) -> tuple[Parameter, ...]:
        """Its parameters p_L with their intervals."""
        if self.is_fixed:
            pairs = zip(INERTIA_NAMES, INERTIA_UNITS, self.prior.tolist(), strict=True)
            return tuple(
                Parameter(name=f"{self.load.name}.{symbol}", value=value, std=0.0, low=value,
                       high=value, unit=unit, prior=value, determined_by="fixed")
                for symbol, unit, value in pairs
            )  # fmt: skip
        return tuple(
            parameter.moved(taken)
            for parameter, taken in zip(judged, self.taken.tolist(), strict=True)
        )


def _radius(mass: float) -> float:
    """Radius of gyration of a compact body [m]."""
    return 0.3 * (mass / _DENSITY) ** (1 / 3)
