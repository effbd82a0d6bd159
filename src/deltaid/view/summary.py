"""The verdict on a model in words, for pages, terminal, notebook and studio."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deltaid.errors import plural
from deltaid.identification.identify import Identification
from deltaid.identification.prediction import Compared, misfit, remarks
from deltaid.identification.sources import repeated
from deltaid.identification.torque_error import TorqueError
from deltaid.levels import EXACT
from deltaid.model.model import Model, load
from deltaid.model.record import Fit, IdentifiedModel
from deltaid.view.corrections import corrected
from deltaid.view.numbers import FEW, in_words, number, percent
from deltaid.view.page import Section, Summary, Table, Text, Trust

# Torque errors of the worst drive, rms as a share of the torque's own rms. A feed-forward error of
# a twentieth is as small as the uncertainty of drives' torque constants; a sixth, as much as
# friction or a load usually causes, means that the model lacks something.
GOOD_WITHIN, FAIR_WITHIN = 0.05, 0.15
_DOUBT = "Doubtful: "
_ONLY = "only within"
# Warning on the absolute scale if only torques are known in N m.
_SCALE = (
    "The absolute scale of masses and friction rests on the drives' torque constants: no known "
    "load, force plate or weighed body confirms it."
)
_CAUSE = re.compile(r"[;.] +(?:likeliest|deltaid check|identify |take |weigh )", re.IGNORECASE)


def summary(
    result: Identification | IdentifiedModel | Model,
    error: TorqueError | None = None,
    log: Compared | None = None,
) -> Summary:
    """The verdict on an identification or a model.

    Args:
        result: of `identify`, or a model, which may be a prior.
        error: torque errors on another recording, as of `validate`; None for those in the model.
        log: that recording; without it, it counts as unseen by the model.
    """
    model = load(result)
    known = model.identified
    if known is None:
        return _of_prior(model, error)
    doubts = [text for text in known.warnings if text not in known.undecided]
    wrong = list(known.wrong) + ["a body is not physically consistent"] * (not known.consistent)
    own = log is not None and repeated(known.sources, log.sha256, log.rows) is not None
    unseen = known.verification if error is None else None if own else error
    if error is not None:
        doubts += remarks(model, log, error) if log is not None else misfit(model, error)
    elif known.verification is not None:
        doubts += known.verification.remarks
    missed = unseen is not None and bool(misfit(model, unseen))
    bad = bool(wrong) or missed or known.unexplained > FAIR_WITHIN
    nrmse = known.fit.nrmse if unseen is None else unseen.nrmse
    grade = _grade(nrmse, unseen=unseen is not None, bad=bad, doubtful=bool(doubts))
    said = f"predicts {_efforts(model)} of an unseen motion {_within(model, nrmse)}"
    if unseen is None:
        said = (
            f"fits {_efforts(model)} of its own recording {_within(model, nrmse)}, and no unseen "
            "motion has shown how well it predicts"
        )
    return Summary(
        grade,
        f"{grade.capitalize()}: {_with_faults(said, len(doubts), wrong)}.",
        (
            _numbers(known),
            corrected(known.corrections),
            *((_SCALE,) if known.absolute == () else ()),
            *(pair.text for pair in known.inseparable),
            *_doubts(doubts),
        ),
    )


def without_doubts(said: Summary) -> Summary:
    """The summary without doubts, for pages that show all warnings elsewhere."""
    return replace(said, lines=tuple(line for line in said.lines if not line.startswith(_DOUBT)))


def _grade(
    nrmse: Sequence[float] | np.ndarray, *, unseen: bool = True, bad: bool = False,
    doubtful: bool = False,
) -> Trust:  # fmt: skip
    worst = float(np.max(nrmse))
    if bad or not worst <= FAIR_WITHIN:
        return Trust.POOR
    if not unseen:
        return Trust.UNTESTED
    return Trust.GOOD if worst <= GOOD_WITHIN and not doubtful else Trust.FAIR


def _with_faults(said: str, doubts: int, wrong: Sequence[str]) -> str:
    if wrong:
        return f"{said}; found wrong: {', '.join(dict.fromkeys(wrong))}"
    if not doubts:
        return said
    joined = "and" if _ONLY in said else "but"
    return f"{said}, {joined} {_count(doubts, 'thing')} {'is' if doubts == 1 else 'are'} doubtful"


def _of_prior(model: Model, error: TorqueError | None) -> Summary:
    line = ("All numbers are those of the description: nothing has been identified.",)
    if error is None:
        return Summary(Trust.UNTESTED, "Untested: no recording has been predicted.", line)
    grade = _grade(error.nrmse)
    said = f"the description alone predicts {_efforts(model)} {_within(model, error.nrmse)}"
    return Summary(grade, f"{grade.capitalize()}: {said}.", line)


def _efforts(model: Model) -> str:
    return " and ".join(dict.fromkeys(f"{u.effort}s" for u in model.robot.drive_units.values()))


def _within(model: Model, nrmse: Sequence[float] | np.ndarray) -> str:
    worst = int(np.argmax(nrmse))
    how = "within" if nrmse[worst] <= FAIR_WITHIN else _ONLY
    return f"{how} {percent(float(nrmse[worst]))} (rms; the worst is {model.robot.drives[worst]})"


def _numbers(model: IdentifiedModel) -> str:
    """Origin of the model's numbers, and how many are at their bounds."""
    kinds = Counter(parameter.determined_by for parameter in model.parameters)
    shared, measured = kinds["sum"], kinds["measured"]
    known, bound = kinds["data"] + shared + measured, kinds["limit"] + kinds["consistency"]
    further = [f"{shared} of them as sums with others"] * bool(shared)
    further += [f"{measured} mostly from what was weighed or measured"] * bool(measured)
    shares = f" ({', '.join(further)})" if further else ""
    few = "one" if bound else "none"
    at_bound = f"{in_words(bound)} are at their" if bound > 1 else f"{few} is at its"
    return (
        f"{known} of {kinds.total() - kinds['structure']} numbers "
        f"{'comes' if known == 1 else 'come'} from the "
        f"{plural('recording', len(model.sources))}{shares}, {at_bound} bound."
    )


def _doubts(doubts: Sequence[str]) -> list[str]:
    lines = [f"{_DOUBT}{_CAUSE.split(text)[0].rstrip('.')}." for text in doubts[:FEW]]
    more = len(doubts) - FEW
    return lines + [f"{_DOUBT}{_count(more, 'more thing')}, listed in the warnings."] * (more > 0)


def _count(count: int, thing: str) -> str:
    return f"{in_words(count)} {plural(thing, count)}"


def provenance_section(model: Model, title: str) -> Section:
    """Sources, fit and settings of a model; at the prior, sources of the description."""
    known, sources = model.identified, tuple(model.robot.sources.items())
    columns = ("number of the description", "source")
    described = Table(columns, sources, "Sources of the description.")
    if known is None:
        return Section(title, (Text(f"Parameters: {model.origin}."), described), "where it is from")
    settings = {
        name.replace("_", " "): "by rule" if value is None else _shown(value)
        for name, value in known.settings.model_dump().items()
    }
    tables = (
        *provenance_tables(known),
        Table(
            ("setting", "value"),
            (*settings.items(), ("deltaid version", known.deltaid)),
            "Settings of the fit.",
        ),
        described,
    )
    return Section(title, tables, "recordings, what the fit reached, settings")


def provenance_tables(model: IdentifiedModel) -> tuple[Table, Table]:
    """Recordings that a model was identified from, and what its fit reached."""
    fit = model.fit
    optimality, words = certificate(fit)
    gap = words if fit.duality_gap is None else f"{fit.duality_gap:.1e}"
    reached = {
        "objective J": number(fit.objective, 5),
        "duality gap, J minus its certified bound": f"{gap} ({optimality})",
        "weight of the prior γ": number(fit.gamma),
        "solver's status": fit.status,
        "iterations": str(fit.iterations),
        "free parameters": str(fit.optimization_variables),
        "base parameters": str(fit.base_parameters),
        "condition of the base regressor": number(fit.base_condition),
        "torque noise, share of the largest torque": percent(fit.noise_level),
    }
    return _recording_table(model), Table(("fit", "result"), tuple(reached.items()))


def _recording_table(model: IdentifiedModel) -> Table:
    return Table(
        ("recording", "samples", "used", "rate", "cut-off", "positions", "reversals", "SHA-256"),
        tuple(
            (
                source.log,
                str(source.samples),
                str(source.used_samples),
                f"{source.rate_hz:.6g}",
                *(
                    f"{cutoff:.3g}" if cutoff else "—"
                    for cutoff in (source.cutoff_hz, source.motion_cutoff_hz or source.cutoff_hz)
                ),
                ", ".join(percent(part.share) for part in source.left_out if not part.spans),
                source.sha256,
            )
            for source in model.sources
        ),
        "Recordings that the model was identified from: samples recorded, and used behind the "
        "zero-phase low-pass; sampling rate and cut-offs for rows and for positions in Hz; share "
        "of the rows excluded at reversals.",
        title="recordings: frequencies in Hz, share excluded at reversals",
    )


def certificate(fit: Fit) -> tuple[str, str]:
    """Optimality of the fit: in a word or two, and its distance to the certified bound."""
    if fit.duality_gap is None:
        return "not certified", "this regulariser is not convex"
    gap = fit.duality_gap / fit.objective if fit.objective else 0.0
    if gap < EXACT:
        return "certified", f"no consistent model fits better by {percent(EXACT)}"
    return f"within {percent(gap)}", "of the best fit that is possible"


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return number(value) if isinstance(value, float) else str(value)
