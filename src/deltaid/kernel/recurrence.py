"""A graph from state and inputs to next state and outputs, run sample after sample, compiled.

The kernel's loop over samples reads its state where the sample before wrote it: all rows lie in one
array, and outputs are one column further on than inputs.
"""

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.kernel.batch import CompiledKernel

# Samples a block, so that rows stay near each other; no power of two (see kernel.batch).
_BLOCK = 250


class Recurrence:
    """x_{k+1}, y_k = f(x_k, u_k) for one sample after the other.

    Args:
        state: symbols x.
        inputs: symbols u.
        following: x_{k+1} of both, a dense column.
        outputs: y_k of both, a dense column.
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
        """The state behind the last sample, and all outputs."""
        outputs = np.empty((len(inputs), self.n_out))
        rows, behind = self.n_in + self.n_state + self.n_out, self.n_in + self.n_state
        block = np.zeros((rows, min(_BLOCK, len(inputs)) + 1))
        columns = block.shape[1]
        state = np.array(state, dtype=float)
        first_out = block.ctypes.data + 8 * (self.n_in * columns + 1)
        for start in range(0, len(inputs), _BLOCK):
            part = inputs[start : start + _BLOCK]
            n = len(part)
            block[: self.n_in, :n] = part.T
            block[self.n_in : behind, 0] = state
            self._kernel.call(
                first_out, columns, block.ctypes.data, columns, self._none.ctypes.data, n
            )
            state = block[self.n_in : behind, n].copy()
            outputs[start : start + n] = block[behind:, 1 : n + 1].T
        return state, outputs
