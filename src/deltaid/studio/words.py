"""Messages of the command line in the words of the pages, without options and keys of files."""

import re

# Label of the switch that replaces --force.
INSIST = "Go on all the same"
# Names of pages that replace commands.
_PAGES = {
    "check": "the page Check",
    "identify": "the page Fit",
    "validate": "“Test this model” on the page Result",
    "new": "the page Robot",
    "robots": "the page Robot",
    "show": "the page Robot",
}
# Labels of options on pages, where they differ from the options' names.
_OPTIONS = {
    "cutoff": "cut-off",
    "lag": "setting Lag",
    "keep-all": "the switch “Exclude nothing else”",
    "force": f"the switch “{INSIST}”",
    "periodic": "“The motion goes on as it begins”",
    "strut-spacing": "“Distance of a limb's struts”",
    "plain-friction": "Friction: nearest viscous and Coulomb friction",
    "without-friction": "Friction: without friction",
    "gamma": "weight γ",
    "prior-spread": "“How far the prior may be off”",
}
_FIXED = (
    (
        r"`deltaid check` shows more and --write writes what it proposes, --force continues anyway",
        "the page Check shows more, and applies what it proposes by a click",
    ),
    (r"`deltaid check` shows more, --force continues anyway", "the page Check shows more"),
    (r"`deltaid check ROBOT --write FILE` writes a cured file", "the page Check applies it"),
    (r"give --columns a mapping with", "give the mapping file"),
    (r"\(--columns(?: \w+\.yaml)?\)", "(page Recording)"),
    (r"(?:with )?--columns(?: \w+\.yaml)?", "on the page Recording"),
    (r"--keep-all \(keep_all of the settings\)", "--keep-all"),
    (r"torque_constant in N m/A", "N m per A"),
    (r"torque_constant", "N m per A"),
    (r"^column mapping(?:, )?", ""),
)
_COMMAND = re.compile(r"`deltaid (\w+)[^`]*`")
_OPTION = re.compile(r"--([a-z][a-z-]*[a-z])=?")
_DRIVE = re.compile(r"\b(position|velocity|acceleration|torque)\[(\d+)\]")


def page_words(text: str) -> str:
    """A message with the pages' words in place of options, commands and keys."""
    for pattern, words in _FIXED:
        text = re.sub(pattern, words, text)
    text = _COMMAND.sub(lambda match: _PAGES.get(match[1], match[0]), text)
    text = _OPTION.sub(lambda m: _OPTIONS.get(m[1], f"“{m[1].replace('-', ' ')}”"), text)
    return _DRIVE.sub(lambda match: f"{match[1]} of drive {int(match[2]) + 1}", text)
