"""One recording of a fleet, gathered by whichever process gets it."""

import hashlib
import json
import re
from dataclasses import dataclass
from pathlib import Path

from deltaid.errors import DeltaidError
from deltaid.factors.alike import mechanism
from deltaid.factors.file import ENDING, read_key, write
from deltaid.factors.folder import FIT_SETTINGS
from deltaid.factors.gather import gathered
from deltaid.factors.record import FORMAT
from deltaid.fleet.manifest import Recorded
from deltaid.fleet.store import Store
from deltaid.model.record import Settings
from deltaid.parallel import threads
from deltaid.recording.carried import Load
from deltaid.recording.mapping import ColumnMapping, load_mapping
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import described

FACTORS = "factors"
_UNSAFE = re.compile(r"[^\w.+-]+")


@dataclass(frozen=True)
class Outcome:
    """What became of one recording.

    Attributes:
        recorded: which.
        file: its factor file, seen from the fleet's folder; empty if it was refused.
        reason: why it is in quarantine; empty if it is not.
        is_new: whether it was gathered now.
    """

    recorded: Recorded
    file: str = ""
    reason: str = ""
    is_new: bool = False


def gather_recorded(
    one: Recorded, folder: Path, settings: Settings, store: Store, *, force: bool = False
) -> Outcome:
    """Gather a recording into a fleet's folder, unless it is there.

    What is there is known by the recording's size and time of change, so nothing is read for it. A
    recording that cannot be used is an outcome with its reason, and no error.
    """
    try:
        robot, mapping = described(one.type), _mapping(one)
        key = _key(one, robot, mapping, settings, store)
        name = _UNSAFE.sub("-", one.path.rpartition("/")[2].rpartition(".")[0])
        own = f"{FACTORS}/{_UNSAFE.sub('-', one.robot)}/{name}-{key[:10]}{ENDING}"
        if read_key(folder / own) == key:
            return Outcome(one, own)
        with store.local(one.path) as path, threads(1):
            found = gathered(robot, path, columns=mapping, settings=settings, force=force)
        write(found, folder / own, key)
    except DeltaidError as error:
        return Outcome(one, reason=str(error))
    return Outcome(one, own, is_new=True)


def _mapping(one: Recorded) -> ColumnMapping | None:
    """The recording's mapping, with the load that the manifest says it held."""
    mapping = load_mapping(Path(one.columns)) if one.columns else None
    if not one.load:
        return mapping
    if mapping is not None and mapping.load is not None:
        raise DeltaidError(
            "its mapping and the manifest both say what it holds",
            where=one.path,
            cure="say it in one of them",
        )
    return (mapping or ColumnMapping()).changed(load=Load(always=True, mass=one.load))


def _key(
    one: Recorded,
    robot: RobotDescription,
    mapping: ColumnMapping | None,
    settings: Settings,
    store: Store,
) -> str:
    """What a factor file follows from, as a checksum."""
    decided = settings.model_dump(mode="json", exclude=FIT_SETTINGS)
    known = [
        FORMAT, one.path, store.stamp(one.path), mechanism(robot),
        mapping and mapping.model_dump(mode="json"), decided,
    ]  # fmt: skip
    text = json.dumps(known, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
