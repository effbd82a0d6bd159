"""Where a model comes from: recordings, settings, what the fit reached, version."""

from deltaid.model.model import Model
from deltaid.model.record import Fit, IdentifiedModel
from deltaid.view.numbers import number, percent
from deltaid.view.page import Section, Table, Text

# Closer than this to its certified bound [share of J] a fit is the best one.
_ROUNDING = 1e-4


def provenance_section(model: Model, title: str) -> Section:
    """Sources, fit and settings of a model; of a robot at its prior, where its numbers are from."""
    known, sources = model.identified, tuple(model.robot.sources.items())
    columns = ("number of the description", "source")
    own = (Table(columns, sources, "Sources of the description."),) if sources else ()
    if known is None:
        return Section(title, (Text(f"Parameters: {model.origin}."), *own), "where it is from")
    tables = (_sources(known), _fit(known), _settings(known), *own)
    return Section(title, tables, "recordings, what the fit reached, settings")


def file_names(model: IdentifiedModel) -> str:
    """The logs that a model comes from, as a list in words."""
    return ", ".join(source.log for source in model.sources)


def certificate(fit: Fit) -> tuple[str, str]:
    """Whether nothing fits better: in a word or two, and how far a certified bound is away."""
    gap = (fit.duality_gap or 0.0) / fit.objective if fit.objective else 0.0
    if gap < _ROUNDING:
        return "certified", "no consistent model fits better by 0.01 %"
    return f"within {percent(gap)}", "of the best fit that is possible"


def _sources(model: IdentifiedModel) -> Table:
    return Table(
        ("recording", "samples", "rate [Hz]", "cut-off [Hz]", "samples used", "SHA-256"),
        tuple(
            (
                source.log,
                str(source.samples),
                f"{source.rate_hz:.6g}",
                f"{source.cutoff_hz:.3g}" if source.cutoff_hz else "not filtered",
                str(source.used_samples),
                source.sha256,
            )
            for source in model.sources
        ),
        "Recordings that the model was identified from.",
    )


def _fit(model: IdentifiedModel) -> Table:
    fit = model.fit
    rows = (
        ("objective J", number(fit.objective)),
        ("certified lower bound", number(fit.lower_bound) if fit.lower_bound else "none"),
        ("above that bound, share of J", certificate(fit)[1] if fit.lower_bound else "not known"),
        ("weight of the prior γ", number(fit.gamma)),
        ("solver's status", fit.status),
        ("iterations", str(fit.iterations)),
        ("free parameters", str(fit.optimization_variables)),
        ("base parameters", str(fit.base_parameters)),
        ("condition of the base regressor", number(fit.base_condition)),
        ("torque noise, share of the largest torque", percent(fit.noise_level)),
    )
    return Table(("fit", "result"), rows)


def _settings(model: IdentifiedModel) -> Table:
    rows = tuple(
        (name.replace("_", " "), "by rule" if value is None else _shown(value))
        for name, value in model.settings.model_dump().items()
    )
    return Table(
        ("setting", "value"), (*rows, ("deltaid version", model.deltaid)), "Settings of the fit."
    )


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return number(value) if isinstance(value, float) else str(value)
