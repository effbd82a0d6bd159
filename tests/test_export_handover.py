"""A folder that one can hand over: what goes with an export, and programs that check it."""

import subprocess
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from command import accepted
from deltaid.exports.files import TargetName, export
from deltaid.exports.handover import handover, reference_states
from deltaid.exports.structured_text import plc_program
from deltaid.exports.text import DOUBLE, SINGLE, Precision
from deltaid.model.corrections import Correction
from exports import CC, model, needs_compiler, subject
from identified import identified
from st_program import Program
from support import assert_close

ROBOT, STEM = "clavel-delta3", "clavel_delta3"


def test_a_folder_has_all_that_it_takes_and_a_file_is_alone(tmp_path: Path) -> None:
    accepted("export", ROBOT, "--to", "npz", "-o", f"{tmp_path}/all/")
    accepted("export", ROBOT, "--to", "npz", "-o", tmp_path / "a.npz")
    names = {path.name for path in (tmp_path / "all").iterdir()}
    assert names == {f"{STEM}.npz", f"README_{STEM}_npz.md", f"{STEM}_vectors.csv"}
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["a.npz"]
    text = (tmp_path / "all" / f"README_{STEM}_npz.md").read_text()
    for word in (
        subject(ROBOT).robot.title,
        "rad/s^2, N m",
        "MIT",
        *names - {f"README_{STEM}_npz.md"},
    ):
        assert word in text
    assert "{" not in text


@pytest.mark.parametrize("target", ["c", "st", "fmu-inverse", "mjcf"])
def test_what_drives_are_commanded_is_said_where_it_is_not_the_torque(
    target: TargetName, tmp_path: Path
) -> None:
    """Exports compute torques at the joints; a drive may take another number for them."""
    known = identified(ROBOT).result.model
    gain = Correction(kind="gain", subject="drive2", value=1.25, text="found")
    found = export(known.changed(corrections=(gain,)), target, f"{tmp_path}/code/")
    assert "tau2 / 1.25" in found.warnings[0]
    (readme,) = (path for path in found.paths if path.suffix == ".md")
    for path in (readme, found.paths[0]):
        if path.suffix != ".fmu":
            assert "tau2 / 1.25" in path.read_text()
    assert not export(known.changed(corrections=()), target, f"{tmp_path}/code/").warnings


@pytest.mark.parametrize("name", [ROBOT, "h4"])
def test_vectors_are_states_with_their_torques(name: str) -> None:
    chosen = subject(name)
    found = reference_states(chosen, DOUBLE)
    z, q, qd, qdd, tau = found.values()
    assert z.shape == (100, chosen.dynamics.dof)
    assert_close(tau, model(chosen, z, qd, qdd).tau, 1e-12)
    assert_close(chosen.dynamics.kinematics.forward(q), z, 1e-9)
    texts = handover(chosen, "npz", "robot", (), DOUBLE)
    table = pl.read_csv(texts["robot_vectors.csv"].encode())
    np.testing.assert_array_equal(table["tau1"], tau[:, 0])


@needs_compiler
@pytest.mark.parametrize("options", [(), ("--single",)], ids=["double", "float"])
def test_the_program_in_c(options: tuple[str, ...], tmp_path: Path) -> None:
    folder = tmp_path / "code"
    accepted("export", ROBOT, "--to", "c", *options, "-o", f"{folder}/")

    def checked() -> subprocess.CompletedProcess[str]:
        files = [f"{STEM}_test.c", f"{STEM}.c"]
        strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
        subprocess.run([str(CC), *strict, *files, "-lm", "-o", "check"], cwd=folder, check=True)
        return subprocess.run([folder / "check"], capture_output=True, encoding="utf-8")

    good = checked()
    assert good.returncode == 0
    assert good.stdout.startswith("100 of 100 agree")
    source = folder / f"{STEM}.c"
    parameter = next(line for line in source.read_text().splitlines() if "P.m," in line)
    changed = parameter.replace(parameter.strip().split(",")[0], "9.0", 1)
    source.write_text(source.read_text().replace(parameter, changed))
    assert checked().returncode != 0  # as the mass is another one


@pytest.mark.parametrize("precision", [DOUBLE, SINGLE], ids=["LREAL", "REAL"])
def test_the_block_in_structured_text(precision: Precision) -> None:
    chosen = subject(ROBOT)
    made = handover(chosen, "st", "rob", ("rob.st",), precision)["rob_test.st"]
    whole = plc_program(chosen, "rob", precision).text
    _, found = Program(whole + made).units["rob_test"]()()
    assert (found["passed"], found["failed"]) == (100, 0)
    mass = next(line for line in whole.splitlines() if "P.m," in line)
    other = whole.replace(mass, mass.partition(":=")[0] + ":= 9.0;")
    _, found = Program(other + made).units["rob_test"]()()
    assert found["failed"] > 90
