"""Meanings of columns by their names, for recordings without default names.

A name states a column's quantity, axis and unit, and whether it is commanded or measured. The words
below, in five languages, are in lower case without accents. Compounds (`Drehzahlistwert`) are
split.
"""

import re
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

from deltaid.recording.units import SI_UNITS, factor_among, is_unit

# Words of quantities. If a name has words of several, the first quantity in this order counts.
QUANTITIES = {
    quantity: frozenset(words.split())
    for quantity, words in {
        "acceleration": (
            "acc accel acceleration accelerations qdd ddq qddot beschleunigung 加速度 角加速度"
        ),
        "velocity": (
            "vel velo velocity velocities speed speeds spd qd dq qdot dtheta omega rpm drehzahl "
            "geschwindigkeit winkelgeschwindigkeit vitesse 速度 角速度 转速 回転数"
        ),
        "torque": (
            "tau torque torques trq tq tor moment drehmoment couple effort efforts eff force "
            "forces kraft 转矩 扭矩 力矩 力 トルク"
        ),
        "current": ("current currents cur curr strom courant iq isq amps 电流 電流"),
        "position": (
            "q pos position positions angle angles winkel lage theta enc encoder stellung "
            "位置 角度 关节角 関節角"
        ),
        "time": (
            "t time timestamp zeit zeitstempel temps horodatage clock stamp millis 时间 时刻 "
            "时间戳 時間 時刻 タイムスタンプ"
        ),
    }.items()
}
# Suffixes of derivatives, such as theta_dot.
DERIVATIVES = {"dot": "velocity", "ddot": "acceleration"}
# Words with other meanings.
_ROLES = {
    key: frozenset(words.split())
    for key, words in {
        "measured": (
            "act actual ist istwert meas measured fb fdb feedback present real reel mesure "
            "mesuree estimate est 实际 反馈 实测 当前 実 現在 検出 フィードバック"
        ),
        "commanded": (
            "set setpoint sp cmd command commanded con control ref reference target desired des d "
            "soll sollwert demand goal consigne planned programmed calculated computed ff "
            "feedforward 目标 指令 给定 参考 目標"
        ),
        # Signals that are no state of a drive.
        "others": (
            "err error errors diff difference dev deviation fehler abweichung lag following "
            "tracking limit max min tcp tool platform cartesian ee eef effector end gripper base "
            "com foot wrist ft temp temperature temperatur voltage spannung tension power "
            "leistung puissance bus supply jerk ruck status mode sensor external ext friction "
            "fric gravity grav nle cost reward corr rated disturbance dob rfob wheel imu cycle "
            "exec seq frame 偏差 误差 誤差 温度 电压 功率 外力 外乱 扰动"
        ),
        # Names of axes, and parts of compounds.
        "fillers": (
            "axis axes axe achse achsen joint joints gelenk drive antrieb motor moteur mot wert "
            "value val 轴 軸 关节 関節 电机 モータ モーター"
        ),
    }.items()
}
_KNOWN = frozenset[str]().union(*QUANTITIES.values(), *_ROLES.values(), DERIVATIVES)
# Units in pint's spelling, and other spellings in lower case without blanks. Units under the empty
# name depend on a rated value or an encoder, which only the user knows.
_SPELLINGS = {
    "s": "s sec secs second seconds sek sekunden 秒",
    "ms": "ms msec millis milliseconds 毫秒 ミリ秒",
    "us": "us usec µs μs microseconds 微秒",
    "ns": "ns nsec nanoseconds",
    "rad": "rad radian radians",
    "deg": "° deg degree degrees grad 度",
    "rev": "rev revs turn turns revolutions umdr",
    "rad/s": "rad/s rad_s rads rads-1 rad.s-1",
    "deg/s": "°/s deg/s deg_s dps grad/s degrees/s",
    "rpm": "rpm 1/min min-1 min^-1 u/min r/min tr/min rev/min",
    "rev/s": "rev/s turns/s turn/s",
    "rad/s^2": "rad/s^2 rad/s² rad/s2 rad_s2 rad/ss",
    "deg/s^2": "°/s^2 °/s² °/s2 °/ss deg/s^2 deg/s² deg/s2 deg_s2",
    "m": "m meter",
    "mm": "mm millimeter",
    "m/s": "m/s",
    "mm/s": "mm/s",
    "N m": "nm n*m n·m n.m n-m n⋅m newtonmeter",
    "mN*m": "mnm mn*m mn·m",
    "N": "n newton",
    "A": "a arms amp amps ampere amperes 安",
    "mA": "ma marms milliamps",
    "": "% ‰ percent pct permille 0.1% %rated inc incs increments cnt cnts count counts ticks "
    "pulse pulses digits lu cnt/s cnt/sec counts/s inc/s",
}
UNITS = {text: unit for unit, texts in _SPELLINGS.items() for text in texts.split()}
# Documented names of signals of drives, with quantity and unit: None if the user sets the unit,
# empty if it depends on a rated value or an encoder. SINAMICS parameters, CiA 402 objects, SERCOS
# identifiers; names of ACOPOS, AKD, KUKA, Yaskawa and ACS.
SIGNALS: dict[str, tuple[str, str | None]] = {
    **dict.fromkeys(("r0061", "r0063", "r0021"), ("velocity", "rpm")),
    **dict.fromkeys(("r0080", "r0031", "torque_axis_act", "geartorque"), ("torque", "N m")),
    **dict.fromkeys(("r0068", "r0078", "ictrl_isq_act", "il.fb"), ("current", "A")),
    **dict.fromkeys(("aipos", "axis_act", "axis_act_meas"), ("position", "deg")),
    **dict.fromkeys(("r2521", "r0482", "6064", "6064h", "s-0-0051"), ("position", "")),
    **dict.fromkeys(("606c", "606ch", "s-0-0040"), ("velocity", "")),
    **dict.fromkeys(("6077", "6077h", "s-0-0084"), ("torque", "")),
    **dict.fromkeys(("6078", "6078h", "curr_act", "macur"), ("current", "")),
    **dict.fromkeys(("pctrl_s_act", "pl.fb", "apos", "fpos"), ("position", None)),
    **dict.fromkeys(("sctrl_speed_act", "vl.fb", "fspd", "fvel"), ("velocity", None)),
    **dict.fromkeys(("aspos", "cpos", "mpos", "cspd"), ("commanded", None)),
}
# Fewest letters in a part of a compound, and letters that link parts of German compounds.
_PART, _LINKS = 3, ("", "s", "n", "en", "es")
_BRACKETS = re.compile(r"[\[(]\s*([^\[\]()]*?)\s*[\])]")
_LATIN = re.compile(r"[A-Za-zµ]+|[^\W\dA-Za-z_]+")
_HUMPS = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
_NUMBER = re.compile(r"\d+")
_LETTER = re.compile(r"(?<![A-Za-z])[A-CX-Z](?![A-Za-z])|(?<=[a-z])[X-Z]$")
_SIGNAL = re.compile(
    r"(?<![a-z0-9])(?:0x)?("
    + "|".join(re.escape(name) for name in sorted(SIGNALS, key=len, reverse=True))
    + r")(?![a-z0-9])"
)


@dataclass(frozen=True)
class Reading:
    """Meaning of a column's name.

    Attributes:
        quantity: time, position, velocity, acceleration, torque or current; empty if none.
        unit: in pint's spelling; empty if it depends on a rated value or an encoder; None if
            unstated.
        is_measured: whether the name states that the column is measured.
        is_usable: whether the column may be a measured state of a drive.
        words: words of the name.
        documented: documented name of a drive's signal that determined the quantity, if any.
    """

    quantity: str
    unit: str | None
    is_measured: bool
    is_usable: bool
    words: tuple[str, ...]
    documented: str = ""

    @property
    def rank(self) -> tuple[bool, bool, int]:
        """Sort key: torque over current, measured over plain names, few words over many."""
        return self.quantity != "current", self.is_measured, -len(self.words)


@dataclass(frozen=True)
class Group:
    """Columns whose names differ in their axis only.

    Attributes:
        places: indices of columns, one per axis in order.
        axes: number of axes in the recording, which may be larger.
        by_letter: whether axes are letters, which may be directions in space.
    """

    places: tuple[int, ...]
    axes: int
    by_letter: bool = False


def unit_of(text: str) -> str | None:
    """Unit in pint's spelling; empty if it depends on a rated value; None if it is no unit."""
    plain = text.replace(" ", "").casefold()
    if plain in UNITS:
        return UNITS[plain]
    if any(c.isalpha() or c == "°" for c in text) and is_unit(text):
        return text.strip()
    return None


@cache
def kind_of(unit: str) -> str:
    """Quantity of a unit, such as 'position' for 'deg'; empty if it is none of a drive."""
    return next((kind for kind, si in SI_UNITS.items() if factor_among(unit, *si) is not None), "")


def read_name(name: str) -> Reading:
    """Meaning of a column's name by its words."""
    name = unicodedata.normalize("NFKC", name)
    plain, unit = _without_unit(name)
    words = tuple(_in_words(plain))
    kind, known = kind_of(unit) if unit else "", {*words}
    measured, commanded = _ROLES["measured"] & known, _ROLES["commanded"] & known
    if measured - {"fb"}:  # a set of actual values
        commanded -= {"set"}
    usable = not (commanded or _ROLES["others"] & known)
    if signal := _SIGNAL.search(name.casefold()):
        quantity, usual = SIGNALS[signal[1]]
        if quantity == "commanded":
            return Reading("", None, is_measured=False, is_usable=False, words=words)
        unit = unit if kind == quantity else usual
        return Reading(quantity, unit, bool(measured), usable, words, signal[1])
    quantity, is_now = _quantity(words)
    if kind and kind != quantity and (quantity != "torque" or kind == "current"):
        bracketed = plain != name and name.rstrip()[-1:] in "])"
        quantity, unit = (kind, unit) if bracketed or not quantity else (quantity, None)
    return Reading(quantity, unit, bool(measured) or is_now, usable, words)


def groups_of(names: Sequence[str], drives: int) -> Iterator[Group]:
    """Groups of one column per drive whose names differ only in the axis: a number from 0 or 1, or
    letters in order."""
    numbered, lettered = dict[str, dict[int, int]](), dict[str, dict[int, int]]()
    for place, name in enumerate(names):
        for match in _NUMBER.finditer(name):
            stem = f"{name[: match.start()]}#{name[match.end() :]}"
            numbered.setdefault(stem, {})[int(match[0])] = place
        for number in {*_NUMBER.findall(name)}:
            if len(re.findall(rf"(?<!\d){number}(?!\d)", name)) > 1:  # axis1.q1
                stem = re.sub(rf"(?<!\d){number}(?!\d)", "#", name)
                numbered.setdefault(stem, {})[int(number)] = place
        for match in _LETTER.finditer(name):
            family = "ABC" if match[0] in "ABC" else "XYZ"
            stem = f"{name[: match.start()]}{family}{name[match.end() :]}"
            lettered.setdefault(stem, {})[family.index(match[0])] = place
    grouped = set[int]()
    for stems, by_letter in ((numbered, False), (lettered, True)):
        for axes in stems.values():
            grouped |= {*axes.values()} if len(axes) > 1 else set()
            first = min(axes)
            run = range(first, first + drives)
            if first <= 1 and all(axis in axes for axis in run) and (drives > 1 or len(axes) > 1):
                yield Group(tuple(axes[axis] for axis in run), len(axes), by_letter)
    if drives == 1:
        yield from (Group((place,), 1) for place in range(len(names)) if place not in grouped)


def _without_unit(name: str) -> tuple[str, str | None]:
    for match in reversed([*_BRACKETS.finditer(name)]):
        if not match[1].isdecimal() and (unit := unit_of(match[1])) is not None:
            return f"{name[: match.start()]} {name[match.end() :]}", unit
    # A unit may also precede the axis, except a single letter, which may be the axis.
    for text, shortest in ((name, 1), (re.sub(r"[_ ]?\d+$", "", name), 2)):
        parts = re.split(r"[_\s]+", text.strip())
        for count in (2, 1):
            last = "_".join(parts[-count:])
            if len(parts) > count and len(last) >= shortest and last.casefold() in UNITS:
                return text[: text.rindex(parts[-count])], UNITS[last.casefold()]
    return name, "ms" if name.casefold() == "millis" else None


def _in_words(name: str) -> Iterator[str]:
    """Split a name into words: 'Axis1.ActPos' gives axis, act, pos; compounds give their parts,
    Chinese and Japanese the longest known words."""
    for run in _LATIN.findall(name):
        if not run[0].isascii() and not unicodedata.name(run[0], "").startswith("LATIN"):
            yield from _longest_known(run)
    folded = unicodedata.normalize("NFKD", name)
    ascii_only = "".join(
        c if c.isascii() else "" if unicodedata.combining(c) else " " for c in folded
    )
    for run in re.findall(r"[A-Za-z]+", ascii_only):
        parts = [run] if run.lower() in _KNOWN else _HUMPS.split(run)
        for word in (part.lower() for part in parts):
            yield from ([word] if word in _KNOWN else _parts(word) or [word])


def _longest_known(run: str) -> Iterator[str]:
    while run:
        size = next((n for n in range(len(run), 0, -1) if run[:n] in _KNOWN), 1)
        yield run[:size]
        run = run[size:]


@cache
def _parts(word: str) -> tuple[str, ...]:
    """Known words of a compound; empty if the word is no compound."""
    for size in range(len(word) - _PART, _PART - 1, -1):
        for link in _LINKS:
            rest = word[size + len(link) :]
            if word[:size] in _KNOWN and word[size:].startswith(link) and len(rest) >= _PART:
                tail = (rest,) if rest in _KNOWN else _parts(rest)
                if tail:
                    return (word[:size], *tail)
    return ()


def _quantity(words: Sequence[str]) -> tuple[str, bool]:
    """Quantity of words, and whether 'current' among them means the present value."""
    by_quantity = {
        quantity: [word for word in words if word in known]
        for quantity, known in QUANTITIES.items()
    }
    present = [quantity for quantity, matching in by_quantity.items() if matching]
    others = [quantity for quantity in present if quantity not in ("current", "time")]
    if by_quantity["current"] and others:
        first = min(words.index(word) for quantity in others for word in by_quantity[quantity])
        is_now = {*by_quantity["current"]} <= {"current"} and words.index("current") < first
        if not is_now:
            return "current", False
        present.remove("current")
        return present[0], True
    if present[:1] == ["position"]:
        return next((DERIVATIVES[word] for word in words if word in DERIVATIVES), "position"), False
    return (present[0] if present else ""), False
