"""Words that names of columns are made of, in five languages, and names that drives give signals.

One table, composed by `column_names.py`: quantity × command or measurement × axis × unit. Latin
words stand without accents and in small letters; compounds (`Drehzahlistwert`) are taken apart.
"""


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


# What a word stands for. Of several in one name the first of these counts: the torque of a joint is
# no joint's position.
QUANTITIES: dict[str, frozenset[str]] = {
    "acceleration": _words(
        "acc accel acceleration accelerations qdd ddq qddot beschleunigung 加速度 角加速度"
    ),
    "velocity": _words(
        "vel velo velocity velocities speed speeds spd qd dq qdot dtheta omega rpm drehzahl "
        "geschwindigkeit winkelgeschwindigkeit vitesse 速度 角速度 转速 回転数"
    ),
    "torque": _words(
        "tau torque torques trq tq tor moment drehmoment couple effort efforts eff force forces "
        "kraft 转矩 扭矩 力矩 力 トルク"
    ),
    "current": _words("current currents cur curr strom courant iq isq amps 电流 電流"),
    "position": _words(
        "q pos position positions angle angles winkel lage theta enc encoder stellung "
        "位置 角度 关节角 関節角"
    ),
    "time": _words(
        "t time timestamp zeit zeitstempel temps horodatage clock stamp millis 时间 时刻 时间戳 "
        "時間 時刻 タイムスタンプ"
    ),
}
# A derivative that a suffix makes: theta_dot.
DERIVATIVES = {"dot": "velocity", "ddot": "acceleration"}
MEASURED = _words(
    "act actual ist istwert meas measured fb fdb feedback present real reel mesure mesuree "
    "estimate est 实际 反馈 实测 当前 実 現在 検出 フィードバック"
)
COMMANDED = _words(
    "set setpoint sp cmd command commanded con control ref reference target desired des d "
    "soll sollwert demand goal consigne planned programmed calculated computed ff "
    "feedforward 目标 指令 给定 参考 目標"
)
# Of something else than a drive's state.
OTHERS = _words(
    "err error errors diff difference dev deviation fehler abweichung lag following tracking "
    "limit max min tcp tool platform cartesian ee eef effector end gripper base com foot wrist ft "
    "temp temperature temperatur voltage spannung tension power leistung puissance bus supply "
    "jerk ruck status mode sensor external ext friction fric gravity grav nle cost reward corr "
    "rated disturbance dob rfob wheel imu cycle exec seq frame "
    "偏差 误差 誤差 温度 电压 功率 外力 外乱 扰动"
)
# What names an axis, and fills compounds.
FILLERS = _words(
    "axis axes axe achse achsen joint joints gelenk drive antrieb motor moteur mot wert value val "
    "轴 軸 关节 関節 电机 モータ モーター"
)

# Units as pint reads them, and as people write them: in small letters without blanks. Those of the
# empty one depend on a rated value or an encoder, which only the user knows.
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

# Names of signals as drives and robots document them, with their unit: None where the user sets it,
# empty where a rated value or an encoder decides. SINAMICS parameters, CiA 402 objects, SERCOS
# identifiers; ACOPOS, AKD, KUKA, Yaskawa and ACS.
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
