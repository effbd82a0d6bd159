"""Stiffnesses that a description states, against the torques and ranges of recordings."""

from unittest.mock import Mock

import numpy as np
import pytest

from deltaid.effects.compliance import _Fit
from deltaid.errors import DeltaidError
from deltaid.robot.load import load_robot


def test_a_drive_that_rests_winds_its_gear_up_by_no_part_of_its_range() -> None:
    known = np.array([1e-3, 2e-1, 0.0])
    fit = Mock(known=known, _softer=np.array([0.0, 1.0, 1.0]))
    fit.rows.dynamics.robot = load_robot("clavel-delta3")
    _Fit.require_linear(fit)
    fit._softer = np.array([0.0, 0.1, 1.0])
    with pytest.raises(DeltaidError, match="gear of drive2 up by 2 of its range"):
        _Fit.require_linear(fit)
