"""A draft written as a description: YAML with a comment beside every number."""

import json
import re
from collections.abc import Iterator, Mapping

from deltaid.studio.drafting.bodies import bodies, stroke
from deltaid.studio.drafting.draft import ASSUMED, Draft
from deltaid.studio.drafting.guesses import GRAVITY, rounded
from deltaid.studio.drafting.kinds import (
    has_telescope,
    is_linear,
    limbs_of,
    platform_of,
)
from deltaid.studio.drafting.questions import QUESTIONS
from deltaid.studio.drafting.sources import sources

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


class _Writer:
    """Lines of a draft."""

    def __init__(self, draft: Draft) -> None:
        self.draft, self.a = draft, draft.values

    def note(self, *keys: str) -> str:
        """A comment that says where numbers come from, and how to find out what is assumed."""
        own = [self.draft.origins[key] for key in keys]
        if ASSUMED in own:
            return f" # assumed; {_HOW[keys[own.index(ASSUMED)]]}"
        return f" # {own[0]}"

    def line(self, path: str, key: str, unit: str, question: str) -> str:
        """One key with the answer to one question."""
        value = number(self.a[question])
        comment = self.note(question).replace("# ", f"# {unit}; " if unit else "# ", 1)
        return f"{path}{key}: {value}{comment}"


def number(value: float) -> str:
    """A number with every bit."""
    return str(int(value)) if value == int(value) and abs(value) < 1e6 else repr(float(value))


def product(a: float, b: float) -> float:
    """Without the last bits, which only rounding made: 0.4 times 3 is 1.2."""
    return float(f"{a * b:.12g}")


def scalar(text: str) -> str:
    """Text of one line: plain words as they are, all else between quotes."""
    return text if _PLAIN.fullmatch(text) else json.dumps(text, ensure_ascii=not text.isprintable())


def written(draft: Draft) -> str:
    """The description as YAML; all questions of its kind must have answers."""
    writer = _Writer(draft)
    head = f"name: {scalar(draft.name)}\ntitle: {scalar(draft.title)}\n"
    parts = (
        _limbs(writer), _platform(writer), _bodies(writer), _friction(writer), _rotors(writer),
        _limits(writer), _sources(writer),
    )  # fmt: skip
    return (
        _HEAD + head + "".join("\n" + "\n".join(part) + "\n" for part in map(list, parts) if part)
    )


def _limbs(w: _Writer) -> Iterator[str]:
    kind, platform = w.draft.kind, platform_of(w.draft.kind)
    yield "limbs:"
    yield f"  drive: {'linear' if is_linear(kind) else 'rotary'}"
    yield f"  azimuth_deg: {_AZIMUTHS[platform]} # assumed: world axes are laid that way"
    if is_linear(kind):
        yield w.line("  ", "tilt_deg", "0 upright, 90 flat", "tilt")
    if platform == "h4":
        yield from _points_of_h4(w)
    else:
        yield w.line("  ", "base_radius", "m", "base_radius")
        yield w.line("  ", "platform_radius", "m", "platform_radius")
    if not is_linear(kind):
        yield w.line("  ", "upper_arm", "m, axis to elbow", "arm")
    yield w.line("  ", "strut", "m, between joints", "strut")
    yield "  struts_per_limb: 2"
    yield w.line("  ", "strut_spacing", "m; forces in single struts depend on it", "spacing")


def h4_points(a: Mapping[str, float]) -> tuple[list[list[float]], list[list[float]]]:
    """Base and platform points of an H4 near the prototype's arrangement [m]."""
    R, h = a["base_radius"], a["bar"]
    base = [[R, 0.0], [-R, 0.0], [0.35 * R, -R], [-0.35 * R, -R]]
    own = [[h / 6, -h / 3], [-h / 6, -h / 3], [-2 * h / 3, h / 3], [2 * h / 3, h / 3]]
    return tuple([[*(rounded(x, 6) for x in p), 0.0] for p in points] for points in (base, own))  # pyright: ignore


def _points_of_h4(w: _Writer) -> Iterator[str]:
    base, own = h4_points(w.a)
    note = w.note("base_radius").replace("# ", "# m, from base_radius; ", 1)
    yield f"  base_points: {_list(base)}{note}"
    yield f"  platform_points: {_list(own)} # m; assumed"


def _list(points: list[list[float]]) -> str:
    return "[" + ", ".join("[" + ", ".join(map(number, p)) + "]" for p in points) + "]"


def _platform(w: _Writer) -> Iterator[str]:
    platform, a = platform_of(w.draft.kind), w.a
    if has_telescope(w.draft.kind):
        low, high = stroke(a)
        yield "telescope:"
        yield "  base_joint: [0, 0, 0] # m; assumed in the middle of base and platform"
        yield "  platform_joint: [0, 0, 0]"
        yield f"  stroke: [{number(low)}, {number(high)}] # m; assumed, what the workspace takes"
    if platform == "rigid":
        return
    yield "platform:"
    yield f"  kind: {platform}"
    if platform == "i4":
        yield "  direction_deg: 90 # the slide lies across the limbs that hold one half"
        yield "  first: [1, 2]"
        note = w.note("pinion").replace("# ", f"# rad/m, of a pinion of {number(a['pinion'])} m; ")
        yield f"  ratio: {number(product(0.5, 1 / a['pinion']))}{note}"
    else:
        key = "half_length" if platform == "h4" else "length"
        yield w.line("  ", key, "m", "bar")
        yield f"  first: {'[1, 3]' if platform == 'h4' else '[1, 2]'}"
        yield w.line("  ", "ratio", "", "ratio")
    turn = number(a["tool_turn"])
    yield f"  angle_deg: [-{turn}, {turn}]{w.note('tool_turn')}"
    yield w.line("  ", "speed_deg_s", "", "tool_speed")


def _bodies(w: _Writer) -> Iterator[str]:
    yield "bodies: # solids of the right mass; shapes are assumed: better ones are worth minutes"
    for body in bodies(w.draft.kind, w.a):
        yield f"  {body.name}: # {body.comment}; mass:{w.note(body.mass)[2:]}"
        yield "    prior:"
        yield f"      - {body.shape}"
        yield f"    free: {body.free}"


def _friction(w: _Writer) -> Iterator[str]:
    kind, a = w.draft.kind, w.a
    rail = "rail_" if is_linear(kind) else ""
    keys = f"{rail}viscous", f"{rail}coulomb"
    law = f"{{viscous: {number(a[keys[0]])}, coulomb: {number(a[keys[1]])}}}"
    yield f"friction: # {'N s/m and N' if rail else 'N m s/rad and N m'}"
    for i in range(limbs_of(kind)):
        yield f"  drive{i + 1}: {law}{w.note(*keys) if i == 0 else ''}"
    weight = GRAVITY * (a["platform_mass"] + a.get("tool_mass", 0.0))
    if has_telescope(kind):
        coulomb = rounded(0.08 * a["tool_torque"])
        yield f"  drive4: {_law(coulomb / 16, coulomb)} # assumed"
        yield f"  slide: {_law(0.3 * weight, 0.4 * weight)} # N s/m and N, telescope; assumed"
    elif platform_of(kind) == "i4":
        yield f"  platform: {_law(0.3 * weight, 0.3 * weight)} # N s/m and N; assumed"
    elif platform_of(kind) != "rigid":
        coulomb = 0.25 * weight * a["bar"]
        yield f"  platform: {_law(coulomb / 6, coulomb)} # of the bar's joints; assumed"


def _law(viscous: float, coulomb: float) -> str:
    return f"{{viscous: {number(rounded(viscous))}, coulomb: {number(rounded(coulomb))}}}"


def _rotors(w: _Writer) -> Iterator[str]:
    kind, a = w.draft.kind, w.a
    yield "rotor_inertia: # of motor and gear, seen from the joint"
    if is_linear(kind):
        value, note = a["rotor_mass"], w.note("rotor_mass").replace("# ", "# kg; ", 1)
    else:
        value = product(a["rotor"], a["gear"] ** 2)
        times = f"{number(a['rotor'])} times {number(a['gear'])}²"
        note = w.note("rotor", "gear").replace("# ", f"# kg m², {times}; ", 1)
    for i in range(limbs_of(kind)):
        yield f"  drive{i + 1}: {number(value)}{note if i == 0 else ''}"
    if has_telescope(kind):
        yield w.line("  ", "drive4", "kg m²", "tool_rotor")


def _limits(w: _Writer) -> Iterator[str]:
    kind, a = w.draft.kind, w.a
    yield "workspace:"
    yield "  shape: cylinder"
    yield w.line("  ", "radius", "m", "radius")
    yield f"  z: [{number(a['low'])}, {number(a['high'])}]{w.note('low', 'high')}"
    yield ""
    yield "drive_limits:"
    if is_linear(kind):
        ends, keys = (
            [a["rail_low"], a["rail_high"]],
            ("rail_low", "rail_high", "rail_speed", "rail_force"),
        )
        rest = f"speed: {number(a['rail_speed'])}, force: {number(a['rail_force'])}"
        limits = f"{{position: [{', '.join(map(number, ends))}], {rest}}}"
    else:
        ends, keys = (
            [a["angle_low"], a["angle_high"]],
            ("angle_low", "angle_high", "speed", "torque"),
        )
        speed, torque = product(a["speed"], 1 / a["gear"]), product(a["torque"], a["gear"])
        rest = f"speed_deg_s: {number(speed)}, torque: {number(torque)}"
        limits = f"{{angle_deg: [{', '.join(map(number, ends))}], {rest}}}"
    said = [f"{key.replace('_', ' ')} {w.draft.origins[key]}" for key in keys]
    yield f"  # {', '.join(said)}"
    for i in range(limbs_of(kind)):
        yield f"  drive{i + 1}: {limits}"
    if has_telescope(kind):
        rest = f"speed_deg_s: {number(a['tool_speed'])}, torque: {number(a['tool_torque'])}"
        yield f"  drive4: {{{rest}}}{w.note('tool_speed', 'tool_torque')}"
    yield w.line("", "platform_speed", "m/s", "top_speed")
    yield w.line("", "platform_acceleration", "m/s²", "top_acceleration")
    yield w.line("", "strut_swing_deg", "", "swing")
    yield f"largest_condition: {_CONDITION} # assumed: how near to a singularity motions may come"


def _sources(w: _Writer) -> Iterator[str]:
    yield "sources:"
    for path, origin in sources(w.draft).items():
        yield f"  {path}: {scalar(origin)}"
