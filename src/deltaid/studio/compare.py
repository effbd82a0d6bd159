"""What runs found, in words and side by side."""

from collections.abc import Sequence
from typing import Any

from deltaid.errors import DeltaidError
from deltaid.model.model import load
from deltaid.studio.folder import Folder
from deltaid.studio.runs import Run, output
from deltaid.view.numbers import number, percent

# Parameters of a comparison: those that changed most, in standard deviations of both.
_SHOWN = 12
_KINDS = {"good": "good", "poor": "bad"}


def told_of(folder: Folder, run: Run) -> list[tuple[str, str]]:
    """Sentences about a fit, each with its kind of note: '', 'good', 'doubt' or 'bad'."""
    told = output(folder, run).get("summary")
    if not isinstance(told, dict):
        return []
    kind = _KINDS.get(str(told["grade"]), "doubt")
    return [(str(told["sentence"]), kind), ("\n".join(told["lines"]), "")]


def comparison(folder: Folder, pair: Sequence[Run]) -> list[tuple[str, ...]]:
    """Rows of a table of runs: errors, noise, rank, settings, parameters that differ most."""
    found = [output(folder, run) for run in pair]
    rows: list[tuple[str, ...]] = [
        ("verdict", *(str(one.get("summary", {}).get("sentence", "–")) for one in found)),
        ("robot", *(str(one.get("robot", "")) for one in found)),
        ("recordings", *(", ".join(_logs(run)) for run in pair)),
        ("error on them", *(_share(one.get("nrmse")) for one in found)),
        ("error on an unseen motion", *(_share(_verify(one).get("nrmse")) for one in found)),
        ("torque noise", *(percent(one["noise_level"]) for one in found)),
        ("base parameters", *(str(one["base_parameters"]) for one in found)),
        ("corrections", *(str(len(one["corrections"])) for one in found)),
        ("γ", *(number(one["gamma"], 3) for one in found)),
    ]
    return rows + _parameters(folder, pair)


def _parameters(folder: Folder, pair: Sequence[Run]) -> list[tuple[str, ...]]:
    try:
        models = [load(folder.root / run.file("model.yaml")).identified for run in pair]
    except DeltaidError:
        return []
    if len(models) != 2 or models[0] is None or models[1] is None:
        return []
    left, right = ({one.name: one for one in model.parameters} for model in models if model)
    shared = [name for name in left if name in right and left[name].value != right[name].value]

    def apart(name: str) -> float:
        a, b = left[name], right[name]
        scale = a.std + b.std
        return -abs(a.value - b.value) / scale if scale else 0.0

    return [
        (
            f"{name} [{left[name].unit}]",
            *(f"{one[name].value:.4g} ({one[name].low:.3g} … {one[name].high:.3g})"
              for one in (left, right)),
        )
        for name in sorted(shared, key=apart)[:_SHOWN]
    ]  # fmt: skip


def _logs(run: Run) -> list[str]:
    return [one.file for one in run.record.inputs if not one.file.endswith((".yaml", ".yml"))]


def _verify(found: dict[str, Any]) -> dict[str, Any]:
    return found.get("verify") or {}


def _share(values: Sequence[float] | None) -> str:
    return percent(max(values)) if values else "–"
