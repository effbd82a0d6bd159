"""Exports of TwinCAT Scope for tests, laid out as its versions and options do."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

_ROWS = {
    "SymbolComment": "", "Data-Type": "REAL64", "VariableSize": "8", "SymbolBased": "True",
    "IndexGroup": "16448", "SymbolName": "", "NetID": "192.168.178.20.1.1", "Port": "851",
    "Offset": "0", "ScaleFactor": "1", "BitMask": "0xffffffffffffffff", "Unit": "(None)",
    "Unit ScaleFactor": "1", "Unit Offset": "0",
}  # fmt: skip


@dataclass
class Curve:
    """A channel: times in ms and values, and what the header says of it."""

    name: str
    time: np.ndarray
    values: np.ndarray
    rows: dict[str, str] = field(default_factory=dict[str, str])

    def row(self, word: str) -> str:
        symbol = {"SymbolName": f"MAIN.{self.name}", "Name": self.name}
        step = {"SampleTime[ms]": f"{self.time[1] - self.time[0]:g}".replace(".", ",")}
        return self.rows.get(word, (_ROWS | symbol | step)[word])


def scope(
    curves: Sequence[Curve],
    separator: str = "\t",
    decimal: str = ",",
    *,
    shared: bool = False,
    words: Sequence[str] = ("Name", *_ROWS, "SampleTime[ms]"),
    preamble: bool = True,
    end: str = "EOF\n",
    started: int = 0,
    align: str = "",
) -> str:
    """The text of an export.

    Args:
        shared: whether neighbours of one period have one column of times (For each sampletime).
        words: rows about the channels.
        started: FILETIME of the start, for full time stamps.
        align: "shift" if samples of one instant stand in one line (Shift value), "fill" if slow
            channels also repeat their last sample (Fill with previous value).
    """
    groups: list[list[Curve]] = []
    for curve in curves:
        alike = shared and groups and np.array_equal(groups[-1][0].time, curve.time)
        groups[-1].append(curve) if alike else groups.append([curve])

    def number(value: float) -> str:
        text = repr(float(value)).removesuffix(".0")
        return text.replace(".", decimal)

    def instant(value: float) -> str:
        return str(started + round(value * 10_000)) if started else number(value)

    lines: list[str] = []
    if preamble:
        lines += [f"Name{separator}Project", f"File{separator}C:\\scope\\log.csv"]
        lines += [f"Starttime of export{separator}132959733843760000{separator}Montag, 2. Mai 2022"]
        lines += [f"Endtime of export{separator}132959733853750000", "", ""]
    for word in words:
        cells = [
            cell for group in groups for cell in (word, *(channel.row(word) for channel in group))
        ]
        lines.append(separator.join(cells))
    lines.append("")
    every = max(curves, key=lambda curve: len(curve.time)).time
    for k in range(len(every)):
        cells: list[str] = []
        for group in groups:
            time = group[0].time
            i = int(np.searchsorted(time, every[k], side="right")) - 1 if align else k
            if i < len(time) and (align != "shift" or time[i] == every[k]):
                cells += [instant(time[i]), *(number(channel.values[i]) for channel in group)]
            else:
                cells += [" "] * (1 + len(group))
        while cells[-1] == " ":
            cells.pop()
        lines.append(separator.join(cells))
    return "\n".join(lines) + "\n" + end
