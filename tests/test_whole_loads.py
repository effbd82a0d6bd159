"""Loads that some of several recordings hold from beginning to end, and no mapping declares."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from deltaid.checks.check import check
from deltaid.identification.identify import identify
from deltaid.model.verdict import Grade
from drives import case
from drives.identify import identified
from drives.judge import judge
from drives.rows import Case


def halves(
    seed: int, kind: str, row: str = "load-half-undeclared"
) -> tuple[Case, tuple[pl.DataFrame, ...]]:
    """A case whose load is held from the middle on, and its recording cut there."""
    made = case(row, kind, seed)
    (log,), (happening,) = made.logs, made.happenings
    ((start, _),) = happening.held or ((float(np.mean(log["t"].to_numpy())), 0.0),)
    before, after = log.filter(pl.col("t") < start - 0.05), log.filter(pl.col("t") > start + 0.05)
    return made, (before, after.with_columns(pl.col("t") - after["t"][0]))


@pytest.mark.parametrize("kind", ["delta3", "linear"])
def test_a_load_of_one_whole_recording_is_identified_and_reported(kind: str) -> None:
    made, (empty, loaded) = halves(0, kind)
    for logs in (empty, loaded), (loaded, empty):
        result = identified(replace(made, logs=logs))
        (load,) = result.model.loads
        assert load.parameters[0].value == pytest.approx(made.happenings[0].load.mass, rel=0.03)
        assert judge(made, result).M < 0.005
        for judged in result.verdicts, check(made.robot, list(logs)):
            (verdict,) = [v for v in judged if v.key == "load-change"]
            assert verdict.grade is Grade.DOUBTFUL
            assert verdict.number == pytest.approx(load.parameters[0].value, rel=0.02)
            assert verdict.subject == f"table {2 if logs[1] is loaded else 1}"


def test_recordings_of_the_same_robot_hold_no_load() -> None:
    made, logs = halves(0, "delta3", "clean")
    assert not identified(replace(made, logs=logs)).model.loads


def test_a_common_gain_is_no_load() -> None:
    made, (first, second) = halves(0, "delta3", "clean")
    torques = [name for name in second.columns if name.startswith("tau")]
    second = second.with_columns(pl.col(torques) * 1.05)
    model = identify(made.robot, [first, second]).model
    assert not model.loads
    assert "torque-drift" in {correction.kind for correction in model.corrections}
