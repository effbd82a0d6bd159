"""One recording condensed: identified by itself, put right, gathered with columns for any law."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from deltaid.check.identified import identify
from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.lag_columns import LagColumns, alone
from deltaid.estimation.information import Information, merge, triangle
from deltaid.estimation.places import Places
from deltaid.factors.columns import GatheredColumns, plain
from deltaid.factors.condensed import Condensed, Group, Groups, counts
from deltaid.factors.file import FactorFile
from deltaid.factors.lattice import Lattice
from deltaid.factors.record_of import record_of
from deltaid.factors.target import map_to
from deltaid.identification.fit import FittedProblem, Progress
from deltaid.identification.gathering import gather
from deltaid.identification.geometry import geometric_rows
from deltaid.identification.load_columns import LoadColumns
from deltaid.identification.measured_rows import MeasuredRows
from deltaid.identification.warmth import Warmth
from deltaid.model.record import Settings
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import RecordingLike
from deltaid.recording.recording import Recording
from deltaid.robot.load import RobotLike, described


def gathered_columns(problem: FittedProblem, recording: Recording) -> GatheredColumns:
    """The columns of a recording that has been fitted by itself.

    Lags see the slope of the fitted model's torques.
    """
    kept = tuple(one for one in problem.additions if isinstance(one, LoadColumns | Warmth))
    columns = GatheredColumns.of(problem.dynamics.robot, _plain_values(problem), kept)
    p = np.zeros(len(columns.names))  # what is held is in what the recording's gears carry
    p[columns.kept] = map_to(columns, problem.dynamics) @ problem.p
    each = alone(problem.dynamics.dof)
    lags = LagColumns(columns.dynamics, columns.additions, p, recording, each)
    return replace(columns, additions=(*columns.additions, lags))


def condensed(columns: GatheredColumns, recording: Recording) -> Condensed:
    """A recording's factors over gathered columns."""
    rows = MeasuredRows(columns.regressor)
    lattice = Lattice.over(columns.dynamics.robot, recording.log.reach)
    places = Places(lattice.box, rows.dof, len(rows.active) + 1, lattice.parts)
    at = np.searchsorted(rows.active, columns.kept)
    drives, entries = rows.regressor_pattern
    felt = tuple(
        np.flatnonzero(np.isin(columns.kept, entries[drives == i])) for i in range(rows.dof)
    )
    stretch_count, place_count = counts([len(own) + 1 for own in felt])
    blocks = gather(rows, recording, places, count=stretch_count)
    places_at = [np.append(at[one], len(rows.active)) for one in felt]

    def group(name: str, part: Information) -> Group:
        factors = (triangle(part.factors[i][:, own]) for i, own in enumerate(places_at))
        return Group(name, tuple(factors), part.samples, part.torque_max)

    stretches = [group(f"time {k}", block) for k, block in enumerate(blocks)]
    return Condensed(
        columns.kept_names,
        felt,
        group("whole", merge(blocks)),
        Groups.of([*stretches, *_by_place(places.sums, places_at, lattice, place_count)]),
    )


def with_geometry(
    condensed: Condensed, columns: GatheredColumns, problem: FittedProblem, recording: Recording
) -> tuple[Condensed, tuple[str, ...]]:
    """The same with what tolerances of the description do to some rows, and the names of these."""
    plain_one = columns.dynamics
    if plain_one.robot.tolerances.exact:
        return condensed, ()
    dof, p = plain_one.dof, _plain_values(problem)
    rows = geometric_rows(
        columns.regressor, plain_one, recording, p, np.ones(dof), active=columns.kept
    )
    Y, D = (x.reshape(dof, -1, x.shape[1]) for x in (rows.Y, rows.D))
    tau = rows.tau.reshape(dof, -1)
    factors = tuple(
        triangle(np.column_stack([Y[i][:, own], D[i], tau[i]]))
        for i, own in enumerate(condensed.felt)
    )
    none = np.zeros(dof)
    return replace(condensed, geometry=Group("geometry", factors, none, none)), rows.names


def gathered(
    robot: RobotLike,
    log: RecordingLike,
    *,
    columns: ColumnMapping | None = None,
    settings: Settings | None = None,
    force: bool = False,
    progress: Progress = lambda _: None,
) -> FactorFile:
    """What a recording says, as small as it goes: identified by itself, put right, condensed.

    Args:
        robot, log, columns, settings, force, progress: as of `deltaid.identify`.

    Raises:
        DescriptionError: the description is wrong.
        RecordingError: the log cannot be used, or is wrong.
        IdentificationError: it tells too little by itself.
    """
    described_robot = described(robot)
    result = identify(
        described_robot, [log], columns=columns, settings=settings, force=force, progress=progress
    )
    progress("condensing")
    problem, recording = result.problem, result.recordings[0]
    own = gathered_columns(problem, recording)
    found, quantities = with_geometry(condensed(own, recording), own, problem, recording)
    return FactorFile(record_of(described_robot, result, found, quantities), found)


def _by_place(
    sums: Float[np.ndarray, "places drives augmented augmented"],
    at: Sequence[np.ndarray],
    lattice: Lattice,
    count: int,
) -> list[Group]:
    """The places that are visited most, and one for all others; so many at most."""
    weight = np.einsum("pijj->p", sums)
    visited = np.flatnonzero(weight > 0)
    visited = visited[np.argsort(-weight[visited], kind="stable")]
    own, rest = visited[: count - 1], visited[count - 1 :]
    named = [(lattice.name(int(k)), sums[k]) for k in np.sort(own)]
    if rest.size:
        named.append(("place elsewhere", sums[rest].sum(axis=0)))
    none = np.zeros(len(at))
    return [
        Group(
            name,
            tuple(_root(G[i][np.ix_(own, own)]) for i, own in enumerate(at)),
            none,
            none,
        )
        for name, G in named
    ]


def _root(G: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "rank n"]:
    """R with RᵀR = G, G positive semidefinite."""
    values, vectors = np.linalg.eigh(G)
    return triangle(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T)


def _plain_values(problem: FittedProblem) -> Float[np.ndarray, " plain"]:
    """The fitted parameters of the robot with plain friction."""
    dynamics = compiled(plain(problem.dynamics.robot))
    known = dict(zip(problem.dynamics.layout.names, problem.p.tolist(), strict=True))
    prior = prior_parameters(dynamics.robot)
    return np.array(
        [known.get(n, x) for n, x in zip(dynamics.layout.names, prior.tolist(), strict=True)]
    )
