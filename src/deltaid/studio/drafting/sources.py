"""Where every number of a drafted description comes from, by the path of its key."""

from collections.abc import Iterator

from deltaid.studio.drafting.bodies import bodies
from deltaid.studio.drafting.draft import ASSUMED, Draft
from deltaid.studio.drafting.kinds import (
    has_telescope,
    is_articulated,
    is_linear,
    limbs_of,
    platform_of,
)


def sources(draft: Draft) -> dict[str, str]:
    """The key `sources` of a description; drives that say the same say it once."""
    found = dict(_sources(draft))
    for part in ("friction", "rotor_inertia", "drive_limits"):
        own = [key for key in found if key.startswith(f"{part}.")]
        if len({found[key] for key in own}) == 1:
            found[part] = found[own[0]]
            found = {key: text for key, text in found.items() if key not in own}
    return found


def _sources(draft: Draft) -> Iterator[tuple[str, str]]:
    kind = draft.kind
    yield "limbs.azimuth_deg", ASSUMED
    yield "limbs.struts_per_limb", ASSUMED
    for key, question in _limbs(kind).items():
        yield f"limbs.{key}", draft.origins[question]
    if platform_of(kind) == "h4":
        yield "limbs.platform_points", f"{ASSUMED}, by the length of the middle bar"
    if has_telescope(kind):
        yield "telescope", ASSUMED
    if is_articulated(kind):
        yield from _platform(draft)
    for body in bodies(kind, draft.values):
        length = {"U": "arm", "S": "strut"}.get(body.name)
        said = f"mass {draft.origins[body.mass]}" + (
            f", length {draft.origins[length]}" if length else ""
        )
        yield f"bodies.{body.name}", f"{said}; shape {ASSUMED}"
    yield from _drives(draft)
    yield "workspace", _together(draft, "radius", "low", "high")
    yield "platform_speed", draft.origins["top_speed"]
    yield "platform_acceleration", draft.origins["top_acceleration"]
    yield "strut_swing_deg", draft.origins["swing"]
    yield "largest_condition", ASSUMED


def _limbs(kind: str) -> dict[str, str]:
    """Keys of limbs and their questions."""
    if platform_of(kind) == "h4":
        found = {"base_points": "base_radius"}
    else:
        found = {"base_radius": "base_radius", "platform_radius": "platform_radius"}
    found |= {"tilt_deg": "tilt"} if is_linear(kind) else {"upper_arm": "arm"}
    return found | {"strut": "strut", "strut_spacing": "spacing"}


def _platform(draft: Draft) -> Iterator[tuple[str, str]]:
    platform = platform_of(draft.kind)
    yield "platform.first", ASSUMED
    if platform == "i4":
        yield "platform.direction_deg", ASSUMED
        yield "platform.ratio", f"by the pinion's radius, {draft.origins['pinion']}"
    else:
        yield f"platform.{'half_length' if platform == 'h4' else 'length'}", draft.origins["bar"]
        yield "platform.ratio", draft.origins["ratio"]
    yield "platform.angle_deg", draft.origins["tool_turn"]
    yield "platform.speed_deg_s", draft.origins["tool_speed"]


def _drives(draft: Draft) -> Iterator[tuple[str, str]]:
    rail = is_linear(draft.kind)
    law = ("rail_coulomb", "rail_viscous") if rail else ("coulomb", "viscous")
    ends = ("rail_low", "rail_high") if rail else ("angle_low", "angle_high")
    most = ("rail_speed", "rail_force") if rail else ("speed", "torque", "gear")
    for i in range(limbs_of(draft.kind)):
        drive = f"drive{i + 1}"
        yield f"friction.{drive}", _together(draft, *law)
        yield (
            f"rotor_inertia.{drive}",
            _together(draft, *(("rotor_mass",) if rail else ("rotor", "gear"))),
        )
        yield f"drive_limits.{drive}", _together(draft, *ends, *most)
    if has_telescope(draft.kind):
        yield "friction.drive4", ASSUMED
        yield "friction.slide", ASSUMED
        yield "rotor_inertia.drive4", draft.origins["tool_rotor"]
        yield "drive_limits.drive4", _together(draft, "tool_speed", "tool_torque")
    elif is_articulated(draft.kind):
        yield "friction.platform", ASSUMED


def _together(draft: Draft, *keys: str) -> str:
    """One word if all come from one place, or each by its name."""
    origins = [draft.origins[key] for key in keys]
    if len(set(origins)) == 1:
        return origins[0]
    return ", ".join(f"{k.replace('_', ' ')} {o}" for k, o in zip(keys, origins, strict=True))
