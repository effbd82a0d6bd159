"""Named fields side by side in one vector: what a cycle reads, keeps and gives.

One layout is one struct in C and in structured text, one array in Python.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Field:
    """Some numbers that belong together.

    Attributes:
        name: an identifier of C and of structured text.
        size: how many numbers.
        doc: what they are, for a comment.
        unit: of all of them; empty where they differ or have none.
        initial: what a state begins with, one number for all, or one each.
    """

    name: str
    size: int
    doc: str
    unit: str = ""
    initial: float | tuple[float, ...] = 0.0

    @property
    def start(self) -> Float[np.ndarray, " size"]:
        """`initial` as an array."""
        return np.array(np.broadcast_to(np.asarray(self.initial, dtype=float), (self.size,)))


@dataclass(frozen=True)
class Layout:
    """Fields of one vector, in its order.

    Attributes:
        fields: their names differ; what is of size 0 stands for nothing and is left out.
    """

    fields: tuple[Field, ...]

    @classmethod
    def from_fields(cls, *fields: Field) -> "Layout":
        """A layout of the fields that have any number.

        Raises:
            ValueError: two have the same name.
        """
        kept = tuple(field for field in fields if field.size)
        names = [field.name for field in kept]
        if len(set(names)) < len(names):
            raise ValueError(f"two fields of one name in {names}")
        return cls(kept)

    @cached_property
    def places(self) -> dict[str, slice]:
        """Where each field stands."""
        ends = np.cumsum([field.size for field in self.fields]).tolist()
        return {f.name: slice(end - f.size, end) for f, end in zip(self.fields, ends, strict=True)}

    @property
    def size(self) -> int:
        """How many numbers the vector has."""
        return sum(field.size for field in self.fields)

    @property
    def initial(self) -> Float[np.ndarray, " size"]:
        """What a state begins with."""
        return np.concatenate([np.zeros(0), *(field.start for field in self.fields)])

    def symbols(self, name: str) -> dict[str, ca.SX]:
        """New symbols for each field, named name_field."""
        return {f.name: ca.SX.sym(f"{name}_{f.name}", f.size) for f in self.fields}

    def vector(self, values: Mapping[str, ca.SX]) -> ca.SX:
        """Expressions of all fields in one column.

        Raises:
            ValueError: an expression has another size than its field.
        """
        parts = [ca.SX(0, 1)]
        for field in self.fields:
            part = ca.vec(ca.densify(values[field.name]))
            if part.numel() != field.size:
                raise ValueError(f"{field.name} has {field.size} numbers, not {part.numel()}")
            parts.append(part)
        return ca.vertcat(*parts)

    def split(
        self, vector: Float[np.ndarray, "*samples size"]
    ) -> dict[str, Float[np.ndarray, "..."]]:
        """A vector, or many, by fields."""
        return {name: vector[..., place] for name, place in self.places.items()}

    def __add__(self, other: "Layout") -> "Layout":
        return Layout.from_fields(*self.fields, *other.fields)
