"""What users give as arrays, taken as real numbers or refused."""

from typing import Any

import numpy as np

from deltaid.errors import DeltaidError


def real_numbers(
    value: Any, where: str, *, cure: str = "", error: type[DeltaidError] = DeltaidError
) -> np.ndarray:
    """Something array-like as integers or floating-point numbers.

    NumPy itself would take the number below a mask, the real part, true as 1 and '1' as 1.

    Raises:
        DeltaidError: of the given kind; masked, complex or other values, or rows of unequal length.
    """
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        raise error(
            "has masked values", where=where, cure="cut them off; deltaid does not fill gaps"
        )
    cure = cure or "give an array of real numbers"
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        raise error("rows differ in length", where=where, cure=cure) from None
    if array.dtype.kind not in "iuf":
        raise error(f"holds {array.dtype}, not numbers", where=where, cure=cure)
    return array
