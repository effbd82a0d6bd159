"""Keys of factor files: checksums of their inputs, file names, and whether files may be merged: the
same mechanism, the same filter, each recording once."""

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from deltaid.errors import RecordingError
from deltaid.fleets.factor_file import FactorFile
from deltaid.fleets.factor_record import FORMAT
from deltaid.model.record import Settings
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.description import RobotDescription

# Settings of the fit; all others are fixed when a recording is gathered.
FIT_SETTINGS = {"method", "regularizer", "gamma", "prior_spread", "intervals", "friction"}
# Keys of a description that gathered columns do not depend on: priors, measured values and limits.
_FREE = {
    *("name", "title", "bodies", "friction", "measured", "sensors", "sources", "strut_swing_deg"),
    *("platform_speed", "platform_acceleration", "largest_condition"),
}
# Cut-offs that differ by less than this share are the same.
_SAME = 0.02


def digest(content: Any) -> str:
    """A checksum of what JSON can hold."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def safe(name: str) -> str:
    """A name as a part of a file's name."""
    return re.sub(r"[^\w.+-]+", "-", name)


def ways(robot: RobotDescription, mapping: ColumnMapping | None, settings: Settings) -> str:
    """A checksum of what decides how a recording is gathered: the mechanism, the mapping of
    columns, settings of filter, masks and corrections, and the version of the file."""
    fixed = settings.model_dump(mode="json", exclude=FIT_SETTINGS)
    columns = (mapping or ColumnMapping()).model_dump(mode="json")
    return digest([FORMAT, _mechanism(robot), columns, fixed])


def require_alike(files: Sequence[FactorFile], robot: RobotDescription) -> None:
    """Refuse files that cannot be merged.

    Raises:
        RecordingError: there are none; one is of another mechanism than the robot, of another
            filter than the first, or the same recording as one before; with what differs.
    """
    if not files:
        raise RecordingError("no factor file was given", where="logs", cure="give at least one")
    expected, paths = _mechanism(robot), dict[str, str]()
    for file in files:
        for key, here, there in _differences(_mechanism(file.record.robot), expected):
            raise RecordingError(
                f"was gathered with {key} {here}, and the robot has {there}",
                where=file.path,
                cure="gather its recording again with this description",
            )
        if file.record.sha256 in paths:
            raise RecordingError(
                f"is of the same recording as {paths[file.record.sha256]}; a copy tells nothing "
                "new, but would narrow every interval",
                where=file.path,
                cure="give each recording once",
            )
        paths[file.record.sha256] = file.path
    cutoffs = [file.record.model.sources[0].cutoff_hz for file in files]
    words = ["no cut-off" if value is None else f"{value:.4g} Hz" for value in cutoffs]
    first = cutoffs[0]
    for file, cutoff, word in zip(files, cutoffs, words, strict=True):
        if cutoff != first and not (cutoff and first and abs(cutoff / first - 1.0) <= _SAME):
            raise RecordingError(
                f"was filtered at {word}, {files[0].path} at {words[0]}",
                where=file.path,
                cure="gather both with the same --cutoff",
            )


def _mechanism(robot: RobotDescription) -> dict[str, Any]:
    """What gathered columns depend on: lengths, joints, bodies' names, gravity."""
    data = robot.model_dump(mode="json", exclude=_FREE)
    for limits in data["drive_limits"].values():
        for name in [name for name in limits if not name.startswith("speed")]:
            del limits[name]
    for spring in data["springs"].values():
        spring.pop("stiffness", None)
    data |= {name: sorted(getattr(robot, name)) for name in ("bodies", "friction", "rotor_inertia")}
    return data


def _differences(
    here: Mapping[str, Any], there: Mapping[str, Any], above: str = ""
) -> Iterator[tuple[str, Any, Any]]:
    """Keys that differ, with both values."""
    for key in sorted({*here, *there}):
        own, other, path = here.get(key), there.get(key), f"{above}{key}"
        if isinstance(own, dict) and isinstance(other, dict):
            yield from _differences(own, other, f"{path}.")
        elif own != other:
            yield path, own, other
