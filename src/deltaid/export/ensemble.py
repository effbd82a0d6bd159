"""Drawn models as a folder of MJCF files, for programs that train or test on many robots."""

import csv
from pathlib import Path

from deltaid.export.files import require_physical
from deltaid.export.mjcf import mjcf
from deltaid.files import new_folder
from deltaid.model.samples import Samples

INDEX = "index.csv"


def write_ensemble(samples: Samples, folder: str | Path) -> Path:
    """Write a new folder with a file a model, and an index: file, then all parameters.

    The folder appears with all files in it, or not at all.

    Raises:
        DeltaidError: there is such a folder, it cannot be written, or MJCF lacks what the robot
            has.
    """
    digits = len(str(len(samples)))
    with (
        new_folder(Path(folder)) as place,
        (place / INDEX).open("w", encoding="utf-8", newline="") as file,
    ):
        index = csv.writer(file, lineterminator="\n")
        index.writerow(["file", *samples.names])
        for i, model in enumerate(samples.models()):
            require_physical(model)
            name = f"model_{i + 1:0{digits}}.xml"
            (place / name).write_text(mjcf(model), encoding="utf-8")
            index.writerow([name, *map(repr, model.p.tolist())])
    return Path(folder)
