"""`deltaid.calibrate`: geometry of a Delta from measured poses, with undetermined combinations."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from deltaid.calibration.fit import GROWN, GeometryFit, UsedReadings, fit
from deltaid.calibration.loops import Loops
from deltaid.calibration.mistakes import require_new_readings, require_plausible
from deltaid.calibration.outlook import Direction, Places, PoseUncertainty, open_directions, places
from deltaid.calibration.readings import Instrument, ProbeReadings
from deltaid.calibration.tables import Measurements, ReadingsLike, read
from deltaid.calibration.unknowns import (
    TOLERANCE,
    Unknowns,
    calibrated_robot,
    in_words,
    unknowns,
    unwritten,
)
from deltaid.errors import DeltaidError, Doubt, RecordingError, within
from deltaid.estimation.information import triangle
from deltaid.levels import CERTAIN, UNLIKELY
from deltaid.model.verdict import percent
from deltaid.recording.memory import RecordingLike
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import RobotLike, load_robot, load_yaml, save_yaml
from deltaid.sensors.planning.knowledge import Knowledge
from deltaid.sensors.planning.offers import PoseKind
from deltaid.shown import Plotted, Reported, Shown, Tabled

# Largest accepted prior deviations of lengths [m] and angles [rad]; beyond, it is another robot.
_FARTHEST, _STEEPEST = 0.1, 0.3


@dataclass(frozen=True)
class MeasuringSession:
    """Readings of one file: their number, the excluded ones in words, the residual of the rest,
    root mean square [m], and the noise that the fit used [m]. `grown` is that noise over the stated
    one; `quiet` is true where residuals are far below the stated noise."""

    kind: PoseKind
    source: str
    readings: int
    excluded: tuple[str, ...]
    residual: float
    noise: float
    grown: float
    quiet: bool


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Shown, Plotted, Tabled, Reported):
    """A calibrated geometry.

    Attributes:
        described, robot: the given description, and the same with the estimated geometry and its
            tolerances.
        lost, left: kinds of numbers that `robot`, `zeros` and `scales` cannot hold, in words, and
            the position error without them, root mean square [m].
        zeros: by rotary drive, how much its coordinate exceeds the recorded one [rad]; zeros of
            rails are in `robot`.
        scales: by drive, the share by which its motion exceeds the recorded one.
        values, std: deviation of each number from the description, and its standard deviation
            [m, rad or share].
        decided, shares: for each number, the source ('description', an instrument's kind, or
            'torques') that decided it most, and the shares of all sources, description first.
        sessions: readings, file by file.
        rank: number of combinations of numbers and instruments' unknowns that readings determine
            better than the prior: the description, a millimetre and a milliradian for instruments.
        before, after: uncertainty of positions and sizes before and after the measurements.
        open: combinations that matter and that readings do not determine.
    """

    described: RobotDescription
    robot: RobotDescription
    lost: str
    left: float
    zeros: dict[str, float]
    scales: dict[str, float]
    known: Unknowns
    values: Float[np.ndarray, " numbers"]
    std: Float[np.ndarray, " numbers"]
    decided: tuple[str, ...]
    shares: Float[np.ndarray, "sources numbers"]
    sessions: tuple[MeasuringSession, ...]
    rank: int
    before: PoseUncertainty
    after: PoseUncertainty
    open: tuple[Direction, ...]
    places: Places = field(repr=False)
    fit: GeometryFit = field(repr=False)

    @property
    def sources(self) -> tuple[str, ...]:
        """Row names of `shares`: the description, then the instruments by kind."""
        torques = () if self.known.torques is None else ("torques",)
        return ("description", *(session.kind for session in self.sessions), *torques)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the numbers, such as 'limb1.strut'."""
        return self.known.names

    @property
    def verdict(self) -> str:
        """The main result in one sentence or two."""
        after, before, worst = (
            f"{1e3 * x:.2g}" for x in (self.after.position, self.before.position, self.after.worst)
        )
        grade = "doubtful" if self.open or self.doubts else "good"
        return (
            f"{grade}: positions to {after} mm ({before} before, {worst} at worst); "
            f"sizes to {percent(self.after.size)}"
        )

    @property
    def unwritten(self) -> tuple[str, ...]:
        """What the robot file does not hold, in words that follow 'holds'."""
        by_drive = unwritten(self.zeros, self.scales)
        leaves = f"no {self.lost}, which leaves {1e3 * self.left:.2g} mm of position (rms)"
        return tuple(filter(None, (by_drive, leaves if self.lost else "")))

    @property
    def unseen(self) -> tuple[str, ...]:
        """Measuring mistakes that these readings cannot reveal."""
        kinds = {session.kind for session in self.sessions}
        if "points" in kinds or not self.described.identical_drives:
            return ()
        return (
            "whether x and y of commanded points, or two drives, are exchanged (equal limbs mirror "
            "each other), or the points' origin is shifted: residuals would be as small; move to "
            "the middle and along x, and look",
        )

    @property
    def doubts(self) -> tuple[str, ...]:
        """Numbers that are farther from the description than it allows, noise that differs from the
        stated one, and doubts of the checks of recordings."""
        far, torques = self.fit.far, self.known.torques
        rows = [
            (f"{self.names[k]} is {far[k]:.2g} standard deviations from its description",
             "a tolerance that is too small for the part",
             "measure it, or state how far it may be off with --lengths and --angles")
            for k in np.argsort(-far)[:3] if far[k] > CERTAIN
        ] + [
            (f"{x.source}: residuals are {x.grown:.2g}× the stated noise",
             "noise that is stated too small, rows beside other poses, or numbers held or shared "
             "that differ",
             "state the noise with --columns, or compare the rows with their poses")
            for x in self.sessions if x.grown > GROWN
        ] + [
            (f"{x.source}: residuals are {x.residual / x.noise:.2g}× the stated noise, so "
             "intervals are too wide",
             "an instrument that reads better than stated",
             "state how well it reads with --columns")
            for x in self.sessions if x.quiet
        ]  # fmt: skip
        if torques and torques.grown > GROWN:
            rows.append(
                (f"{torques.source}: torques contradict the poses, {torques.grown:.2g}× their "
                 "noise",
                 "drives that were homed in between, or a fault of this recording",
                 "record and measure without homing, and run deltaid check on the recording")
            )  # fmt: skip
        return (
            *(Doubt(what, cause=cause, cure=cure) for what, cause, cure in rows),
            *(torques.doubts if torques else ()),
        )

    def save(self, path: str | Path) -> None:
        """Write the calibrated robot file, or raise a DeltaidError."""
        save_yaml(self.robot, Path(path))


def calibrate(
    robot: RobotLike,
    *,
    points: ReadingsLike | None = None,
    probe: ReadingsLike | None = None,
    distances: ReadingsLike | None = None,
    torques: ReadingsLike | None = None,
    columns: Measurements | str | Path | None = None,
    lengths: float | None = None,
    angles: float | None = None,
    shared: Sequence[str] = (),
    hold: Sequence[str] = (),
    struts_apart: bool = False,
    tool: Sequence[float] = (0.0, 0.0, 0.0),
    progress: Callable[[str], None] = lambda _: None,
) -> Calibration:
    """Estimate the geometry of a robot from measured poses, by any mixture of instruments.

    Args:
        robot: a description of limbs, by name, file or value.
        points: 3-D points of a tracker or camera in its frame: files, or tables.
        probe: touches of a plane, bare or on blocks of known height.
        distances: between two tool points each, by a calliper or a ballbar.
        torques: recordings as for `identify`, in addition to other readings; they determine zeros.
        columns: names of columns, units and noise by kind of instrument.
        lengths: prior standard deviation of lengths [m]; None for the description's tolerance, or
            1 mm where it states none.
        angles: prior standard deviation of angles [rad]; None for 1 mrad, or the stated homing.
        shared: kinds of numbers that are equal in all limbs, such as strut.
        hold: kinds or names of numbers that stay as described; several, or one as text.
        struts_apart: whether struts of a limb differ, so that the platform tilts.
        tool: offset from the platform point [m]; matters only where the platform tilts.
        progress: called with a sentence before each stage of recordings.

    Returns:
        The geometry with intervals, the sources of each number, and what remains undetermined.

    Raises:
        DeltaidError: a deviation is negative or too large, or the tool is no point near the robot.
        RecordingError: there are no readings, or a file cannot be used.
        DescriptionError: the robot has no limbs or separate struts, or every number is held.
        IdentificationError: no geometry fits.
    """
    description = load_robot(robot)
    within("lengths", lengths or 0.0, (0.0, _FARTHEST))
    within("angles", angles or 0.0, (0.0, _STEEPEST))
    if len(tool) != 3:
        raise DeltaidError(f"must be three numbers, not {len(tool)}", where="tool")
    if description.limbs is not None:  # in mm it would be longer than a strut
        longest = float(np.max(description.limbs.strut))
        for part in tool:
            within("tool", part, (-longest, longest))
    shared, hold = ((x,) if isinstance(x, str) else x for x in (shared, hold))
    known = unknowns(
        description, apart=struts_apart, length=lengths, angle=angles, shared=shared, held=hold
    )
    loops, mapping = Loops(description, known, tool), columns or Measurements()
    if not isinstance(mapping, Measurements):
        mapping = load_yaml(Path(mapping), Measurements)
    by_kind: dict[PoseKind, ReadingsLike | None] = {
        "points": points, "probe": probe, "distances": distances
    }  # fmt: skip
    instruments = _instruments(by_kind, mapping, loops, known)
    if not instruments:
        raise RecordingError(
            "no poses were measured" if torques is not None else "nothing was measured",
            where="calibrate",
            cure="give --points, --probe or --distances with a file; torques add to these",
        )
    if logs := _as_sequence(torques):
        from deltaid.calibration.torques import torque_rows  # loads identification

        rows = torque_rows(description, logs, mapping.torques, known, progress)
        known = replace(known, torques=rows)
    return _result(description, fit(loops, known, instruments))


def _instruments(
    by_kind: Mapping[PoseKind, ReadingsLike | None],
    mapping: Measurements,
    loops: Loops,
    known: Unknowns,
) -> list[Instrument]:
    instruments = list[Instrument]()
    for kind, given in by_kind.items():
        for source in _as_sequence(given):
            instruments.append(read(kind, source, getattr(mapping, kind), loops))
            require_new_readings(instruments[-1], instruments[:-1])
            require_plausible(loops, known, instruments[-1])
    return instruments


def _as_sequence(given: ReadingsLike | None) -> Sequence[RecordingLike]:
    if given is None:
        return ()
    return list(given) if isinstance(given, Sequence) and not isinstance(given, str) else [given]


def _result(description: RobotDescription, solution: GeometryFit) -> Calibration:
    known, theta = solution.known, solution.known.G @ solution.u
    over = places(solution.loops, known, theta)
    std = np.linalg.norm(known.G @ solution.root, axis=1)
    robot, zeros, scales, kept = calibrated_robot(description, known, theta, std)
    shares = solution.shares()
    kinds = ["description", *(part.instrument.kind for part in solution.readings), "torques"]
    A = triangle(np.vstack([part.used_slopes for part in solution.rows]))
    A[:, len(solution.u) :] *= TOLERANCE
    lost = np.where(kept, 0.0, theta)
    return Calibration(
        described=description, robot=robot, zeros=zeros, scales=scales, known=known, fit=solution,
        lost=in_words(known, lost), values=theta, std=std,
        left=float(np.linalg.norm(over.moved @ lost) / np.sqrt(len(over.x))),
        decided=tuple(kinds[k] for k in np.argmax(shares, axis=0)), shares=shares,
        sessions=tuple(_session(part, solution.knowledge) for part in solution.readings),
        rank=int(np.sum(np.linalg.svd(A, compute_uv=False) > 1)),
        before=over.uncertainty(known.G), after=over.uncertainty(known.G @ solution.root),
        places=over, open=open_directions(solution, over),
    )  # fmt: skip


def _session(part: UsedReadings, knowledge: Knowledge) -> MeasuringSession:
    square, freedom = part.chance(knowledge)
    return MeasuringSession(
        kind=part.instrument.kind,
        source=part.instrument.source,
        readings=len(part.used),
        excluded=tuple(_excluded(part, int(k)) for k in np.flatnonzero(~part.used)),
        residual=part.rms * part.noise,
        noise=part.noise,
        grown=part.grown,
        quiet=bool(freedom >= 1 and square * GROWN**2 < chi2.ppf(UNLIKELY, freedom)),
    )


def _excluded(part: UsedReadings, k: int) -> str:
    """Why a reading is excluded: a repeat, another reading's pose, or an outlier."""
    instrument, errors = part.instrument, part.noise * part.errors
    row = f"row {instrument.rows[k]}"
    if (first := instrument.repeats[k]) != k:
        return f"{row}: the same as row {instrument.rows[first]}"
    why = f"{row}: off by {1e3 * np.abs(errors[k]).max():.3g} mm"
    # another excluded row whose prediction fits this reading, to a hundredth of its error
    far = np.linalg.norm(instrument.values[k] - (instrument.values - errors), axis=1)
    others = np.flatnonzero(~part.used & (far < 0.01 * far[k]))
    if others.size and not isinstance(instrument, ProbeReadings):
        why += f", it fits the pose of row {instrument.rows[others[0]]}"
    return why
