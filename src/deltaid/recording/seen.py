"""A batch of a recording with what can be computed from it apart from the rows before it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from deltaid.mechanism.regularity import Regularity
from deltaid.recording.spectrum import Power
from deltaid.recording.table import Batch


@dataclass(frozen=True, eq=False)
class Seen:
    """A batch, its poses, which of these there are, how regular they are, and its spectra."""

    batch: Batch
    z: Float[np.ndarray, "rows dof"]
    good: Bool[np.ndarray, " rows"]
    regular: Regularity
    power: Power
