"""Traces of other controllers are CSV with a preamble: at most ten lines of mapping read them."""

from pathlib import Path

import numpy as np
import pytest

from deltaid.dynamics.dynamics import Dynamics
from deltaid.recording.mapping import load_mapping
from deltaid.recording.opening import open_log

T = np.arange(800) / 1000
Q = 0.3 + 0.2 * np.sin(9 * T[:, None] + np.arange(3))
TAU = 2 * np.cos(11 * T[:, None] + np.arange(3))


def lines(columns: list[np.ndarray], separator: str, comma: bool = False) -> str:
    rows = (separator.join(f"{x:.12g}" for x in row) for row in np.column_stack(columns))
    text = "\n".join(rows) + "\n"
    return text.replace(".", ",") if comma else text


CODESYS = (
    "CoDeSys Trace\nD:\\PROJECTS\\DELTA.PRO\n"
    "Cycle PLC_PRG.Axis[1].fPos PLC_PRG.Axis[2].fPos PLC_PRG.Axis[3].fPos "
    "PLC_PRG.Axis[1].nTorque PLC_PRG.Axis[2].nTorque PLC_PRG.Axis[3].nTorque\n"
    + lines([1000 * T, np.rad2deg(Q), TAU / 0.0235], " ")
)
SINAMICS = (
    "Trace;Device_1;2024-05-02 13:56:24\nCycle;1,000;ms\n\n"
    "Time;A1.r482[0];A2.r482[0];A3.r482[0];A1.r80[1];A2.r80[1];A3.r80[1]\n"
    "ms;LU;LU;LU;Nm;Nm;Nm\n"
    + lines([1000 * T, Q * 360000 / (2 * np.pi) * 20 + 1000, TAU / 20], ";", comma=True)
)
B_AND_R = (
    '"Trace configuration","Delta"\n"Time [s]","gAxis01.ActPosition","gAxis02.ActPosition",'
    '"gAxis03.ActPosition","gAxis01.ActCurrent","gAxis02.ActCurrent","gAxis03.ActCurrent"\n'
    + lines([T, -np.rad2deg(Q), TAU / 1.7], ",")
)
TRACES = {
    "CODESYS": (
        CODESYS,
        """
time: {column: Cycle, unit: ms}
position:
  columns: ["PLC_PRG.Axis[1].fPos", "PLC_PRG.Axis[2].fPos", "PLC_PRG.Axis[3].fPos"]
  unit: deg
torque:
  columns: ["PLC_PRG.Axis[1].nTorque", "PLC_PRG.Axis[2].nTorque", "PLC_PRG.Axis[3].nTorque"]
  unit: 0.0235 N*m
""",
    ),
    "SINAMICS": (
        SINAMICS,
        """
header_row: 4
data_row: 6
time: {column: Time, unit: ms}
position:
  columns: ["A1.r482[0]", "A2.r482[0]", "A3.r482[0]"]
  unit: 1/360000 rev
  zero: 1000
  gear: 20
torque: {columns: ["A1.r80[1]", "A2.r80[1]", "A3.r80[1]"], unit: N*m, gear: 20}
""",
    ),
    "B&R": (
        B_AND_R,
        """
time: {column: "Time [s]"}
position:
  columns: [gAxis01.ActPosition, gAxis02.ActPosition, gAxis03.ActPosition]
  unit: deg
  sign: -1
torque:
  columns: [gAxis01.ActCurrent, gAxis02.ActCurrent, gAxis03.ActCurrent]
  unit: A
  torque_constant: 1.7
""",
    ),
}


@pytest.mark.parametrize(("text", "mapping"), TRACES.values(), ids=TRACES)
def test_a_trace_is_read(text: str, mapping: str, clavel: Dynamics, tmp_path: Path) -> None:
    assert len(mapping.strip().split("\n")) <= 10
    (tmp_path / "columns.yaml").write_text(mapping, encoding="utf-8")
    path = tmp_path / "trace.csv"
    path.write_text(text, encoding="utf-8")
    log = open_log(path, clavel.kinematics, load_mapping(tmp_path / "columns.yaml"))
    values = next(log.batches())[:, :7]
    assert values == pytest.approx(np.column_stack([T, Q, TAU]), abs=1e-9)
