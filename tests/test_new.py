"""`deltaid new`: options, files, a terminal, Ctrl-C; what it writes is what other commands read."""

import json
import os
import select
import signal
import sys
import time
from pathlib import Path

import jsonschema
import pytest

from command import accepted, refused, run
from deltaid.robot.load import load_robot
from deltaid.studio.drafting.questions import QUESTIONS

LENGTHS = (
    "--arm", "220 mm", "--strut", "0.5", "--base-radius", "16cm", "--platform-radius", "50mm",
)  # fmt: skip


def new(folder: Path, *options: object) -> tuple[object, ...]:
    return ("new", folder / "mine.yaml", *options)


def test_a_file_from_options(tmp_path: Path) -> None:
    options = ("--rotor", "0.6 kg cm²", "--gear", 20, "--torque", 1.5,
               "--title", 'The "first": one')  # fmt: skip
    page = tmp_path / "mine.html"
    done = accepted(
        *new(tmp_path, "--kind", "delta", *LENGTHS, *options, "--report", page), width=120
    )
    robot = load_robot(tmp_path / "mine.yaml")
    assert (robot.name, robot.title) == ("mine", 'The "first": one')
    lengths = robot.limbs.upper_arm, robot.limbs.strut, robot.limbs.base_radius
    assert lengths == (0.22, 0.5, 0.16)
    assert robot.rotor_inertia["drive3"] == 0.024
    assert robot.drive_limits["drive1"].torque == 30
    text = (tmp_path / "mine.yaml").read_text(encoding="utf-8")
    assert "0.024 # kg m², 6e-05 times 20²; given" in text
    assert "mine.yaml, good by `deltaid check`" in done.out
    assert "7 numbers are known" in done.out
    assert "assumed: spacing, swing, angle low" in done.out
    assert "condition in the workspace" in done.out
    assert "The &#34;first&#34;: one" in page.read_text(encoding="utf-8")
    schema = json.loads((tmp_path / "robot.schema.json").read_text(encoding="utf-8"))
    written = robot.model_dump(mode="json", exclude_unset=True, exclude_none=True)
    jsonschema.validate(written, schema)
    accepted("check", tmp_path / "mine.yaml")


def test_a_catalogue_robot_to_start_from(tmp_path: Path) -> None:
    accepted(*new(tmp_path, "--from", "clavel-delta3", "--strut", "1.1"))
    mine, first = load_robot(tmp_path / "mine.yaml"), load_robot("clavel-delta3")
    assert mine.limbs.strut == 1.1
    assert mine.limbs.upper_arm == first.limbs.upper_arm
    assert mine.drive_limits["drive2"].torque == 150
    assert mine.sources["limbs.strut"] == "given"
    assert mine.sources["limbs.upper_arm"] == "from clavel-delta3"
    assert "radius assumed" in mine.sources["workspace"] or mine.sources["workspace"] == "assumed"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--kind", "delta"), ("--arm", "--strut", "--base-radius", "nobody can guess")),
        ((), ("--kind", "is missing", "par4-linear")),
        (("--kind", "delt"), ("--kind", "'delt'", "linear-delta")),
        (("--kind", "delta", "--tilt", "3"), ("--tilt 3", "has none", "rails")),
        (("--kind", "delta", "--strut", "500"), ("--strut", "is it 500 mm?")),
        (("--kind", "delta", *LENGTHS, "--torque", "3 kg"), ("--torque", "'kg'", "80 N m")),
        (("--from", "nobody"), ("nobody", "the catalogue has")),
        (("--from", "h4", "--kind", "delta"), ("--kind delta", "h4")),
        (("--kind", "delta", *LENGTHS, "--report", "x.txt"), ("--report", ".html")),
    ],
)
def test_what_is_refused(tmp_path: Path, options: tuple[str, ...], words: tuple[str, ...]) -> None:
    message = refused(*new(tmp_path, *options), folder=tmp_path)
    assert all(word in message for word in words), message


def test_unusual_masses_are_doubted_and_written(tmp_path: Path) -> None:
    done = accepted(*new(tmp_path, "--kind", "delta", *LENGTHS, "--platform-mass", "15"))
    assert "15 kg; with limbs of 0.72 m few bodies have" in done.err
    assert "in doubt by `deltaid check`" in done.out
    assert run("check", tmp_path / "mine.yaml").code == 3


def test_unusual_rotors_are_doubted_and_written(tmp_path: Path) -> None:
    done = accepted(*new(tmp_path, "--kind", "delta", *LENGTHS, "--rotor", "3"))
    assert "rotor_inertia.drive1 is 3 kg m²" in done.err
    assert "in doubt by `deltaid check`" in done.out
    assert run("check", tmp_path / "mine.yaml").code == 3


def test_nothing_is_overwritten_unasked(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("name: precious\n", encoding="utf-8")
    assert "--force" in refused(*new(tmp_path, "--kind", "delta", *LENGTHS), folder=tmp_path)
    assert file.read_text(encoding="utf-8") == "name: precious\n"
    assert "precious" not in refused("new", tmp_path / "mine.csv", folder=tmp_path)
    schema = tmp_path / "robot.schema.json"
    schema.write_text("{}", encoding="utf-8")
    accepted(*new(tmp_path, "--kind", "delta", *LENGTHS, "--force"))
    assert load_robot(file).name == "mine"
    assert schema.read_text(encoding="utf-8") == "{}"


def test_every_question_has_an_option_in_the_help() -> None:
    text = run("new", "--help", width=200).out
    assert all(question.option in text for question in QUESTIONS)


class Terminal:
    """The command in a terminal of its own."""

    def __init__(self, *arguments: object) -> None:
        import pty

        self.pid, self.handle = pty.fork()
        if self.pid == 0:  # pragma: no cover
            words = [sys.executable, "-c", "from deltaid.cli import main; main()", "new"]
            os.execv(sys.executable, [*words, *map(str, arguments)])
        self.seen = ""

    def until(self, words: str, seconds: float = 60.0) -> str:
        """What is shown until some words are."""
        end = time.monotonic() + seconds
        start = len(self.seen)
        while words not in self.seen[start:]:
            ready, _, _ = select.select([self.handle], [], [], max(0.0, end - time.monotonic()))
            assert ready, f"{words!r} is not in {self.seen[start:]!r}"
            try:
                self.seen += os.read(self.handle, 4096).decode(errors="replace")
            except OSError:
                break
        return self.seen[start:]

    def say(self, text: str) -> None:
        os.write(self.handle, text.encode() + b"\n")

    def ended(self) -> int:
        self.until("\x00never")
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="has no pseudo-terminals")
def test_in_a_terminal_it_asks(tmp_path: Path) -> None:
    shell = Terminal(tmp_path / "mine.yaml", "--swing", "45")
    shell.until("number or name")
    shell.say("1")
    shell.until("from motor axis to elbow [m]")
    shell.say("?")
    assert "caliper" in shell.until("[m]:")
    shell.say("nine")
    assert "is not a number" in shell.until("[m]:")
    for text in ("220 mm", "0.12", "160 mm", "0.05"):
        shell.say(text)
    shell.until("distance of the two struts of a limb (0.012 m, assumed)")
    for _ in range(3):
        shell.say("")
    assert "cannot reach" in shell.until("from motor axis to elbow (0.22 m, given)")
    shell.say("")
    shell.say("0.5")
    for _ in range(40):
        shell.say("")
    said = shell.until("`deltaid check`")  # broken where the folder's name is long
    assert "good by `deltaid check`" in " ".join(said.split())
    assert shell.ended() == 0
    robot = load_robot(tmp_path / "mine.yaml")
    assert (robot.limbs.strut, robot.strut_swing_deg) == (0.5, 45)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="has no pseudo-terminals")
def test_leaving_writes_nothing(tmp_path: Path) -> None:
    shell = Terminal(tmp_path / "mine.yaml", "--kind", "delta")
    shell.until("elbow")
    time.sleep(0.5)  # the line is printed before it can be typed in
    os.write(shell.handle, b"\x03")
    assert "nothing was written" in shell.until("nothing was written")
    assert shell.ended() == 128 + signal.SIGINT
    assert list(tmp_path.iterdir()) == []
