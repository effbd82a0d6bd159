"""What a robot holds, as columns of the fit: the body that carries it, while it is held.

A load adds its ten parameters p_L to those of its carrier, so its columns are the carrier's times
the state, 1 while it is held. What is unknown of it is free within its own cone, about a wide
prior, and is one thing in all recordings that name it. Before the fit, p_L is found roughly and its
torques are taken out of the recordings, so that whatever is done to these sees the robot alone; the
columns of the fit then have p_L less what was taken out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice

import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import RecordingError
from deltaid.identification.additions import Addition, Own, Values, extended
from deltaid.identification.fit import pose
from deltaid.identification.gathering import gather_all
from deltaid.identification.reduction import Free, build_reduction, free_body
from deltaid.identification.setup import Progress, Setup
from deltaid.model.corrections import Correction
from deltaid.model.model import Model
from deltaid.model.record import HeldLoad
from deltaid.model.record import Parameter as Judged
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
# Windows of each recording that a first estimate is made from.
_WINDOWS = 16


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

    def told(self, judged: Sequence[Judged]) -> tuple[Correction, ...]:
        mass = self.whole(judged)[0]
        known = mass.determined_by == "fixed"
        how = "is known" if known else "was identified with the robot"
        low, high = (None, None) if known else (mass.low, mass.high)
        return (
            Correction(
                kind="load",
                subject=self.load.name,
                value=mass.value,
                low=low,
                high=high,
                unit="kg",
                text=f"{self.body} holds it where that is declared, and its mass {how}; the model "
                "is of the robot without it",
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


def joined(recordings: Sequence[Recording]) -> tuple[Load, ...]:
    """The loads of recordings, one of each name, with all that is said of it anywhere.

    Raises:
        RecordingError: two recordings say different things of one load.
    """
    loads: dict[str, Load] = {}
    for recording in recordings:
        for load in recording.log.columns.loads:
            before = loads.setdefault(load.name, load)
            for key, value in load.known.items():
                if before.known.get(key, value) != value:
                    raise RecordingError(
                        f"load {load.name} has another {key} than in the recording before",
                        where=str(recording.path),
                        cure="say the same of it everywhere, or give two loads two names",
                    )
            loads[load.name] = before.changed(**load.known)
    return tuple(loads.values())


def declared_loads(setup: Setup, progress: Progress) -> Setup:
    """What the recordings' mappings say is held: known, or found roughly, and taken out."""
    loads = joined(setup.recordings)
    if not loads:
        return setup
    spread, none = setup.settings.prior_spread, np.zeros(10)
    columns = tuple(LoadColumns(setup.dynamics, load, spread, none) for load in loads)
    progress("finding what the robot carries")
    found = _rough(setup, columns)
    columns = tuple(replace(one, taken=p) for one, p in zip(columns, found, strict=True))
    return with_loads(setup, {one.load.name: one.taken for one in columns}).changed(
        additions=(*setup.additions, *columns)
    )


def with_loads(setup: Setup, loads: dict[str, Ten]) -> Setup:
    """The same with torques of these loads taken out of the recordings that hold them."""
    return setup.changed(recordings=tuple(unloaded(one, loads) for one in setup.recordings))


def unloaded(recording: Recording, loads: dict[str, Ten]) -> Recording:
    """A recording without the torques of the loads that it holds."""
    held = tuple(tuple(loads[load.name].tolist()) for load in recording.log.columns.loads)
    return replace(recording, repairs=replace(recording.repairs, loads=held)) if held else recording


def found_loads(setup: Setup, judged: Sequence[Judged]) -> tuple[HeldLoad, ...]:
    """Loads with what a fit found of them.

    Args:
        judged: the parameters of all additions.
    """
    found, rest = list[HeldLoad](), iter(judged)
    for one in setup.additions:
        own = tuple(islice(rest, len(one.parameters)))
        if isinstance(one, LoadColumns):
            name = one.load.name
            logs = tuple(
                str(recording.path.name)
                for recording in setup.recordings
                if any(load.name == name for load in recording.log.columns.loads)
            )
            parameters = one.whole(own)
            found.append(HeldLoad(name=name, body=one.body, logs=logs, parameters=parameters))
    return tuple(found)


def as_known(recording: Recording, model: Model) -> Recording:
    """A recording without the torques of loads that a model knows, or that are declared in full.

    Raises:
        RecordingError: one of the loads is neither.
    """
    identified = model.identified.loads if model.identified else ()
    known = {load.name: load.p for load in identified}
    for load in recording.log.columns.loads:
        columns = LoadColumns(model.dynamics, load, model.prior_spread, np.zeros(10))
        if load.name not in known and load.mass is None:
            raise RecordingError(
                f"holds load {load.name}, which is not one of the model's",
                where=str(recording.path),
                cure="call it as the recording did that the model was identified from, or give "
                "its mass in the mapping (load: {mass: …, centre: […]})",
            )
        known.setdefault(load.name, columns.prior)
    return unloaded(recording, known)


def _rough(setup: Setup, columns: Sequence[LoadColumns]) -> list[Ten]:
    """p_L by the unconstrained minimum of (15): no lag, no contact, no friction law is known yet,
    so consistency is none of its business."""
    if all(one.is_fixed for one in columns):
        return [one.prior for one in columns]
    dynamics, both = setup.dynamics, (*setup.additions, *columns)
    some = [one.brief for one in setup.recordings]
    prior = prior_parameters(setup.robot)
    information = gather_all(extended(dynamics, both), some, prior).information
    added = [(one.parameters, one.free) for one in both]
    reduction = build_reduction(setup.robot, information.columns, added)
    objective = pose(information, reduction, setup.settings)
    _, gradient, hessian = objective.evaluate(reduction.prior)
    x = reduction.prior - np.linalg.solve(hessian, gradient)
    p = reduction.A @ x + reduction.p_0
    rest = iter(p[len(p) - sum(len(one.parameters) for one in columns) :])
    return [
        one.prior if one.is_fixed else np.array(list(islice(rest, len(one.parameters))))
        for one in columns
    ]
