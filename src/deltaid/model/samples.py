"""Models drawn from a posterior, as one array of parameters."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float

from deltaid.checksum import sealed_archive
from deltaid.dynamics.parameters import ParameterLayout, parameter_layout
from deltaid.errors import DescriptionError
from deltaid.files import write_bytes
from deltaid.model.model import Model
from deltaid.model.parameter_record import place
from deltaid.model.record import above
from deltaid.robot.description import RobotDescription
from deltaid.shown import Plotted, Shown, Tabled


@dataclass(frozen=True, eq=False, repr=False)
class Samples(Shown, Plotted, Tabled):
    """Equally likely consistent models of one robot.

    Attributes:
        model: the identified model that they are drawn around.
        robot: described by `p`; with separate bodies for each limb if limbs scatter.
        p: parameters, one model per row.
        ess: effective number of independent draws, for each parameter.
        rhat: factor by which the spread might still grow, for each parameter; 1 if chains agree.
        seed: of the draw.
        limb_tolerance: relative standard deviation between limbs.
    """

    model: Model
    robot: RobotDescription
    p: Float[np.ndarray, "n parameters"]
    ess: Float[np.ndarray, " parameters"]
    rhat: Float[np.ndarray, " parameters"]
    seed: int = 0
    limb_tolerance: float = 0.0

    def __len__(self) -> int:
        return len(self.p)

    def __getitem__(self, name: str) -> Float[np.ndarray, " n"]:
        """Values of one parameter, one for each model.

        Raises:
            UnknownNameError: the robot has no such parameter; the message suggests the nearest.
        """
        return self.p[:, place(self.layout, name, self.robot.name)]

    @cached_property
    def layout(self) -> ParameterLayout:
        """Names, units and indices of the parameters."""
        return parameter_layout(self.robot)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return self.layout.names

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters."""
        return self.layout.units

    def models(self) -> Iterator[Model]:
        """The drawn models, one by one."""
        for i, p in enumerate(self.p):
            source = f"{self.model.source}, sample {i + 1} of {len(self)}"
            yield Model(self.robot, p, source, self.model.identified)

    def save(self, path: str | Path) -> Path:
        """Save parameters, names, units and diagnostics as a .npz file.

        Raises:
            DeltaidError: the name does not end in .npz, or the file cannot be written.
        """
        path = Path(path)
        if path.suffix.lower() != ".npz":
            raise DescriptionError("must end in .npz", where=str(path))
        data = sealed_archive(
            p=self.p,
            names=np.array(self.names),
            units=np.array(self.units),
            ess=self.ess,
            rhat=self.rhat,
            fitted=self.model.p,
            fitted_names=np.array(self.model.layout.names),
            seed=np.array(self.seed),
            limb_tolerance=np.array(self.limb_tolerance),
            robot=np.array(self.robot.model_dump_json(exclude_none=True)),
            provenance=np.array(self.model.provenance),
        )
        write_bytes(path, data)
        return path

    def mjcf(self, folder: str | Path) -> Path:
        """Write a new folder with one MJCF file for each model, and index.csv with their
        parameters.

        Raises:
            DeltaidError: the folder exists or cannot be written, or MJCF cannot represent the
                robot.
        """
        return above("exports.mjcf", "write_ensemble")(self, folder)
