"""The Python file of the user's own mechanism, on all workers; imports Dask."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from distributed import WorkerPlugin

from deltaid.mechanism.user_code import use_mechanism


class OwnCode(WorkerPlugin):
    """Runs the file that the user has named, as it was when the command was called."""

    def __init__(self, code: bytes) -> None:
        self.code = code

    def setup(self, worker: Any) -> None:
        """On each worker, also on those that start later."""
        del worker
        with TemporaryDirectory(prefix="deltaid-") as folder:
            copy = Path(folder) / "mechanism.py"
            copy.write_bytes(self.code)
            use_mechanism(copy)
