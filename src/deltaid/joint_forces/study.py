"""The worst forces of an identified model along a motion, and how far they are known."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, TextIO, runtime_checkable

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.errors import DescriptionError
from deltaid.joint_forces.constraint_forces import ConstraintForces, Motion, motion_of
from deltaid.joint_forces.extremes import Extremes, Worst, extremes, worst_cases
from deltaid.joint_forces.ranges import (
    Openness,
    Range,
    Ranges,
    evidence,
    structural_determinacy,
)
from deltaid.model.model import Model, ModelLike, load
from deltaid.recording.mapping import ColumnMappings
from deltaid.recording.recording import Recording


@runtime_checkable
class Viewer(Protocol):
    """Sees the forces along a motion, window by window."""

    def add(self, motion: Motion, values: Float[np.ndarray, "samples channels"]) -> None:
        """Take in consecutive samples."""
        ...


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


@dataclass(frozen=True)
class ForceStudy:
    """All worst cases along a motion, and the extremes of all channels."""

    findings: tuple[ForceFinding, ...]
    extremes: Extremes


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


def study(
    model: ModelLike,
    forces: ConstraintForces,
    moving: Recording,
    *,
    recordings: Sequence[str | Path] = (),
    columns: ColumnMappings = None,
    viewers: Sequence[Viewer] = (),
    progress: Callable[[str], None] = lambda _: None,
) -> ForceStudy:
    """Worst cases of a model along a motion.

    Args:
        moving: the motion.
        recordings: logs that the model was identified from, to find ranges.
        columns: of the recordings.
        viewers: see every window of the motion with its forces.

    Raises:
        RecordingError: a recording cannot be used, or the motion has no samples.
        IdentificationError: the recordings determine no base parameters, or a range was not found.
    """
    model = load(model)
    progress(f"computing forces along {moving.path}")
    motion = motion_of(moving, forces.kinematics)
    found = extremes(forces, model.p, motion, [viewer.add for viewer in viewers])
    ranges = None
    if recordings:
        given, known = evidence(model, recordings, columns=columns, progress=progress)
        ranges = Ranges(given, known, model.p)
    else:
        known = structural_determinacy(model)
    progress("finding ranges")
    findings = []
    for worst in worst_cases(forces, found):
        at = worst.at
        C = forces.coefficients(at.z[None], at.qd[None], at.qdd[None])[0]
        c = C[forces.index(worst.channel)]
        findings.append(
            ForceFinding(worst, known.openness(c), ranges.force_range(c) if ranges else None)
        )
    return ForceStudy(tuple(findings), found)


class CsvFile:
    """Forces over time as CSV: t and one column a channel, line by line as they come."""

    def __init__(self, forces: ConstraintForces, file: TextIO) -> None:
        self._names, self._file, self._begun = forces.names, file, False

    def add(self, motion: Motion, values: Float[np.ndarray, "samples channels"]) -> None:
        """Write some consecutive samples."""
        columns = {"t": motion.time}
        columns |= {name: values[:, k] for k, name in enumerate(self._names)}
        self._file.write(pl.DataFrame(columns).write_csv(include_header=not self._begun))
        self._begun = True
