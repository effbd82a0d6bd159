"""What a user says of drift on a command line becomes settings, or one message."""

from datetime import datetime

import pytest

from deltaid.cli.drift_options import drift_settings
from deltaid.errors import DeltaidError
from deltaid.fleets.drift_inputs import DriftSettings


@pytest.mark.parametrize(
    ("limit", "number", "kind"),
    [
        (None, None, "share"),
        ("1.5", 1.5, "share"),
        ("12Nm", 12.0, "torque"),
        ("0.8 N·m", 0.8, "torque"),
        (" 40 N ", 40.0, "torque"),
    ],
)
def test_a_limit_is_a_share_a_torque_or_a_force(limit: str, number: float, kind: str) -> None:
    found = drift_settings(limit, 0.2, "2026-05-04")
    assert found == DriftSettings(number, kind, 0.2, datetime(2026, 5, 4))


@pytest.mark.parametrize(
    ("limit", "false_alarms", "since", "where", "words"),
    [
        ("a lot", 0.1, None, "--limit", "12Nm or 40N, not 'a lot'"),
        ("0.9", 0.1, None, "--limit", "above 1, not 0.9"),
        ("0Nm", 0.1, None, "--limit", "above 0, not 0"),
        (None, float("nan"), None, "--false-alarms", "at most 10, not nan"),
        (None, 0.1, "4 May", "--since", "must be a date, not 4 May"),
        (None, 0.1, "2026-05-04T00:00:00+02:00", "--since", "must be a date"),
    ],
)
def test_what_cannot_be_is_refused(
    limit: str, false_alarms: float, since: str, where: str, words: str
) -> None:
    with pytest.raises(DeltaidError, match=words) as told:
        drift_settings(limit, false_alarms, since)
    assert told.value.where == where
