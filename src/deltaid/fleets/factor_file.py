"""Factor files: one small Parquet file per recording.

A row of the table is one drive's triangle for one group of samples. The triangle of all samples
keeps every bit; triangles of stretches, places and tolerances, which only determine uncertainty,
keep seven digits. Everything else is JSON under the key `deltaid` of the file's metadata.

The key of a file is a checksum of its inputs. Files of the same mechanism and the same filter may
be merged, each recording once.
"""

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from pydantic import ValidationError

from deltaid.checksum import EMPTY, require_intact, sealed
from deltaid.errors import DeltaidError, RecordingError
from deltaid.files import readable, write_bytes
from deltaid.fleets.factor_record import (
    FORMAT,
    FactorGroups,
    FactorRecord,
    RecordingBrief,
    RecordingFacts,
    entries_of,
    triangles_of,
)
from deltaid.forked import require_threads
from deltaid.identification.sources import repeated
from deltaid.model.corrections import Source
from deltaid.model.record import Settings
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.row_sample import numbers_in
from deltaid.recording.source import POLARS_ERRORS
from deltaid.robot.complaints import key_path
from deltaid.robot.description import RobotDescription

ENDING = ".factors.parquet"
_KEY, _FROM = "deltaid", "deltaid_from"
_CURE = "gather the recording again with `deltaid gather`"
_SCHEMA = {
    "group": pl.String,
    "drive": pl.Int32,
    "samples": pl.Float64,
    "torque_max": pl.Float64,
    "exact": pl.List(pl.Float64),
    "rounded": pl.List(pl.Float32),
}
# Settings of the fit; all others apply when a recording is gathered.
FIT_SETTINGS = {"method", "regularizer", "gamma", "prior_spread", "intervals", "friction"}
# Keys of a description that do not change gathered columns: priors, measured values and limits.
_FREE: dict[str, Any] = {
    **dict.fromkeys(
        ("name", "title", "bodies", "friction", "measured", "sensors", "sources"), True
    ),
    **dict.fromkeys(("strut_swing_deg", "platform_speed", "platform_acceleration"), True),
    "largest_condition": True,
    "springs": {"__all__": {"stiffness"}},
    "drive_limits": {
        "__all__": {
            *("angle_deg", "acceleration_deg_s2", "torque"),
            *("position", "acceleration", "force"),
        }
    },
}
# Largest relative difference of cut-offs that count as equal.
_SAME = 0.02


@dataclass(frozen=True, eq=False)
class FactorFile:
    record: FactorRecord
    whole: FactorGroups  # one group: all samples
    groups: FactorGroups  # stretches of time, then places
    # one group: some samples, with the effects of the description's tolerances before τ, if any
    geometry: FactorGroups | None = None
    path: str = ""  # of the file; empty if it is not written yet
    key: str = ""  # checksum of its inputs

    @cached_property
    def brief(self) -> RecordingBrief:
        """Data for a fit of many recordings in addition to the factors."""
        record, model = self.record, self.record.model
        return RecordingBrief.model_construct(
            source=model.sources[0],
            path=self.path,
            friction=dict(model.robot.friction),
            rms=tuple(model.fit.rms),
            rms_unfiltered=tuple(model.fit.rms_unfiltered),
            samples=float(self.whole.samples.mean()),
            sensors=tuple(sensor.name for sensor in model.sensors),
            masses={load.name: load.parameters[0].value for load in model.loads},
            corrections=tuple(model.corrections),
            degrees=None if record.temperature is None else record.temperature.mean,
            **{name: getattr(record, name) for name in RecordingFacts.model_fields},
        )


def write(file: FactorFile, path: Path, key: str = "") -> None:
    """Write a factor file, whole or not at all; `key` is a checksum of its inputs. Raises a
    DeltaidError if it cannot be written."""
    rows = list[tuple[object, ...]]()
    for groups in filter(None, (file.whole, file.geometry, file.groups)):
        for k, i in np.ndindex(len(groups), len(groups.factors)):
            R, sizes = groups.factors[i][k], (groups.samples[k, i], groups.torque_max[k, i])
            (numbers,) = entries_of(R[None])
            exact = (numbers, None) if groups is file.whole else (None, numbers.astype("f4"))
            rows.append((groups.names[k], i, *sizes, *exact))
    table, buffer = pl.DataFrame(rows, schema=_SCHEMA, orient="row"), BytesIO()
    table.write_parquet(
        buffer,
        compression="zstd",
        metadata={
            _KEY: file.record.model_dump_json(exclude_none=True),
            _FROM: key,
            "checksum": EMPTY,
        },
    )
    write_bytes(path, sealed(buffer.getvalue()))


def read(path: Path) -> FactorFile:
    """Read a factor file.

    Raises:
        RecordingError: it is no factor file, is damaged, or is of a later version.
    """
    where = str(path)
    require_threads()
    with readable(path, RecordingError):
        data = path.read_bytes()
    try:
        require_intact(data, where, RecordingError, _CURE)
        metadata = pl.read_parquet_metadata(BytesIO(data))
        table = pl.read_parquet(BytesIO(data))
    except POLARS_ERRORS as error:
        raise _refusal(f"cannot be read as a factor file: {error}", where) from None
    if table.schema != pl.Schema(_SCHEMA) or _KEY not in metadata:
        raise _refusal("is no factor file: its columns or its record are missing", where)
    try:
        record = FactorRecord.model_validate_json(metadata[_KEY])
    except ValidationError as error:
        first = error.errors()[0]
        why = f"{key_path(first['loc'])}: {first['msg']}"
        raise _refusal(
            f"is a factor file that this version (format {FORMAT}) cannot use: {why}", where
        ) from None
    except DeltaidError as error:
        raise _refusal(f"holds what cannot be: {error.what}", where) from None
    return FactorFile(record, *_groups_of(table, record), where, metadata.get(_FROM, ""))


def _refusal(reason: str, where: str) -> RecordingError:
    return RecordingError(reason, where=where, cure=_CURE)


def _groups_of(
    table: pl.DataFrame, record: FactorRecord
) -> tuple[FactorGroups, FactorGroups, FactorGroups | None]:
    drives, shifts = len(record.felt), len(record.quantities)
    whole, geometry, rest = (table[drives * k :] for k in (0, 1, 1 + bool(shifts)))
    sizes = tuple(len(places) + 1 for places in record.felt)
    wide = tuple(n + shifts for n in sizes)
    return (
        _groups(whole[:drives], sizes, "exact"),
        _groups(rest, sizes, "rounded"),
        _groups(geometry[:drives], wide, "rounded") if shifts else None,
    )


def _groups(table: pl.DataFrame, sizes: tuple[int, ...], column: str) -> FactorGroups:
    names = tuple(table["group"].to_list()[:: len(sizes)])
    numbers = table[column].explode().to_numpy().reshape(len(names), -1)
    ends = np.cumsum([n * (n + 1) // 2 for n in sizes])[:-1]
    factors = tuple(map(triangles_of, np.split(numbers, ends, axis=1)))
    counts = (table[key].to_numpy().reshape(len(names), -1) for key in ("samples", "torque_max"))
    return FactorGroups(names, factors, *counts)


def digest(content: Any) -> str:
    """Checksum of JSON data."""
    return hashlib.sha256(
        json.dumps(content, sort_keys=True, separators=(",", ":")).encode()
    ).hexdigest()


def safe(name: str) -> str:
    """Replace characters of a name that a file's name should not have."""
    return re.sub(r"[^\w.+-]+", "-", name)


def gathering_digest(
    robot: RobotDescription, mapping: ColumnMapping | None, settings: Settings
) -> str:
    """Checksum of how a recording is gathered: mechanism, mapping of columns, settings of filter,
    masks and corrections, version of the file."""
    return digest(
        [
            FORMAT,
            _mechanism(robot),
            (mapping or ColumnMapping()).model_dump(mode="json"),
            settings.model_dump(mode="json", exclude=FIT_SETTINGS),
        ]
    )


def require_alike(files: Sequence[FactorFile], robot: RobotDescription) -> None:
    """Refuse files that cannot be merged.

    Raises:
        RecordingError: no file is given; or one differs in mechanism from the robot, in filter from
            the first, or repeats a recording.
    """
    if not files:
        raise RecordingError("no factor file was given", where="logs", cure="give at least one")
    for file in files:
        require_mechanism(file, robot)
    require_together([file.brief for file in files])


def require_mechanism(file: FactorFile, robot: RobotDescription) -> None:
    """Refuse a file of another mechanism.

    Raises:
        RecordingError: the mechanisms differ; the message names the difference.
    """
    for key, gathered, described in _differences(_mechanism(file.record.robot), _mechanism(robot)):
        raise RecordingError(
            f"was gathered with {key} {gathered}, and the robot has {described}",
            where=file.path,
            cure="gather its recording again with this description",
        )


def require_together(briefs: Sequence[RecordingBrief]) -> None:
    """Refuse recordings of one mechanism that cannot be merged.

    Raises:
        RecordingError: one differs in filter from the first, or repeats a recording.
    """
    paths, known = dict[str, str](), dict[str, Source]()
    for brief in briefs:
        keys = (brief.sha256, *numbers_in(brief.source.rows))
        alike = [known[key] for key in keys if key in known]
        if source := repeated(alike, brief.sha256, brief.source.rows):
            raise RecordingError(
                f"is of the same recording as {paths[source.sha256]}; a copy adds "
                "nothing, but would narrow every interval",
                where=brief.path,
                cure="give each recording once",
            )
        paths[brief.sha256] = brief.path
        known |= dict.fromkeys(keys, brief.source)
    cutoffs = [brief.source.cutoff_hz for brief in briefs]
    words = ["no cut-off" if value is None else f"{value:.4g} Hz" for value in cutoffs]
    first = cutoffs[0]
    for brief, cutoff, word in zip(briefs, cutoffs, words, strict=True):
        if cutoff != first and not (cutoff and first and abs(cutoff / first - 1.0) <= _SAME):
            raise RecordingError(
                f"was filtered at {word}, {briefs[0].path} at {words[0]}",
                where=brief.path,
                cure="gather both with the same --cutoff",
            )


def _mechanism(robot: RobotDescription) -> dict[str, Any]:
    """Data that gathered columns depend on: lengths, joints, bodies' names, gravity."""
    data = robot.model_dump(mode="json", exclude=_FREE)
    data |= {name: sorted(getattr(robot, name)) for name in ("bodies", "friction", "rotor_inertia")}
    return data


def _differences(
    here: Mapping[str, Any], there: Mapping[str, Any], above: str = ""
) -> Iterator[tuple[str, Any, Any]]:
    for key in sorted({*here, *there}):
        value, other, path = here.get(key), there.get(key), f"{above}{key}"
        if isinstance(value, dict) and isinstance(other, dict):
            yield from _differences(value, other, f"{path}.")
        elif value != other:
            yield path, value, other
