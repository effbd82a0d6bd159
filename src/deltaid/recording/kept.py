"""The rows of a log that is not too long, kept in memory: reading text takes more than all else."""

from collections.abc import Iterable, Iterator

import numpy as np

from deltaid.recording.columns import Columns
from deltaid.recording.table import Batch

# Numbers that are kept at most: 128 MiB, or two million rows of four drives' positions and torques.
_MOST = 1 << 24


class Kept:
    """Takes down batches as they are read for the first time.

    Args:
        columns: of the batches.
    """

    def __init__(self, columns: Columns) -> None:
        self._columns, self._left = columns, _MOST
        self._batches: list[Batch] = []

    def taking(self, batches: Iterable[Batch]) -> Iterator[Batch]:
        """The batches, each taken down before it is handed on."""
        for batch in batches:
            self._left -= batch.values.size
            if self._left < 0:
                self._batches.clear()
            else:
                values = batch.values.copy()
                values.flags.writeable = False
                self._batches.append(Batch(batch.row, values))
            yield batch

    @property
    def whole(self) -> bool:
        """Whether they were few enough."""
        return self._left >= 0

    def read(self, columns: Columns) -> Iterator[Batch]:
        """All batches with some of their columns."""
        places = places_among(self._columns, columns)
        for batch in self._batches:
            yield batch if places is None else Batch(batch.row, batch.values[:, places])


def places_among(columns: Columns, some: Columns) -> np.ndarray | None:
    """Where channels of some columns stand among others; None if they are all of them."""
    places = [columns.all.index(one) for one in some.all]
    return None if len(places) == len(columns.all) else np.array(places)
