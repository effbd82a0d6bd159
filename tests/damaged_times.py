"""What damage does to the time column of a recording, and to the order of its rows."""

from collections.abc import Callable

import numpy as np

Rng = np.random.Generator


def _some(rows: int, rng: Rng) -> np.ndarray:
    """One row, a few, or many."""
    count = rng.choice([1, 1, 2, 5, 20, rows // 100 + 1, rows // 20, rows // 5, rows // 2])
    return rng.choice(rows, min(count, rows), replace=False)


def _block(rows: int, rng: Rng) -> slice:
    size = int(rng.choice([1, 2, 8, 30, 64, 65, 130, 400, rows // 3]))
    start = int(rng.integers(0, max(1, rows - size)))
    return slice(start, min(rows, start + size))


def _number(rng: Rng, size: int) -> np.ndarray:
    """Numbers of any kind that a flipped bit may make."""
    kind = rng.integers(7)
    sign = rng.choice([-1.0, 1.0], size)
    return [
        lambda: sign * 10 ** rng.uniform(-320, 12, size),
        lambda: np.zeros(size),
        lambda: np.full(size, 7.5e-320),
        lambda: sign * rng.uniform(0, 5000, size),
        lambda: sign * 10 ** rng.uniform(-3, 3, size),
        lambda: sign * 10 ** rng.uniform(9, 12, size),
        lambda: np.full(size, sign[0] * 10 ** rng.uniform(-6, 11)),
    ][kind]()


def _wild(time: np.ndarray, at: np.ndarray, rng: Rng) -> None:
    rows = _some(len(time), rng)
    time[rows] = _number(rng, len(rows))


def _bits(time: np.ndarray, at: np.ndarray, rng: Rng) -> None:
    words = time.view(np.uint64)
    for row in _some(len(time), rng)[:50]:
        words[row] ^= np.uint64(1) << np.uint64(rng.integers(64))
    time[~(np.abs(time) < 1e12)] = 0.0


def _near(time: np.ndarray, at: np.ndarray, rng: Rng) -> None:
    """Off by a few periods."""
    rows = _some(len(time), rng)
    time[rows] += rng.normal(size=len(rows)) * 10 ** rng.uniform(-1, 2.5) * (time[-1] / len(time))


def _stretch(time: np.ndarray, at: np.ndarray, rng: Rng) -> None:
    block = _block(len(time), rng)
    time[block] = _number(rng, 1)[0] if rng.random() < 0.5 else time[block.start]


def _shifted(time: np.ndarray, at: np.ndarray, rng: Rng) -> None:
    time[_block(len(time), rng)] += rng.choice([-1, 1]) * 10 ** rng.uniform(-4, 4)


def _zeroed(time: np.ndarray, at: np.ndarray, rng: Rng) -> None:
    """The first number of a block hurt, the others zero."""
    block = _block(len(time), rng)
    time[block] = 0.0
    time[block.start] = 7.5e-320


def _repeated(time: np.ndarray, at: np.ndarray, rng: Rng) -> None:
    rows = _some(len(time) - 1, rng)
    time[rows + 1] = time[rows]


def _backwards(time: np.ndarray, at: np.ndarray, rng: Rng) -> None:
    block = _block(len(time), rng) if rng.random() < 0.8 else slice(None)
    time[block] = time[block][::-1].copy()


def _swapped(time: np.ndarray, at: np.ndarray, rng: Rng) -> None:
    rows = _some(len(time) // 2, rng) * 2
    for both in (time, at):
        both[rows], both[rows + 1] = both[rows + 1], both[rows].copy()


def _moved(time: np.ndarray, at: np.ndarray, rng: Rng) -> None:
    block = _block(len(time), rng)
    to = int(rng.integers(0, len(time)))
    for both in (time, at):
        held = both[block].copy()
        rest = np.delete(both, block)
        place = min(to, len(rest))
        both[:] = np.concatenate([rest[:place], held, rest[place:]])


def _copied(time: np.ndarray, at: np.ndarray, rng: Rng) -> None:
    """A block written over another one."""
    block = _block(len(time), rng)
    to = int(rng.integers(0, len(time)))
    for both in (time, at):
        part = both[block].copy()[: len(both) - to]
        both[to : to + len(part)] = part


def _halted(time: np.ndarray, at: np.ndarray, rng: Rng) -> None:
    """A clock that stands still for a while and then goes on, or jumps."""
    block = _block(len(time), rng)
    lost = time[block.stop - 1] - time[block.start]
    time[block] = time[block.start]
    if rng.random() < 0.5:
        time[block.stop :] -= lost


DAMAGE: dict[str, Callable[[np.ndarray, np.ndarray, Rng], None]] = {
    damage.__name__.strip("_"): damage
    for damage in (
        _wild, _bits, _near, _stretch, _shifted, _zeroed, _repeated,
        _backwards, _swapped, _moved, _copied, _halted,
    )
}  # fmt: skip


def damaged(kinds: list[str], time: np.ndarray, rng: Rng) -> tuple[np.ndarray, np.ndarray]:
    """Stamps [s] and which rows of the whole recording are there, after damage of these kinds."""
    stamps, at = time.copy(), np.arange(len(time))
    for kind in kinds:
        DAMAGE[kind](stamps, at, rng)
    return stamps, at
