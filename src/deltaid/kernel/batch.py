"""Batch kernel: one SX graph, compiled in the process and evaluated for any number of samples.

Arrays hold samples in columns, shape (entries, samples), so a column-major factorisation reads
their transpose without a copy.

A recurrence is a graph from state and inputs to next state and outputs, run sample after sample.
All its rows lie in one array, and outputs are one column to the right of inputs, so each sample
reads the state that the previous one wrote.
"""

import functools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from operator import attrgetter
from typing import Any

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.kernel.machine_code import CompiledKernel, merged, target
from deltaid.parallel import cores

# Samples per block: few enough for the cache, and not a power of two, because rows a power of two
# apart compete for the same cache lines.
BLOCK = 2000
# Fewest blocks per thread by default: a thread for fewer does not pay.
_SHARE = 8


class BatchKernel:
    """CasADi function of a batched and a uniform input, evaluated over samples in columns.

    Args:
        batched: SX inputs that differ from sample to sample, stacked.
        output: SX expression; its dense column-major entries become the output's rows.
        uniform: SX inputs that all samples share (parameters), stacked.

    Results do not depend on the batch size or the number of threads: equal inputs give equal bits.
    They agree with CasADi's evaluator (`function`) to rounding.
    """

    def __init__(self, batched: ca.SX, output: ca.SX, uniform: ca.SX | None = None) -> None:
        shared = ca.SX(0, 1) if uniform is None else uniform
        dense = ca.vec(ca.densify(output))
        self._graph = ca.Function("f", [batched, shared], [dense])
        self.n_in, self.n_out, self.n_uniform = batched.numel(), dense.numel(), shared.numel()
        self._width = target().width
        self._kernel = CompiledKernel(self._graph, self._width)

    @functools.cached_property
    def function(self) -> ca.Function:
        """CasADi's evaluator of the same graph, with common subexpressions merged."""
        return merged(self._graph)

    def __call__(
        self,
        x: Float[np.ndarray, "n_in samples"],
        uniform: Float[np.ndarray, " n_uniform"] | None = None,
        threads: int | None = None,
    ) -> Float[np.ndarray, "n_out samples"]:
        """Evaluate all samples, on `threads` threads at most, by default on all free cores.

        Raises:
            ValueError: the number of inputs is not that of the kernel.
        """
        x, given = np.asarray(x, dtype=float), np.zeros(0) if uniform is None else uniform
        shared = np.ascontiguousarray(given, dtype=float)
        if (len(x), shared.shape) != (self.n_in, (self.n_uniform,)):
            raise ValueError(
                f"the kernel has {self.n_in} inputs, not {len(x)}, and {self.n_uniform} uniform "
                f"inputs, not {shared.size}"
            )
        out = np.empty((self.n_out, x.shape[1]))
        starts = range(0, x.shape[1], BLOCK)
        workers = min(threads or cores(), len(starts) if threads else len(starts) // _SHARE)
        if workers <= 1:
            self._blocks(x, shared, out, starts)
        else:
            with ThreadPoolExecutor(workers) as pool:
                shares = [starts[i::workers] for i in range(workers)]
                list(pool.map(functools.partial(self._blocks, x, shared, out), shares))
        return out

    def _blocks(
        self,
        x: Float[np.ndarray, "n_in samples"],
        uniform: Float[np.ndarray, " n_uniform"],
        out: Float[np.ndarray, "n_out samples"],
        starts: range,
    ) -> None:
        """Evaluate the blocks that begin at `starts`, through buffers that stay in the cache.

        The last block is padded with its last sample to a multiple of the vector width.
        """
        length = min(BLOCK, x.shape[1])
        length += -length % self._width
        inputs, outputs = np.empty((self.n_in, length)), np.empty((self.n_out, length))
        for start in starts:
            stop = min(start + BLOCK, x.shape[1])
            n = stop - start
            padded = n + (-n % self._width)
            inputs[:, :n] = x[:, start:stop]
            inputs[:, n:padded] = x[:, stop - 1 : stop]
            self._kernel.call(
                outputs.ctypes.data,
                length,
                inputs.ctypes.data,
                length,
                uniform.ctypes.data,
                padded,
            )
            out[:, start:stop] = outputs[:, :n]


class RowKernel(BatchKernel):
    """Batch kernel with several vectors of inputs, several outputs, and one sample per row.

    Args:
        inputs: vectors that differ from sample to sample.
        outputs: vectors, and matrices as lists of their columns (`ca.horzsplit`).
        uniform: as in `BatchKernel`.
    """

    def __init__(
        self,
        inputs: Sequence[ca.SX],
        outputs: Sequence[ca.SX | list[ca.SX]],
        uniform: ca.SX | None = None,
    ) -> None:
        parts = [x if isinstance(x, ca.SX) else ca.vertcat(*x) for x in outputs]
        self._shapes = [() if isinstance(x, ca.SX) else (len(x), x[0].numel()) for x in outputs]
        self._ends = np.cumsum([part.numel() for part in parts])[:-1]
        super().__init__(ca.vertcat(*inputs), ca.vertcat(*parts), uniform)

    def rows(
        self, *inputs: np.ndarray, uniform: Float[np.ndarray, " n_uniform"] | None = None
    ) -> tuple[np.ndarray, ...]:
        """Each output: a vector as (samples, entries), a matrix as (samples, rows, columns)."""
        out = self(np.hstack(inputs).T, uniform=uniform).T
        parts = zip(np.split(out, self._ends, axis=1), self._shapes, strict=True)
        return tuple(x.reshape(-1, *shape).swapaxes(1, 2) if shape else x for x, shape in parts)


def row_kernel(
    part: str, graph: Callable[[Any], tuple[Any, ...]]
) -> functools.cached_property[RowKernel]:
    """Cached property of a class: a kernel that is compiled on first use.

    Args:
        part: attribute of the class that holds the symbols.
        graph: returns the arguments of `RowKernel` for these symbols.
    """
    symbols = attrgetter(part)
    return functools.cached_property(lambda owner: RowKernel(*graph(symbols(owner))))


class Recurrence:
    """Recurrence x_{k+1}, y_k = f(x_k, u_k), evaluated sample after sample.

    Args:
        state: symbols x.
        inputs: symbols u.
        following: x_{k+1} as a dense column of x and u.
        outputs: y_k as a dense column of x and u.
    """

    def __init__(self, state: ca.SX, inputs: ca.SX, following: ca.SX, outputs: ca.SX) -> None:
        self.n_state, self.n_in, self.n_out = (v.numel() for v in (state, inputs, outputs))
        results = ca.densify(ca.vertcat(following, outputs))
        graph = ca.Function("f", [ca.vertcat(inputs, state), ca.SX(0, 1)], [results])
        self._kernel = CompiledKernel(graph, 1, apart=False)
        self._none = np.zeros(1)

    def __call__(
        self, state: Float[np.ndarray, " n_state"], inputs: Float[np.ndarray, "samples n_in"]
    ) -> tuple[Float[np.ndarray, " n_state"], Float[np.ndarray, "samples n_out"]]:
        """The state after the last sample, and all outputs."""
        outputs = np.empty((len(inputs), self.n_out))
        rows, behind = self.n_in + self.n_state + self.n_out, self.n_in + self.n_state
        block = np.zeros((rows, min(BLOCK, len(inputs)) + 1))
        columns = block.shape[1]
        state = np.array(state, dtype=float)
        first_out = block.ctypes.data + 8 * (self.n_in * columns + 1)
        for start in range(0, len(inputs), BLOCK):
            part = inputs[start : start + BLOCK]
            n = len(part)
            block[: self.n_in, :n] = part.T
            block[self.n_in : behind, 0] = state
            self._kernel.call(
                first_out, columns, block.ctypes.data, columns, self._none.ctypes.data, n
            )
            state = block[self.n_in : behind, n].copy()
            outputs[start : start + n] = block[behind:, 1 : n + 1].T
        return state, outputs
