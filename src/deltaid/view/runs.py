"""Motions by themselves, without the robot that they are of."""

from deltaid.motion.excitation.run import Run
from deltaid.motion.fourier import FourierMotion
from deltaid.view.card import Card
from deltaid.view.numbers import number


def card(value: Run | FourierMotion) -> Card:
    """Durations and harmonics."""
    motion = value.motion if isinstance(value, Run) else value
    facts = [
        ("period", f"{number(motion.period)} s"),
        ("harmonics", str(motion.sine.shape[1])),
        ("coordinates", str(len(motion.centre))),
    ]
    if isinstance(value, FourierMotion):
        return Card("Periodic motion", (), "", tuple(facts), methods=(".evaluate(time)",))
    facts = [("duration", f"{number(value.duration)} s"), ("periods", str(value.repeats)), *facts]
    return Card("Motion from rest to rest", (), "", tuple(facts), methods=(".evaluate(time)",))
