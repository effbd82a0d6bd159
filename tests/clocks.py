"""A recording with known places of its rows, and what loggers do to their time."""

from dataclasses import dataclass, replace

import numpy as np
import polars as pl


@dataclass(frozen=True)
class Rows:
    """Rows of an even recording.

    Attributes:
        frame: the even recording, with a column t.
        at: which rows of it are recorded, in order.
        time: their stamps.
    """

    frame: pl.DataFrame
    at: np.ndarray
    time: np.ndarray

    @classmethod
    def whole(cls, frame: pl.DataFrame) -> "Rows":
        """All of a recording."""
        return cls(frame, np.arange(len(frame)), frame["t"].to_numpy().copy())

    @property
    def period(self) -> float:
        """Of the even recording."""
        return float(self.frame["t"][1] - self.frame["t"][0])

    @property
    def log(self) -> pl.DataFrame:
        """What is handed over."""
        return self.frame[self.at].with_columns(t=pl.Series(self.time))

    def without(self, lost: np.ndarray) -> "Rows":
        """Without some places."""
        kept = ~np.isin(self.at, lost)
        return replace(self, at=self.at[kept], time=self.time[kept])

    def losing(self, share: float, rng: np.random.Generator) -> "Rows":
        """Without a share of the rows, none of them at an end."""
        inner = self.at[20:-20]
        return self.without(inner[rng.random(len(inner)) < share])

    def gap(self, start: float, length: float) -> "Rows":
        """Without what lies in a span [s]."""
        place = self.at * self.period
        return self.without(self.at[(place > start) & (place < start + length)])

    def doubling(self, count: int, rng: np.random.Generator) -> "Rows":
        """Some rows twice."""
        twice = np.sort(rng.choice(len(self.at), count, replace=False))
        return replace(
            self, at=np.insert(self.at, twice, self.at[twice]),
            time=np.insert(self.time, twice, self.time[twice]),
        )  # fmt: skip

    def jittering(self, share: float, rng: np.random.Generator) -> "Rows":
        """Stamps off by up to a share of the period."""
        off = share * self.period * rng.uniform(-1, 1, len(self.time))
        return replace(self, time=self.time + off)

    def rounded(self, step: float) -> "Rows":
        """Stamps rounded down."""
        return replace(self, time=np.floor(self.time / step + 1e-9) * step)

    @property
    def holes(self) -> dict[int, int]:
        """Rows before which some are missing, from 0, and how many."""
        steps = np.diff(self.at)
        rows = np.flatnonzero(steps > 1) + 1
        return dict(zip(rows.tolist(), (steps[rows - 1] - 1).tolist(), strict=True))
