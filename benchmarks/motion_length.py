"""How long a motion has to be for the bounds that Sec. VII of the paper is held to.

    pip install .
    python benchmarks/motion_length.py

The surrogate of `deltaid reproduce surrogate` with 2 % torque noise. For each length: a few
optimised motions, each recorded with a few seeds of noise, each recording fitted from both
regularisations by the certified solver. Bounds: M within 1 % on and 2 % off the diagonal, friction
coefficients within 3 %, at any time along the motion.
"""

from dataclasses import replace

import numpy as np

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.identification.identify import identify
from deltaid.motion.excitation.excite import ExcitationSettings, Exciter
from deltaid.motion.surrogate import SensorNoise, simulate_recording
from deltaid.reproduce.accuracy import Accuracy, accuracy, drive_motion
from deltaid.reproduce.table_one import ABOVE, BELOW, ROBOT, nominal_robot, regularisation
from deltaid.robot.load import load_robot

LENGTHS = (
    ExcitationSettings(harmonics=5, duration=10.0, repeats=1, starts=2),
    ExcitationSettings(harmonics=5, duration=20.0, repeats=1, starts=2),
    ExcitationSettings(harmonics=8, duration=20.0, repeats=2, starts=2),
)
MOTIONS, NOISES, RATE, TORQUE_NOISE = 4, 4, 1000.0, 0.02
BOUNDS = {"mass_diagonal": 0.01, "mass_off_diagonal": 0.02, "friction_coefficients": 0.03}


def main() -> None:
    print("duration  harmonics  fits  M on     M off    friction  beyond the bounds")
    for settings in LENGTHS:
        duration, fits = 0.0, list[Accuracy]()
        for seed in range(MOTIONS):
            duration, found = _fits(replace(settings, seed=seed))
            fits += found
        errors = np.array([[getattr(fit, name) for name in BOUNDS] for fit in fits])
        beyond = int(np.any(errors > [*BOUNDS.values()], axis=1).sum())
        shown = "   ".join(f"{value:.2%}" for value in errors.max(axis=0))
        print(
            f"{duration:5.1f} s   {settings.harmonics:9}  {len(fits):4}  {shown}     "
            f"{beyond} of {len(fits)}"
        )


def _fits(settings: ExcitationSettings) -> tuple[float, list[Accuracy]]:
    """Length of a motion [s] and the accuracy of all fits to its recordings."""
    rng = np.random.default_rng(settings.seed)
    nominal = nominal_robot(load_robot(ROBOT))
    shares = {"RG1": BELOW, "RG2": ABOVE}
    priors = [regularisation(nominal, name, share, rng) for name, share in shares.items()]
    dynamics, truth = compiled(nominal), prior_parameters(nominal)
    run = Exciter(compiled(priors[1]), settings).optimise().run
    along = drive_motion(dynamics, run, np.arange(round(run.duration * RATE)) / RATE)
    fits, how = [], {"duration": run.duration, "rate": RATE, "noise": SensorNoise(TORQUE_NOISE)}
    for _ in range(NOISES):
        recording = simulate_recording(dynamics, truth, run, rng, **how)
        models = [identify(prior, recording).model for prior in priors]
        fits += [accuracy(dynamics, along, truth, model.p) for model in models]
    return run.duration, fits


if __name__ == "__main__":
    main()
