"""One recording in every kind of file, and the addresses of what files hold."""

from pathlib import Path

import numpy as np
import pytest

from kinds_of_files import KINDS, ROWS
from logs import read


@pytest.mark.parametrize("kind", KINDS)
def test_one_recording_in_every_kind_of_file(tmp_path: Path, kind: str) -> None:
    of, path = KINDS[kind], tmp_path / KINDS[kind].name
    of.save(path)
    np.testing.assert_array_equal(read(path, of.columns), ROWS)
