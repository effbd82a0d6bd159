"""The identification of a robot from factor files: `identify` without its recordings."""

from collections.abc import Sequence

from deltaid.check.identified import Judged
from deltaid.check.verdicts import Verdicts
from deltaid.factors.alike import require_alike
from deltaid.factors.file import FactorFile
from deltaid.factors.laws import asked_for
from deltaid.factors.problem import fitted, holding
from deltaid.factors.told import corrections, remarks, torque_constants, verdicts
from deltaid.factors.torques import torque_errors
from deltaid.identification.assembled import assembled
from deltaid.identification.friction_curves import freed
from deltaid.identification.judgement import judged_parameters
from deltaid.identification.loads import found_loads
from deltaid.model.record import Settings
from deltaid.robot.load import RobotLike, described


def identify_gathered(
    robot: RobotLike, files: Sequence[FactorFile], settings: Settings | None = None
) -> Judged:
    """Identify a robot from the factors of its recordings.

    What was put right in each recording stays so. Friction laws are those of the description, or
    what most of the recordings asked for.

    Args:
        robot: with priors, reductions and measured values of its own; its mechanism is that of the
            files.
        files: of recordings of the same robot.
        settings: method, regulariser, γ, prior's spread, friction.

    Raises:
        RecordingError: files do not go together, or not with the robot.
        IdentificationError: the fit cannot be posed or did not converge.
    """
    settings, description = settings or Settings(), described(robot)
    require_alike(files, description)
    files = sorted(files, key=lambda one: one.record.sha256)
    gains = torque_constants(files)
    chosen = asked_for(description, files) if settings.friction == "choose" else description
    problem = fitted(files, chosen, settings)
    judged = judged_parameters(freed(problem))
    model = assembled(
        problem,
        settings,
        torque_errors(problem.information, problem.values, files),
        judged,
        loads=found_loads(problem.additions, judged[len(problem.p) :], holding(files)),
        corrections=corrections(description, chosen, files),
        sources=tuple(one.record.model.sources[0] for one in files),
        remarks=remarks(files, gains),
    )
    return Judged(model, problem, (), (), Verdicts(verdicts(files)))
