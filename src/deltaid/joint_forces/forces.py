"""Worst-case forces of a model along a motion, with time, pose and uncertainty, in one pass and
constant memory."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.dynamics.dynamics import Parameters
from deltaid.errors import DescriptionError, Doubt, RecordingError, positive
from deltaid.files import write_csv
from deltaid.identification.generic_motion import random_motion_base
from deltaid.identification.sources import model_filtered
from deltaid.joint_forces.constraint_forces import ConstraintForces
from deltaid.joint_forces.ranges import Determinacy, Openness, Range, Ranges, evidence
from deltaid.model.model import Model, ModelLike, load
from deltaid.progress import Watch, watched
from deltaid.recording.filter import TOO_SHORT
from deltaid.recording.mapping import ColumnMappings, MappingLike, as_mapping
from deltaid.recording.memory import RecordingLike, as_source
from deltaid.recording.opening import open_log
from deltaid.recording.plan_doubts import smoothed_away, unknown_ends
from deltaid.recording.planned import motion_of, planned
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import SampleBlock
from deltaid.robot.part import SHORTEST
from deltaid.shown import Plotted, Reported, Shown, Tabled


@dataclass(frozen=True)
class Instant:
    """A sample of a motion: time [s], task coordinates, drive speeds and accelerations."""

    time: float
    z: Float[np.ndarray, " dof"]
    qd: Float[np.ndarray, " dof"]
    qdd: Float[np.ndarray, " dof"]


@dataclass(frozen=True)
class Worst:
    """A force at the instant of its worst case.

    Attributes:
        part: strut, joint or bearing, such as 'strut1a' or 'motor2.moment.x'.
        kind: 'tension' is the largest force along a strut and 'compression' the least, negative if
            it presses; 'socket' the least force that presses a strut onto its balls, without
            springs; 'load' the component of a joint's force with the largest magnitude.
        channel: name of its channel, which includes the end of a strut.
        unit: N or N m.
        value: the force.
        at: its instant.
    """

    part: str
    kind: str
    channel: str
    unit: str
    value: float
    at: Instant


@dataclass(frozen=True)
class Extremes:
    """Least and largest value of every channel, with their samples."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Float[np.ndarray, "two channels"]
    samples: Float[np.ndarray, "two channels columns"]

    def worst(self, part: str, kind: str, *channels: str) -> Worst:
        """The worst value of some channels; for the kind 'load' the largest magnitude of one."""
        at = [self.names.index(name) for name in channels]
        sizes = np.abs(self.values[:, at[0]])
        side = int(sizes.argmax()) if kind == "load" else int(kind == "tension")
        k = at[int((np.argmax if side else np.argmin)(self.values[side, at]))]
        z, qd, qdd = np.split(self.samples[side, k, 1:], 3)
        instant = Instant(float(self.samples[side, k, 0]), z, qd, qdd)
        return Worst(part, kind, self.names[k], self.units[k], float(self.values[side, k]), instant)


def extremes(forces: ConstraintForces, p: Parameters, motion: Iterable[SampleBlock]) -> Extremes:
    """The extremes of all channels along a motion.

    Raises:
        RecordingError: the motion has no samples.
    """
    values = np.multiply.outer([1, -1], np.full(len(forces.names), np.inf))
    samples = np.zeros((*values.shape, 1 + 3 * forces.dof))
    for part in motion:
        F = forces.evaluate(part.z, part.qd, part.qdd, p)
        at = np.stack([F.argmin(axis=0), F.argmax(axis=0)])
        extreme = np.take_along_axis(F, at, axis=0)
        rows = np.column_stack([part.time, part.z, part.qd, part.qdd])[at]
        better = np.stack([extreme[0] < values[0], extreme[1] > values[1]])
        values = np.where(better, extreme, values)
        samples = np.where(better[..., None], rows, samples)
    if np.isinf(values).all():
        raise RecordingError("has no samples left", where="motion", cure=TOO_SHORT)
    return Extremes(forces.names, forces.units, values, samples)


# Worst cases of the force along a strut: the largest and the least.
ALONG = ("tension", "compression")


def worst_cases(forces: ConstraintForces, extreme: Extremes) -> tuple[Worst, ...]:
    """Worst cases for a designer: tension, compression, sockets of struts, loads of joints."""
    cases = []
    for strut in forces.struts:
        along = (f"{strut}.platform.x", f"{strut}.elbow.x")
        cases += [extreme.worst(strut, kind, *along) for kind in ALONG]
    for strut in forces.struts if forces.socket_force is not None else ():
        cases.append(extreme.worst(strut, "socket", f"{strut}.platform.out", f"{strut}.elbow.out"))
    loads = [name for name in forces.names if name.startswith(("motor", "telescope"))]
    return (*cases, *(extreme.worst(x, "load", x) for x in loads if not x.endswith(".drive")))


# Limits of spring forces [N], wide enough for any robot.
_SPRINGS = (1e-6, 1e7)

_WITHOUT_LOADS = Doubt(
    "forces are those without the loads that the mapping declares",
    cause="what the robot holds is no part of its model",
    cure="describe the load as a part of the tool, and compute the forces again",
)
# Fix for rows without forces.
_CURE = "begin and end the motion at rest, or write velocities and accelerations as well"
# Ranges ignore sensors, which are evidence of the fit, so they are wider than necessary.
_ASIDE = (
    "how far forces are known is determined by torques and measured values alone; what {} showed "
    "is in the model, and would make these ranges narrower"
)


@dataclass(frozen=True)
class ForceFinding:
    """A worst force and its uncertainty.

    Attributes:
        worst: the force and its instant.
        openness: what torques leave undetermined, however exact they are.
        range: values compatible with the recordings; None without recordings.
    """

    worst: Worst
    openness: Openness
    range: Range | None


@dataclass(frozen=True, repr=False)
class Forces(Shown, Plotted, Tabled, Reported):
    """Forces in struts, joints and bearings along a motion.

    Attributes:
        model: with the given strut spacing and socket force in its robot.
        constraint_forces: computes the forces.
        recording: the motion with its filter.
        findings: all worst cases.
        extremes: of all channels.
        warnings: about the motion and the assumptions of the forces.
    """

    model: Model
    constraint_forces: ConstraintForces
    recording: PreparedRecording
    findings: tuple[ForceFinding, ...]
    extremes: Extremes
    warnings: tuple[str, ...] = ()

    def over_time(self) -> Iterator[tuple[SampleBlock, Float[np.ndarray, "samples channels"]]]:
        """Consecutive parts of the motion, each with its forces."""
        forces = self.constraint_forces
        for part in motion_of(self.recording, forces.kinematics):
            yield part, forces.evaluate(part.z, part.qd, part.qdd, self.model.p)

    def tables(self) -> Iterator[pl.DataFrame]:
        """Forces over time, t and one column per channel, part by part."""
        for part, values in self.over_time():
            yield pl.DataFrame([part.time, *values.T], ["t", *self.constraint_forces.names])

    def save(self, path: str | Path) -> None:
        """Write forces over time as CSV, whole or not at all, in constant memory.

        Raises:
            DeltaidError: the file cannot be written.
        """
        write_csv(Path(path), self.tables())


def forces(
    model: ModelLike,
    motion: RecordingLike,
    *,
    logs: RecordingLike | Sequence[RecordingLike] = (),
    strut_spacing: float | None = None,
    socket_force: float | None = None,
    columns: MappingLike | None = None,
    log_columns: ColumnMappings = None,
    progress: Watch = None,
) -> Forces:
    """Constraint forces along a motion: worst cases, margins of ball joints, and their uncertainty.

    Some forces depend on parameters that no torque determines. With `logs`, each force has its
    least and largest value that is compatible with the recordings; otherwise, how far the prior
    leaves it open.

    Args:
        motion: a planned motion or a recording; torques are not needed.
        logs: recordings that the model was identified from.
        strut_spacing: of the limbs [m], unless described.
        socket_force: that presses a strut's balls into their sockets [N], unless described.
        columns: mapping of the motion, unless it has the default columns.
        log_columns: the same for the recordings.
        progress: as of `identify`.

    Raises:
        DescriptionError: the limbs have one strut each, so neither spacing nor sockets.
        RecordingError: a recording is invalid, or the motion has no samples.
        IdentificationError: the recordings determine no base parameters, or no range was found.
    """
    positive("--socket-force", socket_force, _SPRINGS)
    known = with_struts(model, strut_spacing, socket_force)
    computed, given = ConstraintForces(known.robot), not isinstance(logs, Sequence) or bool(logs)
    if log_columns and not given:
        raise RecordingError(
            "mappings are given, but no recordings",
            where="--log-columns",
            cure="add --logs, or give the mapping of the motion as --columns",
        )
    with watched(progress, "forces") as say:
        source = as_source(motion)
        say(f"checking {source}")
        kinematics = computed.kinematics
        log = open_log(source, kinematics, as_mapping(columns), need_torque=False)
        recording = model_filtered(known, log, planned)
        say(f"computing forces along {recording.path}")
        extreme = extremes(computed, known.p, motion_of(recording, kinematics))
        ranges, certain = None, None
        if given:
            facts, certain = evidence(known, logs, columns=log_columns, progress=say)
            ranges = Ranges(facts, certain, known.p)
        certain = certain or Determinacy(known, random_motion_base(known.dynamics))
        say("finding ranges")
        findings = []
        for worst in worst_cases(computed, extreme):
            at = worst.at
            C = computed.coefficients(at.z[None], at.qd[None], at.qdd[None])[0]
            c = C[computed.index(worst.channel)]
            limits = ranges.force_range(c) if ranges else None
            findings.append(ForceFinding(worst, certain.openness(c), limits))
    seen = [*recording.log.warnings, *([_WITHOUT_LOADS] if recording.log.columns.loads else [])]
    sensors = ", ".join(x.name for x in (known.identified.sensors if known.identified else ()))
    aside = _ASIDE.format(sensors) if given and sensors else ""
    warnings = [*(f"{source}: {text}" for text in seen), computed.note, aside]
    warnings += unknown_ends(recording, "forces", _CURE)
    warnings += smoothed_away(recording, kinematics)
    return Forces(
        known, computed, recording, tuple(findings), extreme, tuple(filter(None, warnings))
    )


def with_struts(model: ModelLike, spacing: float | None, socket_force: float | None) -> Model:
    """The model with this strut spacing [m] and socket force [N] in its robot.

    Raises:
        DescriptionError: the limbs have one strut each, so neither spacing nor sockets.
        DeltaidError: the spacing or the force is out of limits.
    """
    model = load(model)
    limbs, asked = model.robot.limbs, {"strut_spacing": spacing, "socket_force": socket_force}
    given = {key: value for key, value in asked.items() if value is not None}
    if not given or limbs is None:
        return model
    if limbs.struts_per_limb == 1:
        raise DescriptionError(
            "limbs of one strut have no spacing and no sockets",
            where="limbs",
            cure="leave --strut-spacing and --socket-force out, or set limbs.struts_per_limb to 2",
        )
    positive("--strut-spacing", spacing, (SHORTEST, float(np.min(limbs.strut))))
    return replace(model, robot=model.robot.changed(limbs=limbs.changed(**given)))
