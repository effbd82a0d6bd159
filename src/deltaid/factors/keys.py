"""What factor files are known by: checksums of all that they follow from, and names for files."""

import hashlib
import json
import re
from typing import Any

from deltaid.factors.alike import mechanism
from deltaid.factors.record import FORMAT
from deltaid.model.record import Settings
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.description import RobotDescription

# What a fit can still choose; all else is decided as a recording is gathered.
FIT_SETTINGS = {"method", "regularizer", "gamma", "prior_spread", "intervals", "friction"}
_UNSAFE = re.compile(r"[^\w.+-]+")


def digest(known: Any) -> str:
    """A checksum of what JSON can hold."""
    text = json.dumps(known, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def ways(robot: RobotDescription, mapping: ColumnMapping | None, settings: Settings) -> str:
    """A checksum of what decides how a recording is gathered: the mechanism, the mapping of
    columns, settings of filter, masks and corrections, and the version of the file."""
    decided = settings.model_dump(mode="json", exclude=FIT_SETTINGS)
    columns = (mapping or ColumnMapping()).model_dump(mode="json")
    return digest([FORMAT, mechanism(robot), columns, decided])


def safe(name: str) -> str:
    """A name as a part of a file's name."""
    return _UNSAFE.sub("-", name)
