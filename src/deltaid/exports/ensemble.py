"""Drawn models as a folder of MJCF files, for programs that train or test on many robots."""

import csv
from pathlib import Path

from deltaid.errors import DeltaidError
from deltaid.exports.mjcf import mjcf
from deltaid.files import new_folder
from deltaid.model.samples import Samples
from deltaid.robot.inertia import why_not_physical

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
            for body in model.layout.bodies:
                if reason := why_not_physical(model.body(body)):
                    raise DeltaidError(
                        f"body {body} cannot be exported: {reason}",
                        where=model.source,
                        cure="draw with another --seed, or fewer models",
                    )
            name = f"model_{i + 1:0{digits}}.xml"
            (place / name).write_text(mjcf(model), encoding="utf-8")
            index.writerow([name, *map(repr, model.p.tolist())])
    return Path(folder)
