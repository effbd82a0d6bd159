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
    """Consistent models of one robot, each as likely as any other.

    Attributes:
        model: the identified model that they are drawn around.
        robot: whose parameters they are; with bodies of each limb's own where limbs scatter.
        p: parameters, a row a model.
        ess: for each parameter, how many independent draws these are worth.
        rhat: for each, by which factor its spread might still grow; 1 where chains agree.
        seed: that they were drawn with.
        limb_tolerance: relative standard deviation from limb to limb.
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
        """Values of one parameter, one a model.

        Raises:
            UnknownNameError: the robot has none of that name; the message has the nearest.
        """
        return self.p[:, place(self.layout, name, self.robot.name)]

    @cached_property
    def layout(self) -> ParameterLayout:
        """Names, units and places of the parameters."""
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
        """The drawn models."""
        for i, p in enumerate(self.p):
            source = f"{self.model.source}, sample {i + 1} of {len(self)}"
            yield Model(self.robot, p, source, self.model.identified)

    def save(self, path: str | Path) -> Path:
        """Write parameters, names, units and diagnostics as a .npz file.

        Raises:
            DeltaidError: the name has another end, or the file cannot be written.
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
        """Write a new folder with one MJCF file a model, and index.csv with their parameters.

        Raises:
            DeltaidError: there is such a folder, it cannot be written, or MJCF lacks what the
                robot has.
        """
        return above("exports.mjcf", "write_ensemble")(self, folder)
