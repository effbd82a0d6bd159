"""Whether factor files may be merged: the same mechanism, the same filter, each recording once."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from deltaid.errors import RecordingError
from deltaid.factors.file import FactorFile
from deltaid.robot.description import RobotDescription

# Keys of a description that gathered columns do not depend on: what a fit starts from, what is
# known beside recordings, and what describes limits.
_FREE = {"name", "title", "bodies", "friction", "measured", "sensors", "sources",
         "platform_speed", "platform_acceleration", "strut_swing_deg",
         "largest_condition"}  # fmt: skip
# Cut-offs that differ by less than this share are the same.
_SAME = 0.02


def require_alike(files: Sequence[FactorFile], robot: RobotDescription) -> None:
    """Refuse files that cannot be merged.

    Raises:
        RecordingError: there are none; one is of another mechanism than the robot, of another
            filter than the first, or the same recording as one before; with what differs.
    """
    if not files:
        raise RecordingError("no factor file was given", where="logs", cure="give at least one")
    expected, seen = mechanism(robot), dict[str, str]()
    for one in files:
        for key, here, there in _differences(mechanism(one.record.robot), expected):
            raise RecordingError(
                f"was gathered with {key} {here}, and the robot has {there}",
                where=one.path,
                cure="gather its recording again with this description",
            )
        if one.record.sha256 in seen:
            raise RecordingError(
                f"is of the same recording as {seen[one.record.sha256]}; a copy tells nothing new, "
                "but would narrow every interval",
                where=one.path,
                cure="give each recording once",
            )
        seen[one.record.sha256] = one.path
    _require_same_filter(files)


def _require_same_filter(files: Sequence[FactorFile]) -> None:
    first = files[0]
    wanted = first.record.model.sources[0].cutoff_hz
    for one in files[1:]:
        own = one.record.model.sources[0].cutoff_hz
        if own != wanted and not (own and wanted and abs(own / wanted - 1.0) <= _SAME):
            raise RecordingError(
                f"was filtered at {_hz(own)}, {first.path} at {_hz(wanted)}",
                where=one.path,
                cure="gather both with the same --cutoff",
            )


def _hz(value: float | None) -> str:
    return "no cut-off" if value is None else f"{value:.4g} Hz"


def mechanism(robot: RobotDescription) -> dict[str, Any]:
    """What gathered columns depend on: lengths, joints, bodies' names, gravity."""
    data = robot.model_dump(mode="json", exclude=_FREE)
    data["drive_limits"] = {k: {n: x for n, x in v.items() if n.startswith("speed")}
                            for k, v in data.pop("drive_limits").items()}  # fmt: skip
    data |= {"bodies": sorted(robot.bodies), "friction": sorted(robot.friction)}
    data["rotor_inertia"] = sorted(robot.rotor_inertia)
    data["springs"] = {k: {n: x for n, x in v.items() if n != "stiffness"}
                       for k, v in data["springs"].items()}  # fmt: skip
    return data


def _differences(
    here: Mapping[str, Any], there: Mapping[str, Any], above: str = ""
) -> Iterator[tuple[str, Any, Any]]:
    """Keys that differ, with both values."""
    for key in sorted({*here, *there}):
        one, other = here.get(key), there.get(key)
        path = f"{above}.{key}" if above else key
        if isinstance(one, dict) and isinstance(other, dict):
            yield from _differences(one, other, path)
        elif one != other:
            yield path, one, other
