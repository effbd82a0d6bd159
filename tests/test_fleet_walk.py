"""A fleet keeps what was gathered, whatever happens to its plant."""

from pathlib import Path

import pytest

from walked import WalkedFleet


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_nothing_that_happens_to_a_plant_loses_a_row(tmp_path: Path, seed: int) -> None:
    fleet = WalkedFleet.drawn(tmp_path / "plant", robots=2, seed=seed)
    for _ in range(8):
        act, end = fleet.step()
        assert end in ("kept", "refused"), act
