"""A draft written as a description: YAML with a comment beside every number, and its sources."""

import json
import re
from collections.abc import Mapping

from deltaid.studio.drafting.bodies import bodies, stroke
from deltaid.studio.drafting.draft import ASSUMED, Draft
from deltaid.studio.drafting.questions import (
    GRAVITY,
    QUESTIONS,
    has_telescope,
    is_linear,
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
# How near to a singularity motions of a new robot may come.
_CONDITION = 5
# Letters first, and no word that YAML reads as something else.
_PLAIN = re.compile(
    r"(?!(?:true|false|null|yes|no|on|off|y|n)$)[A-Za-z][\w ,;.'()/+-]*", re.IGNORECASE
)
_AZIMUTHS = {
    "rigid": "[0, 120, 240]", "h4": "[15, 165, 270, 270]",
    "i4": "[45, -45, 135, -135]", "par4": "[45, -45, 135, -135]",
}  # fmt: skip
_HOW = {question.key: question.how for question in QUESTIONS}


class _Description:
    """A description line by line, and where its numbers come from, by the paths of their keys."""

    def __init__(self, draft: Draft) -> None:
        self.draft, self.kind, self.a = draft, draft.kind, draft.values
        self.lines = [f"name: {_scalar(draft.name)}", f"title: {_scalar(draft.title)}"]
        self.sources: dict[str, str] = {}

    def part(self, key: str, comment: str = "", source: str = "") -> None:
        """Begin a part; its source, if it is given, holds for all of its keys."""
        self.lines += ["", f"{key}:{comment and f' # {comment}'}"]
        if source:
            self.sources[key] = source

    def put(self, path: str, value: str, *questions: str, note: str = "", source: str = "") -> None:
        """One key with its value.

        Args:
            path: of the key.
            value: as YAML.
            questions: whose answers it is made of; the comment says where they come from, and how
                to find out what is assumed.
            note: begins the comment.
            source: where it comes from, if that is not where the answers come from.
        """
        origins = [self.draft.origins[key] for key in questions]
        comment = [note] if note else []
        if ASSUMED in origins:
            comment.append(f"{ASSUMED}; {_HOW[questions[origins.index(ASSUMED)]]}")
        elif origins:
            comment.append(origins[0])
        line = f"{path.rpartition('.')[2]}: {value}" + (
            f" # {'; '.join(comment)}" if comment else ""
        )
        self.lines.append("  " * path.count(".") + line)
        said = source or (self.together(*questions) if questions else "")
        if said and path.partition(".")[0] not in self.sources:
            self.sources[path] = said

    def answer(self, path: str, question: str, unit: str = "") -> None:
        """One key with the answer to one question."""
        self.put(path, number(self.a[question]), question, note=unit)

    def each_drive(self, part: str, value: str, source: str) -> None:
        """The same for the drives of all limbs that have none yet."""
        for i in range(limbs_of(self.kind)):
            if f"{part}.drive{i + 1}" not in self.sources:
                self.put(f"{part}.drive{i + 1}", value, source=source)

    def together(self, *questions: str) -> str:
        """One word if all answers come from one place, or each by its name."""
        origins = [self.draft.origins[key] for key in questions]
        if len(set(origins)) == 1:
            return origins[0]
        return ", ".join(
            f"{key.replace('_', ' ')} {origin}"
            for key, origin in zip(questions, origins, strict=True)
        )


def number(value: float) -> str:
    """A number with every bit."""
    return str(int(value)) if value == int(value) and abs(value) < 1e6 else repr(float(value))


def _product(a: float, b: float) -> float:
    """Without the last bits, which only rounding made: 0.4 times 3 is 1.2."""
    return float(f"{a * b:.12g}")


def _scalar(text: str) -> str:
    """Text of one line: plain words as they are, all else between quotes."""
    return text if _PLAIN.fullmatch(text) else json.dumps(text, ensure_ascii=not text.isprintable())


def written(draft: Draft) -> str:
    """The description as YAML; all questions of its kind must have answers."""
    d = _Description(draft)
    for chapter in (_limbs, _telescope, _platform, _bodies, _friction, _rotors, _limits):
        chapter(d)
    d.lines += ["", "sources:"]
    d.lines += [f"  {path}: {_scalar(source)}" for path, source in _once(d.sources).items()]
    return _HEAD + "".join(f"{line}\n" for line in d.lines)


def _once(sources: Mapping[str, str]) -> dict[str, str]:
    said = dict(sources)
    for part in ("friction", "rotor_inertia", "drive_limits"):
        own = [key for key in said if key.startswith(f"{part}.")]
        if len({said[key] for key in own}) == 1:
            said[part] = said[own[0]]
            said = {key: text for key, text in said.items() if key not in own}
    return said


def _limbs(d: _Description) -> None:
    platform, rail = platform_of(d.kind), is_linear(d.kind)
    d.part("limbs")
    d.put("limbs.drive", "linear" if rail else "rotary")
    d.put(
        "limbs.azimuth_deg",
        _AZIMUTHS[platform],
        note="assumed: world axes are laid that way",
        source=ASSUMED,
    )
    if rail:
        d.answer("limbs.tilt_deg", "tilt", "0 upright, 90 flat")
    if platform == "h4":
        base, own = _h4_points(d.a)
        d.put("limbs.base_points", _list(base), "base_radius", note="m, from base_radius")
        source = f"{ASSUMED}, by the length of the middle bar"
        d.put("limbs.platform_points", _list(own), note="m; assumed", source=source)
    else:
        d.answer("limbs.base_radius", "base_radius", "m")
        d.answer("limbs.platform_radius", "platform_radius", "m")
    if not rail:
        d.answer("limbs.upper_arm", "arm", "m, axis to elbow")
    d.answer("limbs.strut", "strut", "m, between joints")
    d.put("limbs.struts_per_limb", "2", source=ASSUMED)
    d.answer("limbs.strut_spacing", "spacing", "m; forces in single struts depend on it")


def _h4_points(a: Mapping[str, float]) -> tuple[list[list[float]], list[list[float]]]:
    """Base and platform points of an H4 near the prototype's arrangement [m]."""
    R, h = a["base_radius"], a["bar"]
    base = [[R, 0.0], [-R, 0.0], [0.35 * R, -R], [-0.35 * R, -R]]
    own = [[h / 6, -h / 3], [-h / 6, -h / 3], [-2 * h / 3, h / 3], [2 * h / 3, h / 3]]
    return tuple([[*(rounded(x, 6) for x in p), 0.0] for p in points] for points in (base, own))  # pyright: ignore


def _list(points: list[list[float]]) -> str:
    return "[" + ", ".join("[" + ", ".join(map(number, p)) + "]" for p in points) + "]"


def _telescope(d: _Description) -> None:
    if not has_telescope(d.kind):
        return
    low, high = stroke(d.a)
    d.part("telescope", source=ASSUMED)
    d.put("telescope.base_joint", "[0, 0, 0]", note="m; assumed in the middle of base and platform")
    d.put("telescope.platform_joint", "[0, 0, 0]")
    ends = f"[{number(low)}, {number(high)}]"
    d.put("telescope.stroke", ends, note="m; assumed, what the workspace takes")


def _platform(d: _Description) -> None:
    platform, a = platform_of(d.kind), d.a
    if platform == "rigid":
        return
    d.part("platform")
    d.put("platform.kind", platform)
    if platform == "i4":
        across = "the slide lies across the limbs that hold one half"
        d.put("platform.direction_deg", "90", note=across, source=ASSUMED)
    else:
        d.answer(f"platform.{'half_length' if platform == 'h4' else 'length'}", "bar", "m")
    d.put("platform.first", "[1, 3]" if platform == "h4" else "[1, 2]", source=ASSUMED)
    if platform == "i4":
        d.put(
            "platform.ratio",
            number(_product(0.5, 1 / a["pinion"])),
            "pinion",
            note=f"rad/m, of a pinion of {number(a['pinion'])} m",
            source=f"by the pinion's radius, {d.draft.origins['pinion']}",
        )
    else:
        d.answer("platform.ratio", "ratio")
    turn = number(a["tool_turn"])
    d.put("platform.angle_deg", f"[-{turn}, {turn}]", "tool_turn")
    d.answer("platform.speed_deg_s", "tool_speed")


def _bodies(d: _Description) -> None:
    d.part("bodies", "solids of the right mass; shapes are assumed: better ones are worth minutes")
    for body in bodies(d.kind, d.a):
        origin, length = d.draft.origins[body.mass], {"U": "arm", "S": "strut"}.get(body.name)
        how = f"; {_HOW[body.mass]}" if origin == ASSUMED else ""
        d.lines += [
            f"  {body.name}: # {body.comment}; mass: {origin}{how}",
            "    prior:",
            f"      - {body.shape}",
            f"    free: {body.free}",
        ]
        long = f", length {d.draft.origins[length]}" if length else ""
        d.sources[f"bodies.{body.name}"] = f"mass {origin}{long}; shape {ASSUMED}"


def _friction(d: _Description) -> None:
    a, rail = d.a, "rail_" if is_linear(d.kind) else ""
    keys = f"{rail}viscous", f"{rail}coulomb"
    law = f"{{viscous: {number(a[keys[0]])}, coulomb: {number(a[keys[1]])}}}"
    d.part("friction", "N s/m and N" if rail else "N m s/rad and N m")
    d.put("friction.drive1", law, *keys)
    d.each_drive("friction", law, d.together(*keys))
    weight = GRAVITY * (a["platform_mass"] + a.get("tool_mass", 0.0))
    if has_telescope(d.kind):
        coulomb = rounded(0.08 * a["tool_torque"])
        d.put("friction.drive4", _law(coulomb / 16, coulomb), note=ASSUMED, source=ASSUMED)
        slide = "N s/m and N, telescope; assumed"
        d.put("friction.slide", _law(0.3 * weight, 0.4 * weight), note=slide, source=ASSUMED)
    elif platform_of(d.kind) == "i4":
        law, note = _law(0.3 * weight, 0.3 * weight), "N s/m and N; assumed"
        d.put("friction.platform", law, note=note, source=ASSUMED)
    elif platform_of(d.kind) != "rigid":
        coulomb = 0.25 * weight * a["bar"]
        law, note = _law(coulomb / 6, coulomb), "of the bar's joints; assumed"
        d.put("friction.platform", law, note=note, source=ASSUMED)


def _law(viscous: float, coulomb: float) -> str:
    return f"{{viscous: {number(rounded(viscous))}, coulomb: {number(rounded(coulomb))}}}"


def _rotors(d: _Description) -> None:
    d.part("rotor_inertia", "of motor and gear, referred to the joint")
    if is_linear(d.kind):
        value, keys, note = d.a["rotor_mass"], ("rotor_mass",), "kg"
    else:
        rotor, gear = d.a["rotor"], d.a["gear"]
        value, keys = _product(rotor, gear**2), ("rotor", "gear")
        note = f"kg m², {number(rotor)} times {number(gear)}²"
    d.put("rotor_inertia.drive1", number(value), *keys, note=note)
    d.each_drive("rotor_inertia", number(value), d.together(*keys))
    if has_telescope(d.kind):
        d.answer("rotor_inertia.drive4", "tool_rotor", "kg m²")


def _limits(d: _Description) -> None:
    a = d.a
    d.part("workspace", source=d.together("radius", "low", "high"))
    d.put("workspace.shape", "cylinder")
    d.answer("workspace.radius", "radius", "m")
    d.put("workspace.z", f"[{number(a['low'])}, {number(a['high'])}]", "low", "high")
    if is_linear(d.kind):
        keys = ("rail_low", "rail_high", "rail_speed", "rail_force")
        names, values = ("position", "speed", "force"), [a[key] for key in keys]
    else:
        keys = ("angle_low", "angle_high", "speed", "torque", "gear")
        names = ("angle_deg", "speed_deg_s", "torque")
        speed, torque = _product(a["speed"], 1 / a["gear"]), _product(a["torque"], a["gear"])
        values = [a["angle_low"], a["angle_high"], speed, torque]
    low, high, speed, effort = map(number, values)
    limits = f"{{{names[0]}: [{low}, {high}], {names[1]}: {speed}, {names[2]}: {effort}}}"
    said = [f"{key.replace('_', ' ')} {d.draft.origins[key]}" for key in keys if key != "gear"]
    d.part("drive_limits")
    d.lines.append(f"  # {', '.join(said)}")
    d.each_drive("drive_limits", limits, d.together(*keys))
    if has_telescope(d.kind):
        rest = f"{{speed_deg_s: {number(a['tool_speed'])}, torque: {number(a['tool_torque'])}}}"
        d.put("drive_limits.drive4", rest, "tool_speed", "tool_torque")
    d.answer("platform_speed", "top_speed", "m/s")
    d.answer("platform_acceleration", "top_acceleration", "m/s²")
    d.answer("strut_swing_deg", "swing")
    singular = "assumed: how near to a singularity motions may come"
    d.put("largest_condition", str(_CONDITION), note=singular, source=ASSUMED)
