"""Text of a draft: a description in YAML with a comment on every number, and its sources.

`_KEYS` lists all keys in their order, as `questions.py` lists the questions.
"""

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

from deltaid.levels import GRAVITY
from deltaid.studio.drafting.bodies import bodies, stroke
from deltaid.studio.drafting.draft import ASSUMED, Draft
from deltaid.studio.drafting.questions import (
    ALL,
    ARTICULATED,
    BAR,
    H4,
    LINEAR,
    QUESTIONS,
    ROTARY,
    ROUND,
    SLIDE,
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


@dataclass(frozen=True)
class _Key:
    """One key of the description; texts in braces stand for entries of `_texts`.

    Attributes:
        path: of the key; `drive*` stands for the drives of all limbs, of which the first has the
            comment.
        value: as YAML; empty at the beginning of a part, whose source then holds for all its keys.
        questions: whose answers it is computed from; the comment states their origin and, if they
            are assumed, where to find them.
        note: begins the comment.
        source: its origin, if that is not the origin of the answers.
        of: kinds of robots that have it.
        below: lines that follow.
        has_comment: whether the origin of the answers is in a comment.
    """

    path: str
    value: str = ""
    questions: tuple[str, ...] = ()
    note: str = ""
    source: str = ""
    of: frozenset[str] = ALL
    below: str = ""
    has_comment: bool = True


def _answer(path: str, question: str, note: str = "", of: frozenset[str] = ALL) -> _Key:
    """A key whose value is the answer to one question."""
    return _Key(path, f"{{{question}}}", (question,), note, of=of)


def _friction(path: str, law: str, note: str, of: frozenset[str]) -> _Key:
    """Assumed friction of a joint that no question is about."""
    value = f"{{{{viscous: {{{law}_viscous}}, coulomb: {{{law}_coulomb}}}}}}"
    return _Key(path, value, note=note, source=ASSUMED, of=of)


_ARM_LIMITS = "angle_low", "angle_high", "speed", "torque", "gear"
_RAIL_LIMITS = "rail_low", "rail_high", "rail_speed", "rail_force"
_KEYS = (
    _Key("limbs"),
    _Key("limbs.drive", "rotary", of=ROTARY),
    _Key("limbs.drive", "linear", of=LINEAR),
    _Key("limbs.azimuth_deg", "{azimuths}", (), "assumed: world axes are laid that way", ASSUMED),
    _answer("limbs.tilt_deg", "tilt", "0 upright, 90 flat, negative if lower ends lean inwards",
            LINEAR),
    _Key("limbs.base_points", "{base_points}", ("base_radius",), "m, from base_radius", of=H4),
    _Key("limbs.platform_points", "{platform_points}", (), "m; assumed",
         "assumed, by the length of the middle bar", H4),
    _answer("limbs.base_radius", "base_radius", "m", ROUND),
    _answer("limbs.platform_radius", "platform_radius", "m", ROUND),
    _answer("limbs.upper_arm", "arm", "m, axis to elbow", ROTARY),
    _answer("limbs.strut", "strut", "m, between joints"),
    _Key("limbs.struts_per_limb", "2", source=ASSUMED),
    _answer("limbs.strut_spacing", "spacing", "m; forces in single struts depend on it"),
    _Key("telescope", source=ASSUMED, of=TELESCOPE),
    _Key("telescope.base_joint", "[0, 0, 0]", (), "m; assumed in the middle of base and platform",
         of=TELESCOPE),
    _Key("telescope.platform_joint", "[0, 0, 0]", of=TELESCOPE),
    _Key("telescope.stroke", "[{stroke_low}, {stroke_high}]", (),
         "m; assumed, what the workspace takes", of=TELESCOPE),
    _Key("platform", of=ARTICULATED),
    _Key("platform.kind", "{platform}", of=ARTICULATED),
    _Key("platform.direction_deg", "90", (),
         "the slide lies across the limbs that hold one half", ASSUMED, SLIDE),
    _answer("platform.half_length", "bar", "m", H4),
    _answer("platform.length", "bar", "m", BAR - H4),
    _Key("platform.first", "[1, 3]", source=ASSUMED, of=H4),
    _Key("platform.first", "[1, 2]", source=ASSUMED, of=ARTICULATED - H4),
    _Key("platform.ratio", "{pinion_ratio}", ("pinion",), "rad/m, of a pinion of {pinion} m",
         "by the pinion's radius, {pinion_origin}", SLIDE),
    _answer("platform.ratio", "ratio", of=BAR),
    _Key("platform.angle_deg", "[-{tool_turn}, {tool_turn}]", ("tool_turn",), of=ARTICULATED),
    _answer("platform.speed_deg_s", "tool_speed", of=ARTICULATED),
    _Key("bodies",
         note="solids of the right mass; shapes are assumed: better ones are worth minutes"),
    _Key("friction", note="N m s/rad and N m", of=ROTARY),
    _Key("friction", note="N s/m and N", of=LINEAR),
    _Key("friction.drive*", "{{viscous: {viscous}, coulomb: {coulomb}}}", ("viscous", "coulomb"),
         of=ROTARY),
    _Key("friction.drive*", "{{viscous: {rail_viscous}, coulomb: {rail_coulomb}}}",
         ("rail_viscous", "rail_coulomb"), of=LINEAR),
    _friction("friction.drive4", "tool", ASSUMED, TELESCOPE),
    _friction("friction.slide", "slide", "N s/m and N, telescope; assumed", TELESCOPE),
    _friction("friction.platform", "platform", "N s/m and N; assumed", SLIDE),
    _friction("friction.platform", "platform", "of the bar's joints; assumed", BAR),
    _Key("rotor_inertia", note="of motor and gear, referred to the joint"),
    _Key("rotor_inertia.drive*", "{joint_rotor}", ("rotor", "gear"),
         "kg m², {rotor} times {gear}²", of=ROTARY),
    _answer("rotor_inertia.drive*", "rotor_mass", "kg", LINEAR),
    _answer("rotor_inertia.drive4", "tool_rotor", "kg m²", TELESCOPE),
    _Key("workspace", source="{workspace_origin}"),
    _Key("workspace.shape", "cylinder"),
    _answer("workspace.radius", "radius", "m"),
    _Key("workspace.z", "[{low}, {high}]", ("low", "high")),
    _Key("drive_limits", below="  # {limit_origins}"),
    _Key("drive_limits.drive*",
         "{{angle_deg: [{angle_low}, {angle_high}], speed_deg_s: {joint_speed}, "
         "torque: {joint_torque}}}", _ARM_LIMITS, of=ROTARY, has_comment=False),
    _Key("drive_limits.drive*",
         "{{position: [{rail_low}, {rail_high}], speed: {rail_speed}, force: {rail_force}}}",
         _RAIL_LIMITS, of=LINEAR, has_comment=False),
    _Key("drive_limits.drive4", "{{speed_deg_s: {tool_speed}, torque: {tool_torque}}}",
         ("tool_speed", "tool_torque"), of=TELESCOPE),
    _answer("platform_speed", "top_speed", "m/s"),
    _answer("platform_acceleration", "top_acceleration", "m/s²"),
    _answer("strut_swing_deg", "swing"),
    _Key("largest_condition", "5", (), "assumed: how near to a singularity motions may come",
         ASSUMED),
)  # fmt: skip


def written(draft: Draft) -> str:
    """The description as YAML; all questions of its kind must have answers."""
    lines, sources = [f"name: {_scalar(draft.name)}", f"title: {_scalar(draft.title)}"], {}
    texts = _texts(draft)
    for key in _keys(draft):
        value, note, below, source = (
            text.format_map(texts) for text in (key.value, key.note, key.below, key.source)
        )
        comment = "; ".join(filter(None, (note, _origin(draft, key))))
        lines += [""] if not value and "." not in key.path else []
        line = f"{key.path.rpartition('.')[2]}: {value}".rstrip()
        line = f"{'  ' * key.path.count('.')}{line}{f' # {comment}' if comment else ''}"
        lines += [line, *([below] if below else [])]
        source = source or _together(draft, key.questions)
        if source and key.path.partition(".")[0] not in sources:
            sources[key.path] = source
    merged = _with_merged_drives(sources).items()
    lines += ["", "sources:", *(f"  {path}: {_scalar(source)}" for path, source in merged)]
    return _HEAD + "".join(f"{line}\n" for line in lines)


def _keys(draft: Draft) -> Iterator[_Key]:
    """Keys of the draft's kind, with each limb's drive and each body."""
    for key in _KEYS:
        if draft.kind not in key.of:
            continue
        if key.path.endswith("*"):
            for i in range(1, limbs_of(draft.kind) + 1):
                drive = replace(key, path=f"{key.path[:-1]}{i}")
                yield drive if i == 1 else replace(drive, note="", has_comment=False)
        else:
            yield key
        if key.path == "bodies":
            yield from _body_keys(draft)


def _body_keys(draft: Draft) -> Iterator[_Key]:
    for body in bodies(draft.kind):
        mass, length = f"{{{body.mass}_origin}}", {"U": "arm", "S": "strut"}.get(body.name)
        how = f"; {_HOW[body.mass]}" if draft.origins[body.mass] == ASSUMED else ""
        long = f", length {{{length}_origin}}" if length else ""
        yield _Key(
            f"bodies.{body.name}",
            note=f"{body.comment}; mass: {mass}{how}",
            source=f"mass {mass}{long}; shape {ASSUMED}",
            below=f"    prior:\n      - {{shape_{body.name}}}\n    free: {body.free}",
        )


def _origin(draft: Draft, key: _Key) -> str:
    """Origin of a key's answers and, if one is assumed, where to find it."""
    origins = [draft.origins[question] for question in key.questions if key.has_comment]
    if ASSUMED in origins:
        return f"{ASSUMED}; {_HOW[key.questions[origins.index(ASSUMED)]]}"
    return origins[0] if origins else ""


def _together(draft: Draft, questions: Iterable[str]) -> str:
    """The common origin of some answers, or each origin with its answer's name."""
    origins = {key: draft.origins[key] for key in questions}
    if len(set(origins.values())) == 1:
        return next(iter(origins.values()))
    return ", ".join(f"{key.replace('_', ' ')} {origin}" for key, origin in origins.items())


def _texts(draft: Draft) -> dict[str, str]:
    """Answers, what follows from them, and origins, as the text of a description has them."""
    kind, a, platform = draft.kind, draft.values, platform_of(draft.kind)
    limits = _RAIL_LIMITS if kind in LINEAR else _ARM_LIMITS
    origins = [f"{key.replace('_', ' ')} {draft.origins[key]}" for key in limits if key != "gear"]
    return {
        **{key: number(value) for key, value in {**a, **_following(kind, a)}.items()},
        **{f"{key}_origin": origin for key, origin in draft.origins.items()},
        **{f"shape_{body.name}": body.shape(a) for body in bodies(kind)},
        **(_h4_points(a) if kind in H4 else {}),
        "platform": platform,
        "azimuths": _AZIMUTHS[platform],
        "workspace_origin": _together(draft, ("radius", "low", "high")),
        "limit_origins": ", ".join(origins),
    }


def _following(kind: str, a: Mapping[str, float]) -> dict[str, float]:
    """Numbers behind the gears, the telescope's stroke, and friction that no question is about."""
    values, weight = dict[str, float](), GRAVITY * (a["platform_mass"] + a.get("tool_mass", 0.0))
    if kind in ROTARY:
        values["joint_rotor"] = rounded(a["rotor"] * a["gear"] ** 2, 12)
        values["joint_speed"] = rounded(a["speed"] / a["gear"], 12)
        values["joint_torque"] = rounded(a["torque"] * a["gear"], 12)
    laws = dict[str, tuple[float, float]]()
    if kind in TELESCOPE:
        values["stroke_low"], values["stroke_high"] = stroke(a)
        coulomb = rounded(0.08 * a["tool_torque"])
        laws = {"tool": (coulomb / 16, coulomb), "slide": (0.3 * weight, 0.4 * weight)}
    elif kind in SLIDE:
        values["pinion_ratio"] = rounded(0.5 / a["pinion"], 12)
        laws = {"platform": (0.3 * weight, 0.3 * weight)}
    elif kind in BAR:
        coulomb = 0.25 * weight * a["bar"]
        laws = {"platform": (coulomb / 6, coulomb)}
    for joint, (viscous, coulomb) in laws.items():
        values |= {f"{joint}_viscous": rounded(viscous), f"{joint}_coulomb": rounded(coulomb)}
    return values


def _h4_points(a: Mapping[str, float]) -> dict[str, str]:
    """Base and platform points of an H4 with the proportions of the prototype [m]."""
    R, h = a["base_radius"], a["bar"]
    base = [[R, 0.0], [-R, 0.0], [0.35 * R, -R], [-0.35 * R, -R]]
    platform = [[h / 6, -h / 3], [-h / 6, -h / 3], [-2 * h / 3, h / 3], [2 * h / 3, h / 3]]
    return {"base_points": _list(base), "platform_points": _list(platform)}


def _list(points: list[list[float]]) -> str:
    """Points in a plane as YAML, at height zero."""
    pairs = (f"[{number(rounded(x, 6))}, {number(rounded(y, 6))}, 0]" for x, y in points)
    return f"[{', '.join(pairs)}]"


def number(value: float) -> str:
    """A number in full precision."""
    return str(int(value)) if value == int(value) and abs(value) < 1e6 else repr(float(value))


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
