"""How friction laws were chosen, as a table of the terminal."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from deltaid.identification.friction_record import FrictionChoice
    from deltaid.robot.description import RobotDescription

ADDITIONS = {
    "offset": "offset",
    "both_ways": "both ways",
    "power": "power of speed",
    "stribeck": "Stribeck",
    "load": "load",
}


def choice_table(choice: "FrictionChoice", robot: "RobotDescription") -> object:
    """For each joint what every addition alone gains, and the law that was chosen."""
    from deltaid.cli.output import percent, table
    from deltaid.robot.friction_text import written

    gains = {(t.joint, t.addition): t for t in choice.trials}
    rows = []
    for joint, law in robot.friction.items():
        row = [joint]
        for addition in ADDITIONS:
            trial = gains.get((joint, addition))
            gain = max(trial.gain, 0.0) if trial else 0.0
            row.append("–" if trial is None else percent(gain) if trial.useful else "chance")
        rows.append([*row, written(law)])
    title = (
        "friction laws: gain of each term alone on stretches the fit has not seen "
        f"({choice.folds} folds)"
    )
    return table(title, ["joint", *ADDITIONS.values(), "chosen law"], rows)


def choice_sentence(choice: "FrictionChoice") -> str:
    """The torque error on unseen stretches before and after the choice."""
    from deltaid.cli.output import percent

    return (
        f"torque error on unseen stretches {percent(choice.plain_error)} of the largest torque "
        f"with viscous and Coulomb friction, {percent(choice.chosen_error)} with the chosen laws"
    )
