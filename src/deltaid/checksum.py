"""A checksum within a file: SHA-256 of all its bytes, with the checksum's own digits as zeros.

A text of fixed length, `EMPTY`, is part of the file wherever its format keeps text verbatim: in the
metadata of Parquet, the comment of a zip archive, a comment of YAML. So a file is verified before
any of it is interpreted.
"""

import hashlib
import re
import zipfile
from io import BytesIO
from typing import Any

from deltaid.errors import DeltaidError

_NAME = b"deltaid-sha256:"
_PLACE = re.compile(_NAME + rb"[0-9a-f]{64}")
EMPTY = (_NAME + b"0" * 64).decode()


def sealed(data: bytes) -> bytes:
    """The same bytes with their checksum in place of `EMPTY`, which must occur exactly once."""
    assert data.count(EMPTY.encode()) == 1
    return data.replace(EMPTY.encode(), _NAME + hashlib.sha256(data).hexdigest().encode())


def is_intact(data: bytes) -> bool | None:
    """Whether a file is as it was sealed; None if it has no checksum."""
    if len(_PLACE.findall(data)) != 1:
        return None
    return sealed(_PLACE.sub(EMPTY.encode(), data)) == data


def require_intact(data: bytes, where: str, error: type[DeltaidError], cure: str) -> None:
    """Refuse a file that has changed since it was sealed, or that was never sealed.

    Raises:
        DeltaidError: of the given kind.
    """
    match is_intact(data):
        case None:
            raise error(
                "has no checksum: it is damaged, or of an earlier version", where=where, cure=cure
            )
        case False:
            raise error("is damaged: its checksum is another", where=where, cure=cure)
        case True:
            return


def sealed_archive(**arrays: Any) -> bytes:
    """The bytes of an .npz file of these arrays, with their checksum as the archive's comment."""
    import numpy as np

    file = BytesIO()
    np.savez_compressed(file, **arrays)
    with zipfile.ZipFile(file, "a") as archive:
        archive.comment = EMPTY.encode()
    return sealed(file.getvalue())
