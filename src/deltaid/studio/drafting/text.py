"""Text of a draft: a description in YAML with a comment on every number, and its sources."""

import json
import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from deltaid.levels import GRAVITY
from deltaid.studio.drafting.bodies import bodies, stroke
from deltaid.studio.drafting.draft import ASSUMED, Draft
from deltaid.studio.drafting.questions import (
    LINEAR,
    QUESTIONS,
    TELESCOPE,
    limbs_of,
    platform_of,
    rounded,
)

SCHEMA_FILE = "robot.schema.json"
_HEAD = f"""\
# yaml-language-server: $schema={SCHEMA_FILE}
# Written by `deltaid new`. Lengths in m, masses in kg, angles in degrees where a key ends in _deg.
# Nobody has measured what is "assumed": replace it where you can, and say in `sources` where from.
"""
# Text that needs no quotes: it starts with a letter and is no keyword of YAML.
_PLAIN = re.compile(
    r"(?!(?:true|false|null|yes|no|on|off|y|n)$)[A-Za-z][\w ,;.'()/+-]*", re.IGNORECASE
)
_AZIMUTHS = {
    "rigid": "[0, 120, 240]", "h4": "[15, 165, 270, 270]",
    "i4": "[45, -45, 135, -135]", "par4": "[45, -45, 135, -135]",
}  # fmt: skip
_HOW = {question.key: question.how for question in QUESTIONS}


class _Row(NamedTuple):
    """One key of the description.

    Attributes:
        path: of the key.
        value: as YAML; empty at the beginning of a part, whose source then holds for all its keys.
        questions: whose answers it is computed from; the comment states their origin and, if they
            are assumed, where to find them.
        note: begins the comment.
        source: its origin, if that is not the origin of the answers.
        below: lines that follow.
    """

    path: str
    value: str = ""
    questions: tuple[str, ...] = ()
    note: str = ""
    source: str = ""
    below: str = ""

    @classmethod
    def answer(cls, draft: Draft, path: str, question: str, unit: str = "") -> "_Row":
        """A key whose value is the answer to one question."""
        return cls(path, number(draft.values[question]), (question,), unit)


def written(draft: Draft) -> str:
    """The description as YAML; all questions of its kind must have answers."""
    lines, sources = [f"name: {_scalar(draft.name)}", f"title: {_scalar(draft.title)}"], {}
    for chapter in (_limbs, _telescope, _platform, _bodies, _friction, _rotors, _limits):
        for row in chapter(draft):
            path, value, questions, note, source, below = row
            origins = [draft.origins[key] for key in questions]
            comment = [note] if note else []
            if ASSUMED in origins:
                comment.append(f"{ASSUMED}; {_HOW[questions[origins.index(ASSUMED)]]}")
            elif origins:
                comment.append(origins[0])
            lines += [""] if not value and "." not in path else []
            said = f" # {'; '.join(comment)}" if comment else ""
            key = f"{path.rpartition('.')[2]}: {value}".rstrip()
            lines += [f"{'  ' * path.count('.')}{key}{said}", *([below] if below else [])]
            source = source or _together(draft, questions)
            if source and path.partition(".")[0] not in sources:
                sources[path] = source
    lines += ["", "sources:"]
    lines += [
        f"  {path}: {_scalar(source)}" for path, source in _with_merged_drives(sources).items()
    ]
    return _HEAD + "".join(f"{line}\n" for line in lines)


def _together(draft: Draft, questions: Iterable[str]) -> str:
    """The common origin of some answers, or each origin with its answer's name."""
    origins = {key: draft.origins[key] for key in questions}
    if len(set(origins.values())) == 1:
        return next(iter(origins.values()))
    return ", ".join(f"{key.replace('_', ' ')} {origin}" for key, origin in origins.items())


def _other_drives(draft: Draft, first: _Row) -> list[_Row]:
    """The same rows for the drives of all other limbs."""
    part, source = first.path.partition(".")[0], _together(draft, first.questions)
    drives = range(2, limbs_of(draft.kind) + 1)
    return [_Row(f"{part}.drive{i}", first.value, source=source) for i in drives]


def number(value: float) -> str:
    """A number in full precision."""
    return str(int(value)) if value == int(value) and abs(value) < 1e6 else repr(float(value))


def _product(a: float, b: float) -> float:
    """A product without rounding errors in the last bits: 0.4 times 3 is 1.2."""
    return float(f"{a * b:.12g}")


def _scalar(text: str) -> str:
    """Text of one line: plain words verbatim, all others quoted."""
    return text if _PLAIN.fullmatch(text) else json.dumps(text, ensure_ascii=not text.isprintable())


def _with_merged_drives(sources: Mapping[str, str]) -> dict[str, str]:
    merged = dict(sources)
    for part in ("friction", "rotor_inertia", "drive_limits"):
        own = [key for key in merged if key.startswith(f"{part}.")]
        if len({merged[key] for key in own}) == 1:
            merged[part] = merged[own[0]]
            merged = {key: text for key, text in merged.items() if key not in own}
    return merged


def _limbs(draft: Draft) -> list[_Row]:
    platform, rail = platform_of(draft.kind), draft.kind in LINEAR
    if platform == "h4":
        base, own = _h4_points(draft.values)
        source = f"{ASSUMED}, by the length of the middle bar"
        ends = [
            _Row("limbs.base_points", _list(base), ("base_radius",), "m, from base_radius"),
            _Row("limbs.platform_points", _list(own), note="m; assumed", source=source),
        ]
    else:
        keys = "base_radius", "platform_radius"
        ends = [_Row.answer(draft, f"limbs.{key}", key, "m") for key in keys]
    tilt = [_Row.answer(draft, "limbs.tilt_deg", "tilt", "0 upright, 90 flat")] if rail else []
    arm = [] if rail else [_Row.answer(draft, "limbs.upper_arm", "arm", "m, axis to elbow")]
    laid = "assumed: world axes are laid that way"
    return [
        _Row("limbs"),
        _Row("limbs.drive", "linear" if rail else "rotary"),
        _Row("limbs.azimuth_deg", _AZIMUTHS[platform], note=laid, source=ASSUMED),
        *tilt,
        *ends,
        *arm,
        _Row.answer(draft, "limbs.strut", "strut", "m, between joints"),
        _Row("limbs.struts_per_limb", "2", source=ASSUMED),
        _Row.answer(
            draft, "limbs.strut_spacing", "spacing", "m; forces in single struts depend on it"
        ),
    ]


def _h4_points(a: Mapping[str, float]) -> tuple[list[list[float]], list[list[float]]]:
    """Base and platform points of an H4 with the proportions of the prototype [m]."""
    R, h = a["base_radius"], a["bar"]
    base = [[R, 0.0], [-R, 0.0], [0.35 * R, -R], [-0.35 * R, -R]]
    own = [[h / 6, -h / 3], [-h / 6, -h / 3], [-2 * h / 3, h / 3], [2 * h / 3, h / 3]]
    return tuple([[*(rounded(x, 6) for x in p), 0.0] for p in points] for points in (base, own))  # pyright: ignore


def _list(points: list[list[float]]) -> str:
    return "[" + ", ".join("[" + ", ".join(map(number, p)) + "]" for p in points) + "]"


def _telescope(draft: Draft) -> list[_Row]:
    if draft.kind not in TELESCOPE:
        return []
    low, high = map(number, stroke(draft.values))
    middle = "m; assumed in the middle of base and platform"
    return [
        _Row("telescope", source=ASSUMED),
        _Row("telescope.base_joint", "[0, 0, 0]", note=middle),
        _Row("telescope.platform_joint", "[0, 0, 0]"),
        _Row("telescope.stroke", f"[{low}, {high}]", note="m; assumed, what the workspace takes"),
    ]


def _platform(draft: Draft) -> list[_Row]:
    platform, a = platform_of(draft.kind), draft.values
    if platform == "rigid":
        return []
    if platform == "i4":
        across = "the slide lies across the limbs that hold one half"
        pinion, origin = a["pinion"], draft.origins["pinion"]
        shape = _Row("platform.direction_deg", "90", note=across, source=ASSUMED)
        ratio = _Row(
            "platform.ratio",
            number(_product(0.5, 1 / pinion)),
            ("pinion",),
            f"rad/m, of a pinion of {number(pinion)} m",
            f"by the pinion's radius, {origin}",
        )
    else:
        length = "half_length" if platform == "h4" else "length"
        shape = _Row.answer(draft, f"platform.{length}", "bar", "m")
        ratio = _Row.answer(draft, "platform.ratio", "ratio")
    turn = number(a["tool_turn"])
    return [
        _Row("platform"),
        _Row("platform.kind", platform),
        shape,
        _Row("platform.first", "[1, 3]" if platform == "h4" else "[1, 2]", source=ASSUMED),
        ratio,
        _Row("platform.angle_deg", f"[-{turn}, {turn}]", ("tool_turn",)),
        _Row.answer(draft, "platform.speed_deg_s", "tool_speed"),
    ]


def _bodies(draft: Draft) -> list[_Row]:
    shapes = "solids of the right mass; shapes are assumed: better ones are worth minutes"
    rows = [_Row("bodies", note=shapes)]
    for body in bodies(draft.kind, draft.values):
        origin, length = draft.origins[body.mass], {"U": "arm", "S": "strut"}.get(body.name)
        how = f"; {_HOW[body.mass]}" if origin == ASSUMED else ""
        long = f", length {draft.origins[length]}" if length else ""
        row = _Row(
            f"bodies.{body.name}",
            note=f"{body.comment}; mass: {origin}{how}",
            source=f"mass {origin}{long}; shape {ASSUMED}",
            below=f"    prior:\n      - {body.shape}\n    free: {body.free}",
        )
        rows.append(row)
    return rows


def _friction(draft: Draft) -> list[_Row]:
    a, rail = draft.values, "rail_" if draft.kind in LINEAR else ""
    keys = f"{rail}viscous", f"{rail}coulomb"
    law = f"{{viscous: {number(a[keys[0]])}, coulomb: {number(a[keys[1]])}}}"
    first = _Row("friction.drive1", law, keys)
    rows = [_Row("friction", note="N s/m and N" if rail else "N m s/rad and N m"), first]
    rows += _other_drives(draft, first)
    weight = GRAVITY * (a["platform_mass"] + a.get("tool_mass", 0.0))
    if draft.kind in TELESCOPE:
        coulomb = rounded(0.08 * a["tool_torque"])
        others = {
            "drive4": (coulomb / 16, coulomb, ASSUMED),
            "slide": (0.3 * weight, 0.4 * weight, "N s/m and N, telescope; assumed"),
        }
    elif platform_of(draft.kind) == "i4":
        others = {"platform": (0.3 * weight, 0.3 * weight, "N s/m and N; assumed")}
    elif platform_of(draft.kind) != "rigid":
        coulomb = 0.25 * weight * a["bar"]
        others = {"platform": (coulomb / 6, coulomb, "of the bar's joints; assumed")}
    else:
        others = {}
    for joint, (viscous, coulomb, note) in others.items():
        law = f"{{viscous: {number(rounded(viscous))}, coulomb: {number(rounded(coulomb))}}}"
        rows.append(_Row(f"friction.{joint}", law, note=note, source=ASSUMED))
    return rows


def _rotors(draft: Draft) -> list[_Row]:
    if draft.kind in LINEAR:
        value, keys, note = draft.values["rotor_mass"], ("rotor_mass",), "kg"
    else:
        rotor, gear = draft.values["rotor"], draft.values["gear"]
        value, keys = _product(rotor, gear**2), ("rotor", "gear")
        note = f"kg m², {number(rotor)} times {number(gear)}²"
    first = _Row("rotor_inertia.drive1", number(value), keys, note)
    turning = draft.kind in TELESCOPE
    return [
        _Row("rotor_inertia", note="of motor and gear, referred to the joint"),
        first,
        *_other_drives(draft, first),
        *([_Row.answer(draft, "rotor_inertia.drive4", "tool_rotor", "kg m²")] if turning else []),
    ]


def _limits(draft: Draft) -> list[_Row]:
    a = draft.values
    if draft.kind in LINEAR:
        keys = ("rail_low", "rail_high", "rail_speed", "rail_force")
        names, values = ("position", "speed", "force"), [a[key] for key in keys]
    else:
        keys = ("angle_low", "angle_high", "speed", "torque", "gear")
        names = ("angle_deg", "speed_deg_s", "torque")
        speed, torque = _product(a["speed"], 1 / a["gear"]), _product(a["torque"], a["gear"])
        values = [a["angle_low"], a["angle_high"], speed, torque]
    low, high, speed, effort = map(number, values)
    limits = f"{{{names[0]}: [{low}, {high}], {names[1]}: {speed}, {names[2]}: {effort}}}"
    said = [f"{key.replace('_', ' ')} {draft.origins[key]}" for key in keys if key != "gear"]
    singular = "assumed: how near to a singularity motions may come"
    turning = []
    if draft.kind in TELESCOPE:
        of_tool = "tool_speed", "tool_torque"
        rest = "{{speed_deg_s: {}, torque: {}}}".format(*(number(a[key]) for key in of_tool))
        turning = [_Row("drive_limits.drive4", rest, of_tool)]
    return [
        _Row("workspace", source=_together(draft, ("radius", "low", "high"))),
        _Row("workspace.shape", "cylinder"),
        _Row.answer(draft, "workspace.radius", "radius", "m"),
        _Row("workspace.z", f"[{number(a['low'])}, {number(a['high'])}]", ("low", "high")),
        _Row("drive_limits", below=f"  # {', '.join(said)}"),
        *(
            _Row(f"drive_limits.drive{i + 1}", limits, source=_together(draft, keys))
            for i in range(limbs_of(draft.kind))
        ),
        *turning,
        _Row.answer(draft, "platform_speed", "top_speed", "m/s"),
        _Row.answer(draft, "platform_acceleration", "top_acceleration", "m/s²"),
        _Row.answer(draft, "strut_swing_deg", "swing"),
        _Row("largest_condition", "5", note=singular, source=ASSUMED),
    ]
