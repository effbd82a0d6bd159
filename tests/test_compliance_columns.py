"""Columns of compliances in the contest of causes, and where its sweeps end with them."""

from dataclasses import replace

import numpy as np
import pytest

from deltaid.effects.point import TracePoint
from deltaid.effects.windings import BAND, Windings, WindUp, motors_of
from deltaid.estimation.traces import trace
from deltaid.identification.study import studied_trace
from deltaid.recording.recording import open_recordings
from drives import case
from drives.identify import identified as of_case
from drives.judge import judge
from identified import identified
from test_compliance import gears, wound


def test_noise_of_torques_is_not_in_the_columns_of_compliances() -> None:
    """Links behind gears move by measured torques, and columns have two more derivatives of τ_g."""

    def columns(noise: float) -> np.ndarray:
        dynamics, p, table = wound(1.0, noise)
        log = table.drop("link1", "link2", "link3")
        (recording,) = open_recordings(log, dynamics.kinematics)
        behind = recording.repaired(gears=gears(p, dynamics))
        return WindUp().columns(TracePoint(trace(dynamics, behind, p, cutoff=20.0), p))

    clean, noisy = columns(0.0), columns(0.02)
    assert np.linalg.norm(noisy - clean) < 0.1 * np.linalg.norm(clean)  # 1.3 in the band of a fit


def test_motors_do_not_move_with_their_links_in_the_columns_of_compliances() -> None:
    """By differences of torques along the links' motion, beside heavy and viscous motors."""
    result = identified("irb360-6-1600").result
    dynamics, p = result.problem.dynamics, result.model.p.copy()
    of_motors = [name.startswith(("rotor", "viscous.drive")) for name in dynamics.layout.names]
    p[of_motors] *= 30.0
    record = studied_trace(dynamics, result.recordings[0], p)
    assert record is not None
    low_pass = record.low_pass
    motors = replace(
        motors_of(dynamics.robot, p, low_pass.cutoff, low_pass.rate), cutoff=BAND * low_pass.cutoff
    )
    windings = Windings.modelled(record, motors, p)
    expected = windings.slopes(np.zeros(4), 1e-7 * np.eye(4), p)
    whole, inner = record.motion().time, windings.trace.motion().time
    columns = WindUp().columns(TracePoint(record, p))[:, np.searchsorted(whole, inner - 0.001)]
    errors, sizes = (np.linalg.norm(each, axis=(0, 1)) for each in (columns - expected, expected))
    assert np.all(errors < 0.2 * sizes)  # differences have the steps of passive friction


@pytest.mark.slow
def test_sweeps_stay_at_the_truth_behind_soft_gears_of_a_par4() -> None:
    """With noise of torques in the columns of compliances, they ended 53 % off."""
    made = case("gear-5000", "par4", 2)
    judged = judge(made, of_case(made))
    assert dict(judged.said)["compliance"] == 4
    assert judged.M < 0.02
