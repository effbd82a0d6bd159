"""Options of a simulation; imports nothing slow."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from deltaid.errors import DeltaidError, positive

if TYPE_CHECKING:
    from deltaid.control.plant import Payload

ControllerName = Literal["pd", "pd-feedforward", "computed-torque", "augmented-pd", "slotine-li"]


@dataclass(frozen=True)
class ControlSettings:
    """Settings of drives, feedback, gears and load.

    Attributes:
        rate: sampling rate of the drives [1/s].
        bandwidth: of the feedback [Hz].
        encoder: step [rad or m]; 0 for none, 2⁻²⁰ of a turn if None.
        delay: samples from an encoder's reading to its use.
        current_loop: bandwidth of the drives' current loop [Hz]; no lag if None.
        payload: load at the plant's tool [kg]; "1.5±0.1" with its standard deviation.
        elastic_gears: whether gears wind up by the plant's `gear_stiffness`.

    Raises:
        DeltaidError: a number is out of bounds.
    """

    rate: float = 1000.0
    bandwidth: float = 10.0
    encoder: float | None = None
    delay: int = 0
    current_loop: float | None = None
    payload: "Payload | float | str | None" = None
    elastic_gears: bool = False

    def __post_init__(self) -> None:
        positive("--rate", self.rate, (10.0, 1e5))
        is_usual = self.bandwidth == ControlSettings.bandwidth
        if is_usual and self.rate < 10 * self.bandwidth:
            raise DeltaidError(
                f"must be ten times the bandwidth of the feedback, {10 * self.bandwidth:g} Hz, or "
                f"more, not {self.rate:g}",
                where="--rate",
                cure="give a higher --rate, or a lower --bandwidth",
            )
        positive("--bandwidth", self.bandwidth, (0.01, self.rate / 10))
        positive("--encoder", self.encoder or None, (0.0, 1.0))
        positive("--current-loop", self.current_loop, (1.0, 1e5))
