"""Blocks: merged recordings of one robot, for fits and for drift.

Triangles over independent columns of the fit add up, for all samples, for places, and for the
effects of tolerances. Each recording keeps its brief and its sums of friction. Intervals come from
the scatter between groups: recordings, or several consecutive ones beyond `MOST_GROUPS`.
"""

import json
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, fields
from io import BytesIO
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from pydantic import TypeAdapter

from deltaid.checksum import is_intact, sealed_archive
from deltaid.estimation.information import Information
from deltaid.fleets.drift_friction import FrictionSums, friction_sums
from deltaid.fleets.factor_record import FactorGroups, RecordingBrief, entries_of, triangles_of
from deltaid.fleets.merged import Independent, MergedPart, Merging, stacked
from deltaid.grouping import grouped
from deltaid.identification.geometric_rows import GeometricRows

# Number of groups from which consecutive ones are merged: Student's t is then within 2 % of a
# normal distribution. Uneven halves leave up to twice as many for evenly spaced recordings.
MOST_GROUPS = 128
_WHOLE = "whole"


@dataclass(frozen=True, eq=False)
class RecordingBlock:
    """Merged recordings of a robot.

    Attributes:
        fingerprint: of its `Merging`.
        keys: of its recordings, ascending; they determine the order of merging.
        briefs, friction: of each recording.
        counts: number of recordings in each group.
        whole, groups, places: triangles of [Y, τ] over each drive's independent columns;
            groups and places, which only determine uncertainty, keep seven digits.
        geometry: triangles of [Y, D, τ], one group; none without tolerances.
        quantities: names of the columns D.
    """

    fingerprint: str
    keys: tuple[int, ...]
    briefs: tuple[RecordingBrief, ...]
    friction: FrictionSums
    counts: tuple[int, ...]
    whole: FactorGroups
    groups: FactorGroups
    places: FactorGroups
    geometry: FactorGroups | None
    quantities: tuple[str, ...]

    @classmethod
    def of_part(cls, merging: Merging, part: MergedPart, key: int) -> "RecordingBlock":
        """The block of a single recording, from its part of the fit."""
        independent = [[*drive.at, -1] for drive in merging.drives]

        def groups(names: Sequence[str], rows: np.ndarray, *sizes: np.ndarray) -> FactorGroups:
            each = [rows[:, i][:, :, columns] for i, columns in enumerate(independent)]
            return FactorGroups.of_rows(names, each, *sizes)

        information, places = part.information, part.file.groups.named("place")
        parts = (information.factors, information.samples, information.torque_max)
        whole = groups([_WHOLE], *(array[None] for array in parts))
        by_place = groups(places.names, part.rows(places), places.samples, places.torque_max)
        shifted, geometry = merging.geometry(part.file), None
        if shifted:
            active, none = len(merging.active), np.zeros((1, len(shifted)))
            each = (
                R[None][:, :, [*drive.at, *range(active, R.shape[1])]]
                for R, drive in zip(shifted, merging.drives, strict=True)
            )
            geometry = FactorGroups.of_rows([_WHOLE], list(each), none, none).rounded
        return cls(
            merging.fingerprint, (key,), (part.file.brief,), friction_sums(merging, part), (1,),
            whole, whole.rounded, by_place.rounded, geometry, part.file.record.quantities,
        )  # fmt: skip

    def joined(self, other: "RecordingBlock") -> "RecordingBlock":
        """Merge two blocks; all keys of the other are greater."""
        keys = self.keys + other.keys
        counts, groups = self.counts + other.counts, self.groups.joined(other.groups)
        coarse = _cuts(keys, 1 << ((len(keys) - 1) // MOST_GROUPS).bit_length())
        if len(coarse) < len(counts):
            ends = np.searchsorted(np.cumsum(counts), np.cumsum(coarse)) + 1
            members = enumerate(np.split(np.arange(len(counts)), ends[:-1]))
            groups = groups.summed({str(k): part.tolist() for k, part in members}).rounded
        places = self.places.joined(other.places)
        by_name = grouped(sorted((name, k) for k, name in enumerate(places.names)))
        quantities = tuple(dict.fromkeys(self.quantities + other.quantities))
        shifted = [block.over(quantities) for block in (self, other) if block.geometry]
        geometry = shifted[0] if shifted else None
        if len(shifted) > 1:
            geometry = shifted[0].joined(shifted[1]).summed({_WHOLE: [0, 1]}).rounded
        return RecordingBlock(
            self.fingerprint,
            keys,
            self.briefs + other.briefs,
            self.friction.joined(other.friction),
            tuple(coarse),
            self.whole.joined(other.whole).summed({_WHOLE: [0, 1]}),
            groups,
            places.summed(by_name).rounded,
            geometry,
            quantities,
        )

    def over(self, quantities: Sequence[str]) -> FactorGroups:
        """Triangles of tolerances for more quantities; additional ones have no effect."""
        geometry = self.geometry
        assert geometry is not None
        if tuple(quantities) == self.quantities:
            return geometry
        place = [quantities.index(name) for name in self.quantities]
        wide = list[np.ndarray]()
        for R in geometry.factors:
            columns = R.shape[2] - 1 - len(place)
            A = np.zeros((*R.shape[:2], columns + len(quantities) + 1))
            A[..., [*range(columns), *(columns + k for k in place), -1]] = R
            wide.append(A)
        return FactorGroups.of_rows(
            geometry.names, wide, geometry.samples, geometry.torque_max
        ).rounded

    def information(self, merging: Merging, groups: FactorGroups) -> list[Information]:
        """Information of some groups over all active columns."""
        each = zip(
            _expanded(groups, merging.drives), groups.samples, groups.torque_max, strict=True
        )
        return [Information(merging.active, *group) for group in each]

    def by_place(self, merging: Merging) -> Float[np.ndarray, "places drives augmented augmented"]:
        """[Y, τ]ᵀ[Y, τ] of each place."""
        A = _expanded(self.places, merging.drives)
        return A.swapaxes(2, 3) @ A

    def geometric_rows(
        self, merging: Merging, weights: Float[np.ndarray, " drives"]
    ) -> GeometricRows | None:
        """Rows with the effects of tolerances, weighted as in the fit; None without tolerances."""
        if self.geometry is None:
            return None
        each = zip(self.geometry.factors, merging.drives, weights, strict=True)
        rows = [
            weight
            * np.column_stack([R[:, : len(drive.at)] @ drive.combinations, R[:, len(drive.at) :]])
            for (R,), drive, weight in each
        ]
        Y, D, tau = np.split(np.vstack(rows), [len(merging.active), -1], axis=1)
        return GeometricRows(Y, tau[:, 0], D, self.quantities)


def halved(keys: Sequence[int]) -> int:
    """Number of ascending keys in the first half, whose first differing bit is 0. So a key's half
    hardly depends on the other keys."""
    bit = (keys[0] ^ keys[-1]).bit_length() - 1
    return bisect_left(keys, keys[-1] >> bit << bit) if bit >= 0 else len(keys) // 2


def _cuts(keys: Sequence[int], most: int) -> list[int]:
    """Sizes of the largest recursive halves with at most `most` recordings."""
    if len(keys) <= most:
        return [len(keys)]
    middle = halved(keys)
    return _cuts(keys[:middle], most) + _cuts(keys[middle:], most)


def _expanded(
    groups: FactorGroups, drives: Sequence[Independent]
) -> Float[np.ndarray, "groups drives augmented augmented"]:
    """Triangles over all columns, padded with zero rows."""
    each = zip(groups.factors, drives, strict=True)
    return stacked(
        [np.dstack([R[..., :-1] @ drive.combinations, R[..., -1:]]) for R, drive in each]
    )


ENDING = ".block.npz"
# Version of the file; increases with any change of its contents.
FORMAT = 3
_BRIEFS = TypeAdapter(tuple[RecordingBrief, ...])
_GROUPS = ("whole", "groups", "places", "geometry")
_ARRAYS = ("samples", "torque_max")


def _packed(R: Float[np.ndarray, "groups n n"], kind: type) -> UInt8[np.ndarray, "bytes _ groups"]:
    """Entries of triangles, split into bytes of equal significance: similar exponents are adjacent
    and compress well."""
    return np.ascontiguousarray(entries_of(R).astype(kind)[..., None].view(np.uint8).T)


def _unpacked(packed: UInt8[np.ndarray, "bytes _ groups"]) -> Float[np.ndarray, "groups n n"]:
    return triangles_of(np.ascontiguousarray(packed.T).view(f"f{len(packed)}")[..., 0])


def block_bytes(block: RecordingBlock) -> bytes:
    arrays = {f"friction.{x.name}": getattr(block.friction, x.name) for x in fields(FrictionSums)}
    known: dict[str, Any] = {
        "fingerprint": block.fingerprint,
        "keys": block.keys,
        "counts": block.counts,
        "quantities": block.quantities,
    }
    for name in _GROUPS:
        if (groups := getattr(block, name)) is not None:
            known[name] = [groups.names, len(groups.factors)]
            kind = float if name == _WHOLE else np.float32
            arrays |= {f"{name}.{i}": _packed(R, kind) for i, R in enumerate(groups.factors)}
            arrays |= {f"{name}.{array}": getattr(groups, array) for array in _ARRAYS}
    texts = {"known": json.dumps(known).encode(), "briefs": _BRIEFS.dump_json(block.briefs)}
    return sealed_archive(
        **{name: np.frombuffer(text, dtype=np.uint8) for name, text in texts.items()}, **arrays
    )


def block_of(data: bytes | None) -> RecordingBlock | None:
    """The block of a file; None if it is missing or damaged."""
    if not data or not is_intact(data):
        return None
    with np.load(BytesIO(data), allow_pickle=False) as file:
        arrays = dict(file)
    known = json.loads(arrays["known"].tobytes())
    groups: dict[str, Any] = {
        name: FactorGroups(
            tuple(known[name][0]),
            tuple(_unpacked(arrays[f"{name}.{i}"]) for i in range(known[name][1])),
            *(arrays[f"{name}.{array}"] for array in _ARRAYS),
        )
        for name in _GROUPS
        if name in known
    }
    return RecordingBlock(
        known["fingerprint"],
        tuple(known["keys"]),
        _BRIEFS.validate_json(arrays["briefs"].tobytes()),
        FrictionSums(*(arrays[f"friction.{x.name}"] for x in fields(FrictionSums))),
        tuple(known["counts"]),
        *(groups[name] for name in ("whole", "groups", "places")),
        geometry=groups.get("geometry"),
        quantities=tuple(known["quantities"]),
    )
