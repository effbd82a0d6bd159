"""The worst forces of an identified model along a motion, and how far they are known."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.errors import DescriptionError, Doubt, positive
from deltaid.files import written_whole
from deltaid.identification.sources import model_filtered
from deltaid.joint_forces.constraint_forces import ConstraintForces, Motion, motion_of
from deltaid.joint_forces.extremes import Extremes, Worst, extremes, worst_cases
from deltaid.joint_forces.ranges import (
    Openness,
    Range,
    Ranges,
    evidence,
    left_aside,
    structural_determinacy,
)
from deltaid.model.model import Model, ModelLike, load
from deltaid.progress import Watch, watched
from deltaid.recording.mapping import ColumnMappings, MappingLike, as_mapping
from deltaid.recording.memory import RecordingLike, as_source
from deltaid.recording.opening import open_log
from deltaid.recording.recording import Recording
from deltaid.shown import Plotted, Reported, Shown, Tabled

# Distances of struts [m] and forces of springs [N] that can be.
_SPACINGS, _SPRINGS = (1e-6, 100.0), (1e-6, 1e7)

_WITHOUT_LOADS = Doubt(
    "forces are those without the loads that the mapping declares",
    cause="what the robot holds is no part of its model",
    cure="describe the load as a part of the tool, and compute the forces again",
)


@dataclass(frozen=True)
class ForceFinding:
    """A worst force and how far it is known.

    Attributes:
        worst: which force, how large, when.
        openness: what torques, however exact, leave open of it.
        range: what is compatible with the recordings; None without them.
    """

    worst: Worst
    openness: Openness
    range: Range | None


@dataclass(frozen=True, repr=False)
class Forces(Shown, Plotted, Tabled, Reported):
    """What struts, joints and bearings carry along a motion.

    Attributes:
        model: whose parameters; its robot has the spacing and the springs that were given.
        constraint_forces: what computes the forces.
        recording: the motion, filtered as for the model's identification.
        findings: all worst cases.
        extremes: of all channels.
        warnings: about the motion and about what forces rest on.
    """

    model: Model
    constraint_forces: ConstraintForces
    recording: Recording
    findings: tuple[ForceFinding, ...]
    extremes: Extremes
    warnings: tuple[str, ...] = ()

    def over_time(self) -> Iterator[tuple[Motion, Float[np.ndarray, "samples channels"]]]:
        """Consecutive samples of the motion, each part with its forces."""
        forces = self.constraint_forces
        for part in motion_of(self.recording, forces.kinematics):
            yield part, forces.evaluate(part.z, part.qd, part.qdd, self.model.p)

    def tables(self) -> Iterator[pl.DataFrame]:
        """Forces over time, t and one column a channel, part by part."""
        for part, values in self.over_time():
            yield pl.DataFrame([part.time, *values.T], ["t", *self.constraint_forces.names])

    def save(self, path: str | Path) -> None:
        """Write forces over time as CSV, whole or not at all, in constant memory.

        Raises:
            DeltaidError: the file cannot be written.
        """
        with written_whole(Path(path)) as file:
            for k, part in enumerate(self.tables()):
                file.write(part.write_csv(include_header=k == 0))


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
    """Constraint forces along a motion: worst cases, margins of ball joints, and what is known.

    Some forces depend on parameters that no torque shows. With `logs` the least and largest value
    that agrees with the recordings is found, else how far the prior leaves a force open.

    Args:
        motion: a planned motion or a recording; it needs no torques.
        logs: recordings that the model was identified from.
        strut_spacing: of the limbs [m], if not described.
        socket_force: that presses a strut's balls together [N], if not described.
        columns: of the motion, if not the default ones.
        log_columns: the same for the recordings.
        progress: as of `identify`.

    Raises:
        DescriptionError: limbs of one strut have neither spacing nor sockets.
        RecordingError: a recording cannot be used, or the motion has no samples.
        IdentificationError: the recordings determine no base parameters, or a range was not found.
    """
    positive("--strut-spacing", strut_spacing, _SPACINGS)
    positive("--socket-force", socket_force, _SPRINGS)
    known = with_struts(model, strut_spacing, socket_force)
    computed, given = ConstraintForces(known.robot), not isinstance(logs, Sequence) or bool(logs)
    with watched(progress, "forces") as say:
        source = as_source(motion)
        say(f"checking {source}")
        kinematics = computed.kinematics
        log = open_log(source, kinematics, as_mapping(columns), need_torque=False)
        recording = model_filtered(known, log)
        say(f"computing forces along {recording.path}")
        found = extremes(computed, known.p, motion_of(recording, kinematics))
        ranges = None
        if given:
            facts, certain = evidence(known, logs, columns=log_columns, progress=say)
            ranges = Ranges(facts, certain, known.p)
        else:
            certain = structural_determinacy(known)
        say("finding ranges")
        findings = []
        for worst in worst_cases(computed, found):
            at = worst.at
            C = computed.coefficients(at.z[None], at.qd[None], at.qdd[None])[0]
            c = C[computed.index(worst.channel)]
            findings.append(
                ForceFinding(worst, certain.openness(c), ranges.force_range(c) if ranges else None)
            )
    seen = [*recording.log.warnings, *([_WITHOUT_LOADS] if recording.log.columns.loads else [])]
    warnings = [f"{source}: {text}" for text in seen]
    warnings += [computed.note] if computed.note else []
    warnings += left_aside(known) if given else ()
    return Forces(known, computed, recording, tuple(findings), found, tuple(warnings))


def with_struts(model: ModelLike, spacing: float | None, socket_force: float | None) -> Model:
    """A model whose robot has this strut spacing [m] and socket force [N] in place of its own.

    Raises:
        DescriptionError: limbs of one strut have neither.
    """
    model = load(model)
    limbs = model.robot.limbs
    given = {"strut_spacing": spacing, "socket_force": socket_force}
    given = {key: value for key, value in given.items() if value is not None}
    if not given or limbs is None:
        return model
    if limbs.struts_per_limb == 1:
        raise DescriptionError(
            "limbs of one strut have no spacing and no sockets",
            where="limbs",
            cure="leave --strut-spacing and --socket-force out, or set limbs.struts_per_limb to 2",
        )
    robot = model.robot.changed(limbs=limbs.changed(**given))
    return replace(model, robot=robot)
