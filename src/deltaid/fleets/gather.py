"""Gather one recording: identify it alone, correct and condense it, with columns for any law."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.metadata import version

import numpy as np
from jaxtyping import Float

from deltaid.checks.identify import Judged, identify
from deltaid.dynamics.parameters import parameter_layout, prior_parameters
from deltaid.effects.lag_columns import LagColumns
from deltaid.effects.lag_groups import alone
from deltaid.effects.lags import HELD
from deltaid.effects.load_columns import LoadColumns
from deltaid.estimation.information import Information, merge, triangle
from deltaid.estimation.scatter import PlaceSums
from deltaid.fleets.factor_columns import GatheredColumns, map_to, plain
from deltaid.fleets.factor_file import FactorFile
from deltaid.fleets.factor_record import (
    FactorGroups,
    FactorRecord,
    GatheredLoad,
    KnownLag,
    Temperature,
)
from deltaid.identification.assembly import doubts_of_fit
from deltaid.identification.fit import FittedProblem, Progress
from deltaid.identification.gathering import gather
from deltaid.identification.geometric_rows import geometric_rows
from deltaid.identification.measured_rows import MeasuredRows
from deltaid.identification.warmth import Warmth, temperature
from deltaid.mechanism.kinematics import Kinematics
from deltaid.model.record import Settings
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import RecordingLike
from deltaid.recording.recording import PreparedRecording
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import RobotLike, load_robot

# Largest numbers of a recording's stretches of time and of places of the platform, the last of
# which collects rarely visited ones; least number of places.
_STRETCHES, _PLACES, _FEWEST_PLACES = 26, 14, 6
# Largest size of a file and of its record [bytes]; size of the triangles of the whole and of
# tolerances, in sizes of a group.
_BYTES, _BESIDE, _WHOLES = 950_000, 90_000, 3.5
# Number of windows of a recording that its temperature is read from.
_WINDOWS = 12
# Least number of places along the range of an axis.
_PARTS = 3


def gathered(
    robot: RobotLike,
    log: RecordingLike,
    *,
    columns: ColumnMapping | None = None,
    settings: Settings | None = None,
    force: bool = False,
    progress: Progress = lambda _: None,
) -> FactorFile:
    """Identify a recording alone, correct and condense it; arguments and errors are those of
    `deltaid.identify`. Effects found by the contest of causes are not corrected in the rows."""
    type_ = load_robot(robot)
    settings = (settings or Settings()).changed(effects="none")
    result = identify(
        type_, [log], columns=columns, settings=settings, force=force, progress=progress
    )
    progress("condensing")
    problem, recording = result.problem, result.recordings[0]
    over = gathered_columns(problem, recording)
    whole, groups = condensed(over, recording)
    geometry, quantities = geometry_of(over, problem, recording)
    return FactorFile(record_of(type_, result, over, quantities), whole, groups, geometry)


def gathered_columns(problem: FittedProblem, recording: PreparedRecording) -> GatheredColumns:
    """The columns of a recording that was fitted alone; columns of lags are slopes of the fitted
    torques."""
    extra = tuple(added for added in problem.additions if isinstance(added, LoadColumns | Warmth))
    columns = GatheredColumns.for_robot(problem.dynamics.robot, _plain_values(problem), extra)
    p = np.zeros(len(columns.names))  # loads are in the recording's gear loads
    p[columns.stored] = map_to(columns, problem.dynamics) @ problem.p
    lags = LagColumns(
        columns.dynamics, columns.additions, p, recording, alone(problem.dynamics.dof)
    )
    return replace(columns, additions=(*columns.additions, lags))


def condensed(
    columns: GatheredColumns, recording: PreparedRecording
) -> tuple[FactorGroups, FactorGroups]:
    """A recording's factors over gathered columns: whole, and in groups."""
    rows = MeasuredRows(columns.regressor)
    box, parts, names = _cells(columns.dynamics.robot, recording.log.reach)
    places = PlaceSums(box, rows.dof, len(rows.active) + 1, parts)
    column = np.append(np.searchsorted(rows.active, columns.stored), len(rows.active))
    with_tau = [column[np.append(places, -1)] for places in columns.of_drives]
    sizes = [len(places) for places in with_tau]
    # As many stretches and places as fit into a file.
    room = int(
        (_BYTES - _BESIDE) / (np.float32().itemsize * sum(n * (n + 1) // 2 for n in sizes))
        - _WHOLES
    )
    most_places = min(max(room - _STRETCHES, _FEWEST_PLACES), _PLACES)
    stretches = max(min(_STRETCHES, room - most_places), 2)
    blocks = gather(rows, recording, places, count=stretches)

    def groups(names: Sequence[str], parts: Sequence[Information]) -> FactorGroups:
        factors = np.stack([part.factors for part in parts], axis=1)
        counts = zip(*((part.samples, part.torque_max) for part in parts), strict=True)
        each = [R[:, :, places] for R, places in zip(factors, with_tau, strict=True)]
        return FactorGroups.of_rows(names, each, *map(np.stack, counts))

    times = groups([f"time {k}" for k in range(len(blocks))], blocks)
    visited = dict(_by_place(places.sums, names, most_places))
    roots = (
        np.stack([_root(sums[i][np.ix_(places, places)]) for sums in visited.values()])
        for i, places in enumerate(with_tau)
    )
    none = np.zeros((len(visited), rows.dof))
    return (
        groups(["whole"], [merge(blocks)]),
        times.joined(FactorGroups(tuple(visited), tuple(roots), none, none)),
    )


def geometry_of(
    columns: GatheredColumns, problem: FittedProblem, recording: PreparedRecording
) -> tuple[FactorGroups | None, tuple[str, ...]]:
    """Factors of some rows with the effects of the description's tolerances, if any, and their
    names."""
    if columns.dynamics.robot.tolerances.exact:
        return None, ()
    p, none = _plain_values(problem), np.zeros(columns.dynamics.dof)
    rows = next(
        geometric_rows(
            columns.regressor, columns.dynamics, recording, p, none + 1.0, active=columns.stored
        )
    )
    every = np.split(np.column_stack([rows.Y, rows.D, rows.tau]), len(none))
    shifts = np.arange(len(columns.stored), every[0].shape[1])
    drives = zip(every, columns.of_drives, strict=True)
    each = [part[None][:, :, [*places, *shifts]] for part, places in drives]
    return FactorGroups.of_rows(["geometry"], each, none[None], none[None]), rows.names


def _cells(
    robot: RobotDescription, reach: Float[np.ndarray, "2 3"]
) -> tuple[Float[np.ndarray, "2 3"], tuple[int, int, int], list[str]]:
    """Cells of the workspace that a recording reaches: their box [m], number along each axis,
    names.

    They are thirds of the workspace, halved until they are at most a third of the recording's
    range, so recordings of the same robot share cells and names.
    """
    low, high = robot.workspace.bounding_box
    whole = np.maximum(high - low, 1e-9)
    times = whole / np.clip(reach[1] - reach[0], 1e-3 * whole, whole)
    halvings = np.floor(np.log2(times)).astype(int)
    size = whole / (_PARTS * 2.0**halvings)
    first = np.floor((reach[0] - low) / size).astype(int)
    last = np.maximum(np.ceil((reach[1] - low) / size).astype(int), first + 1)
    x, y, z = (last - first).tolist()
    cells = first + np.array(list(np.ndindex(z, y, x)))[:, ::-1]
    kind = ".".join(map(str, halvings))
    names = [f"place {kind}:{'.'.join(map(str, cell))}" for cell in cells]
    return low + np.stack([first, last]) * size, (x, y, z), names


def _by_place(
    sums: Float[np.ndarray, "places drives augmented augmented"], names: list[str], count: int
) -> Iterator[tuple[str, np.ndarray]]:
    """Sums of the most visited places, and one for all others."""
    weight = np.einsum("pijj->p", sums)
    visited = np.argsort(-weight, kind="stable")[: np.count_nonzero(weight)]
    for k in sorted(visited[: count - 1].tolist()):
        yield names[k], sums[k]
    if len(visited) >= count:
        yield "place elsewhere", sums[visited[count - 1 :]].sum(axis=0)


def _root(G: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "rank n"]:
    """R with RᵀR = G, G positive semidefinite."""
    values, vectors = np.linalg.eigh(G)
    return triangle(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T)


def _plain_values(problem: FittedProblem) -> Float[np.ndarray, " plain"]:
    """The fitted parameters of the robot with plain friction."""
    robot = plain(problem.dynamics.robot)
    values = parameter_layout(robot).named(prior_parameters(robot))
    fitted = problem.dynamics.layout.named(problem.p)
    return np.array([fitted.get(name, value) for name, value in values.items()])


def record_of(
    robot: RobotDescription,
    result: Judged,
    columns: GatheredColumns,
    quantities: tuple[str, ...],
) -> FactorRecord:
    recording, model = result.recordings[0], result.model
    log, (low, high) = recording.log, recording.log.reach.tolist()
    fastest = {curve.joint: max(curve.speed) for curve in model.friction_curves}
    judged = {verdict.sentence for verdict in result.verdicts} | {*doubts_of_fit(result.problem)}
    loads = zip(log.columns.loads, recording.repairs.loads, strict=True)
    return FactorRecord(
        deltaid=version("deltaid"),
        robot=robot,
        # Friction curves and posterior follow from the triangles.
        model=model.changed(friction_curves=(), posterior=None),
        names=tuple(columns.place),
        felt=tuple(tuple(places.tolist()) for places in columns.of_drives),
        quantities=quantities,
        noise=tuple(model.fit.rms),
        fastest=tuple(float(fastest.get(drive, 0.0)) for drive in model.robot.drives),
        first=float(log.clock.first),
        last=float(log.clock.last),
        reach=(tuple(low), tuple(high)),
        lags=_lags(result),
        loads=tuple(GatheredLoad(load=load, taken=taken) for load, taken in loads),
        temperature=_temperature(recording, result.problem.dynamics.kinematics),
        verdicts=tuple(replace(verdict, proposals=()) for verdict in result.verdicts),
        warnings=tuple(text for text in model.warnings if text not in judged),
    )


def _temperature(recording: PreparedRecording, kinematics: Kinematics) -> Temperature | None:
    if recording.log.columns.temperature is None:
        return None
    windows = recording.spread(kinematics, _WINDOWS)
    T = np.concatenate([temperature(recording, window.inner) for window in windows])
    T = T[np.isfinite(T)]
    if not T.size:
        return None
    return Temperature(mean=float(T.mean()), low=float(T.min()), high=float(T.max()))


def _lags(result: Judged) -> tuple[KnownLag, ...]:
    drives = result.model.robot.drives
    delays = result.recordings[0].repairs.lag or (0.0,) * len(drives)
    free = {
        i: (group.remaining_lag, group.deviation if np.isfinite(group.deviation) else None)
        for lags in result.problem.additions
        if isinstance(lags, LagColumns)
        for group in lags.groups
        if group.free
        for i in group.drives
    }
    known = (free.get(i, (0.0, HELD)) for i in range(len(drives)))
    return tuple(
        KnownLag(drive=drive, delay=delay, beside=remaining_lag, deviation=deviation)
        for drive, delay, (remaining_lag, deviation) in zip(drives, delays, known, strict=True)
    )
