"""`deltaid.calibrate`: the geometry of a Delta from measured poses, and what they cannot know."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from deltaid.calibration.fit import MeasuringSession, fit, sessions
from deltaid.calibration.gauss_newton import GeometryFit
from deltaid.calibration.instruments import KINDS, Instrument
from deltaid.calibration.loops import Loops
from deltaid.calibration.mistakes import require_own, require_sense
from deltaid.calibration.outlook import Direction, Places, open_directions, places
from deltaid.calibration.readings import Measurements, ReadingsLike, read
from deltaid.calibration.robot_file import calibrated_robot
from deltaid.calibration.unknowns import LENGTH, Unknowns, unknowns
from deltaid.errors import DeltaidError, Doubt, RecordingError, within
from deltaid.estimation.information import triangle
from deltaid.model.verdict import percent
from deltaid.recording.memory import RecordingLike
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import RobotLike, described, load_yaml, save_yaml
from deltaid.shown import Plotted, Reported, Shown, Tabled

# Parts are off by less [m, rad], or they are of another robot.
_FARTHEST, _STEEPEST = 0.1, 0.3
# Noise that is so many times as large as stated is doubted.
_GROWN = 2.0


@dataclass(frozen=True)
class Knows:
    """Standard deviations over the workspace.

    Attributes:
        position: of positions, root mean square [m].
        worst: the same where it is largest [m].
        size: of sizes across, as a share.
    """

    position: float
    worst: float
    size: float


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Shown, Plotted, Tabled, Reported):
    """A calibrated geometry.

    Attributes:
        described: the robot as described before.
        robot: with the estimated geometry and its tolerances.
        left: root mean square of positions that `robot`, `zeros` and `scales` cannot hold [m].
        zeros: by rotary drive, what its coordinate is more than recorded [rad]; those of rails are
            in `robot`.
        scales: by drive, the share that it moves more than recorded.
        values: of all numbers, how much they exceed the described ones [m, rad or share].
        std: their standard deviations.
        decided: which source decided each number most: 'description', an instrument's kind, or
            'torques'.
        shares: of each source, description first, in each number.
        sessions: readings, file by file.
        rank: how many combinations of numbers and instruments' unknowns readings know better than
            the description does, these to a millimetre and a milliradian.
        before, after: what is known of positions and sizes.
        open: combinations that matter and that readings do not know.
    """

    described: RobotDescription
    robot: RobotDescription
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
    before: Knows
    after: Knows
    open: tuple[Direction, ...]
    places: Places = field(repr=False)
    fit: GeometryFit = field(repr=False)

    @property
    def sources(self) -> tuple[str, ...]:
        """Of `shares`: the description, then the instruments by kind."""
        torques = () if self.known.torques is None else ("torques",)
        return ("description", *(session.kind for session in self.sessions), *torques)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the numbers, such as 'limb1.strut'."""
        return self.known.names

    @property
    def verdict(self) -> str:
        """The main result in one sentence or two."""
        said = (
            f"positions to {_mm(self.after.position)} mm ({_mm(self.before.position)} before, "
            f"{_mm(self.after.worst)} at worst); sizes to {percent(self.after.size)}"
        )
        noisy = any(x.grown > _GROWN for x in self.sessions)
        return f"doubtful: {said}" if self.open or noisy else f"good: {said}"

    @property
    def doubts(self) -> tuple[str, ...]:
        """Numbers that are farther from the description than it allows, noise that is larger or
        smaller than stated, and what checks of recordings doubt."""
        far = np.abs(self.values) / [number.spread or np.inf for number in self.known.numbers]
        doubts: list[str] = [
            Doubt(
                f"{self.names[k]} is {far[k]:.2g} standard deviations from its description",
                cause="a tolerance that is too small for the part",
                cure="measure it, or state its tolerance in the robot file",
            )
            for k in np.argsort(-far)[:3]
            if far[k] > 5
        ]
        doubts += [
            Doubt(
                f"{x.source}: residuals are {x.grown:.2g}× the stated noise",
                cause="rows beside other poses, or numbers held or shared that differ",
                cure="compare the rows with their poses, or state the noise with --columns",
            )
            for x in self.sessions
            if x.grown > _GROWN
        ]
        doubts += [
            Doubt(
                f"{x.source}: residuals are {x.residual / x.noise:.2g}× the stated noise, so "
                "intervals are too wide",
                cause="an instrument that reads better than stated",
                cure="state how well it reads with --columns",
            )
            for x in self.sessions
            if x.quiet
        ]
        if (torques := self.known.torques) is not None:
            doubts += torques.doubts
            if torques.grown > _GROWN:
                doubts.append(
                    Doubt(
                        f"{torques.source}: torques contradict the poses, {torques.grown:.2g}× "
                        "their noise",
                        cause="a fault of this recording",
                        cure="run deltaid check on it",
                    )
                )
        return tuple(doubts)

    def save(self, path: str | Path) -> None:
        """Write the calibrated robot file.

        Raises:
            DeltaidError: it cannot be written.
        """
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
    """The geometry of a robot from measured poses, by any mixture of instruments.

    Args:
        robot: a description of limbs, by name, file or value.
        points: 3-D points of a tracker or camera in a frame of its own: files, or tables.
        probe: touches of a plane, bare or on blocks of known height.
        distances: between two tool points each, of a calliper or a ballbar.
        torques: recordings as of `identify`, beside other readings; they show zeros.
        columns: names of columns, units and noise by kind of instrument.
        lengths: standard deviation of lengths before [m]; None for the description's tolerance, or
            1 mm where it states none.
        angles: the same of angles [rad]; 1 mrad where nothing is stated.
        shared: kinds of numbers that are alike in all limbs, such as strut.
        hold: kinds or names of numbers that are as described; several, or one as text.
        struts_apart: whether struts of a limb differ, so that the platform tilts.
        tool: the tool from the platform point [m]; of effect only where the platform tilts.
        progress: called with a sentence before each stage of recordings.

    Returns:
        Geometry, intervals, what decided each number, what readings cannot know.

    Raises:
        DeltaidError: a deviation is negative or beyond what parts are off, or the tool is no point.
        RecordingError: there are no readings, or a file cannot be used as it stands.
        DescriptionError: the robot has no such numbers.
        IdentificationError: no geometry fits.
    """
    description = described(robot)
    within("lengths", lengths or 0.0, (0.0, _FARTHEST))
    within("angles", angles or 0.0, (0.0, _STEEPEST))
    if len(tool) != 3:
        raise DeltaidError(f"must be three numbers, not {len(tool)}", where="tool")
    shared, hold = ((x,) if isinstance(x, str) else x for x in (shared, hold))
    known = unknowns(
        description, apart=struts_apart, length=lengths, angle=angles, shared=shared, held=hold
    )
    loops = Loops(description, known, tool)
    mapping = (
        columns
        if isinstance(columns, Measurements)
        else load_yaml(Path(columns), Measurements)
        if columns
        else Measurements()
    )
    given = {"points": points, "probe": probe, "distances": distances}
    instruments: list[Instrument] = []
    for kind in KINDS:
        for source in _several(given[kind]):
            instruments.append(read(kind, source, getattr(mapping, kind), loops))
            require_own(instruments[-1], instruments[:-1])
            require_sense(loops, known, instruments[-1])
    if not instruments:
        raise RecordingError(
            "no poses were measured" if torques is not None else "nothing was measured",
            where="calibrate",
            cure="give --points, --probe or --distances with a file; torques add to these",
        )
    logs = _several(torques)
    if logs:
        from deltaid.calibration.torques import torque_rows  # loads all of identification

        rows = torque_rows(description, logs, mapping.torques, known, progress)
        known = replace(known, torques=rows)
    return result(description, fit(loops, known, instruments))


def _several(given: ReadingsLike | None) -> Sequence[RecordingLike]:
    if given is None:
        return ()
    return list(given) if isinstance(given, Sequence) and not isinstance(given, str) else [given]


def result(description: RobotDescription, found: GeometryFit) -> Calibration:
    """What a fit says."""
    known, theta = found.known, found.theta
    over = places(found.loops, known, theta)
    robot, zeros, scales, kept = calibrated_robot(description, known, theta, found.std)
    missing = over.moved @ np.where(kept, 0.0, theta)
    shares = found.shares()
    kinds = ["description", *(x.kind for x in found.instruments), "torques"]
    decided = tuple(kinds[k] for k in np.argmax(shares, axis=0))
    A = triangle(np.vstack([part.used_slopes for part in found.rows]))
    A[:, len(found.u) :] *= LENGTH
    s = np.linalg.svd(A, compute_uv=False)
    return Calibration(
        described=description,
        robot=robot,
        left=float(np.linalg.norm(missing) / np.sqrt(len(over.x))),
        zeros=zeros,
        scales=scales,
        known=known,
        values=theta,
        std=found.std,
        decided=decided,
        shares=shares,
        sessions=sessions(found),
        rank=int(np.sum(s > 1)),
        before=_knows(over, known.G),
        after=_knows(over, known.G @ found.root),
        open=open_directions(found, over),
        places=over,
        fit=found,
    )


def _knows(over: Places, root: Float[np.ndarray, "numbers _"]) -> Knows:
    errors = over.errors(root)
    return Knows(float(np.sqrt(np.mean(errors**2))), float(errors.max()), over.size(root))


def _mm(value: float) -> str:
    return f"{1e3 * value:.2g}"
