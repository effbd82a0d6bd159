"""The exports as CasADi function and numpy arrays, and what all exports have in common."""

import io
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import casadi as ca
import numpy as np
import pytest

import deltaid
from command import accepted, refused, run
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import DeltaidError
from deltaid.exports import fmu_binaries
from deltaid.exports.data_files import casadi_file
from deltaid.exports.files import TARGETS, export, output_path
from deltaid.exports.fmu import fmu
from deltaid.exports.fmu_binaries import Compiler
from deltaid.exports.mjcf import mjcf
from deltaid.exports.urdf import urdf
from deltaid.model.model import Model, load
from deltaid.model.record import IdentifiedModel
from deltaid.robot.inertia import RigidBody
from deltaid.robot.load import catalogue_text, load_robot
from exports import model, states, subject
from identified import identified
from sessions import ROOT, blocks
from support import KINDS, assert_close
from sweeps import swept


@pytest.mark.parametrize("name", swept(KINDS, "irb360-6-1600", "h4"))
def test_casadi_function(name: str, tmp_path: Path) -> None:
    chosen = subject(name)
    path = tmp_path / "delta.casadi"
    path.write_bytes(casadi_file(chosen))
    function = ca.Function.load(str(path))
    z, q, qd, qdd = states(chosen, 5)
    expected = model(chosen, z, qd, qdd)
    for i in range(len(z)):
        out = {k: np.array(v) for k, v in function(z=z[i], qd=qd[i], qdd=qdd[i]).items()}
        assert_close(out["tau"].ravel(), expected.tau[i], 1e-12)
        assert_close(out["M"], expected.M[i], 1e-12)
        assert_close(out["q"].ravel(), q[i], 1e-12)
        assert_close(out["J"], chosen.dynamics.kinematics.jacobian(z[i : i + 1])[0], 1e-12)
        bias = out["C"] @ qd[i] + out["g"].ravel() + out["f"].ravel()
        assert_close(bias, expected.bias[i], 1e-12)
        assert_close(out["M"] @ qdd[i] + bias, expected.tau[i], 1e-10)


def test_numpy_arrays(tmp_path: Path) -> None:
    chosen, path = subject("irb360-6-1600"), tmp_path / "delta.npz"
    export(chosen, "npz", path)
    data = np.load(path)  # without pickle
    layout = chosen.dynamics.layout
    assert (data["p"] == chosen.p).all()
    assert tuple(data["names"]) == layout.names
    assert tuple(data["units"]) == layout.units
    assert list(data["count"]) == [3, 6, 1, 1, 1, 1]
    assert data["rotor_inertia"] == pytest.approx([0, 0, 0, chosen.value("rotor.drive4")])
    laws = dict(zip(zip(data["friction_kind"], data["friction_joint"], strict=True),
                    data["friction_coefficient"], strict=True))  # fmt: skip
    assert laws["coulomb", "slide"] == chosen.value("coulomb.slide")
    assert np.isinf(data["drive_effort"]).sum() == 0
    for i, name in enumerate(data["bodies"]):
        p = chosen.body(str(name))
        about_com, com, mass = (data[key][i] for key in ("inertia_about_com", "com", "mass"))
        assert mass * com == pytest.approx(p[1:4])
        # Steiner's rule, the other way and by cross products
        cross = np.array([np.cross(com, e) for e in np.eye(3)]).T
        steiner = about_com + mass * cross.T @ cross
        assert data["inertia_about_link"][i] == pytest.approx(steiner)
        assert steiner[0, 1] == pytest.approx(p[7])
        assert steiner[1, 2] == pytest.approx(p[8])


def test_inertia_of_a_box_about_its_centre() -> None:
    """A box of 6 kg and edges 1, 2, 3 m with a corner in the link frame's origin."""
    m, edges = 6.0, np.array([1.0, 2.0, 3.0])
    squares, products = m * edges**2 / 3, m * np.outer(edges, edges) / 4
    tensor = [squares[1] + squares[2], squares[0] + squares[2], squares[0] + squares[1]]
    p = np.array([m, *(m * edges / 2), *tensor, *(-products[[0, 1, 0], [1, 2, 2]])])
    box = RigidBody(p)
    assert box.com == pytest.approx(edges / 2)
    assert box.about_com == pytest.approx(np.diag([6.5, 5.0, 2.5]), abs=1e-12)


@pytest.mark.parametrize(
    ("entry", "value", "reason"),
    [
        (0, -0.1, "mass"),
        (4, 1.0, "triangle inequality"),
        (1, 3.0, "not positive definite"),
    ],
)
def test_bodies_that_cannot_exist_are_refused(entry: int, value: float, reason: str) -> None:
    robot = load_robot("clavel-delta3")
    p = prior_parameters(robot)
    p[entry] = value
    with pytest.raises(DeltaidError, match=f"body U cannot exist.*{reason}"):
        Model(robot, p, "a model")


def test_too_few_parameters() -> None:
    robot = load_robot("clavel-delta3")
    with pytest.raises(DeltaidError, match="has 5 parameters, but the robot has 36"):
        Model(robot, np.ones(5), "a model")


@pytest.mark.parametrize("target", swept(TARGETS, *(set(TARGETS) - {"fmu"})))
def test_command_writes_a_file_or_into_a_folder(
    target: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fmu_binaries, "find_spec", lambda _: None)  # other systems have a test
    for output in (tmp_path, tmp_path / f"mine{TARGETS[target].suffixes[0]}"):
        outcome = accepted("export", "linear-delta", "--to", target, "-o", output)
        assert outcome.out.startswith("wrote ")
    stem, files = f"linear_delta{TARGETS[target].addition}", set(tmp_path.iterdir())
    beside = {f"README_{stem}_{target}.md", f"{stem}_vectors.csv", f"{stem}_test.{target}"}
    files -= {tmp_path / name for name in beside}  # tests/test_export_handover.py
    assert {path.stem.partition(".")[0] for path in files} == {stem, "mine"}
    assert len(files) == 2 * len(TARGETS[target].suffixes)


def test_a_folder_that_is_not_there_is_made(tmp_path: Path) -> None:
    accepted("export", "clavel-delta3", "--to", "c", "-o", f"{tmp_path}/deep/code/")
    names = sorted(path.name for path in (tmp_path / "deep" / "code").iterdir())
    assert {"clavel_delta3.c", "clavel_delta3.h"} < set(names)
    accepted("export", "clavel-delta3", "--to", "npz", "-o", tmp_path / "other" / "my.npz")
    assert (tmp_path / "other" / "my.npz").is_file()


def test_a_load_at_the_tool_and_what_says_so(tmp_path: Path) -> None:
    path = tmp_path / "loaded.npz"
    asked = ("export", "irb360-6-1600", "--to", "npz", "-o", path, "--payload", "1.5")
    accepted(*asked, "--without-friction")
    bare, exported = load("irb360-6-1600"), np.load(path)
    more = dict(zip(exported["names"].tolist(), exported["p"] - bare.p, strict=True))
    assert {name for name, x in more.items() if x > 0} == {"EE.m"}
    assert more["EE.m"] == pytest.approx(1.5)
    assert not exported["p"][bare.layout.friction].any()
    assert "with a load of 1.5 kg, without friction, from irb360" in str(exported["provenance"])


def test_files_that_nobody_named_have_names_that_code_may_begin_with(tmp_path: Path) -> None:
    """Of any robot: the user who gives a folder has not chosen the name of the functions."""
    for robot, target, name in (
        ("2 fast Δ", "c", "robot_2_fast.c"),
        ("Zelle Nr. 3 <A&B>", "fmu-inverse", "Zelle_Nr_3_A_B_inverse.fmu"),
        ("робот", "st", "robot.st"),
        ("a robot whose name  is far too long", "st", "a_robot_whose_name_i.st"),
        ("a robot of long lengt h", "st", "a_robot_of_long_leng.st"),
    ):
        assert output_path(target, robot, tmp_path) == tmp_path / name
    chosen = load_robot("clavel-delta3").changed(name="7 robots of a plant")
    written = export(Model(chosen, prior_parameters(chosen), "mine"), "st", tmp_path)
    assert written.paths[0].name == "robot_7_robots_of_a.st"


@pytest.mark.parametrize("version", ["4", 1])
def test_only_versions_of_fmi_that_there_are(version: str | int, tmp_path: Path) -> None:
    with pytest.raises(DeltaidError, match=rf"(?s)version of FMI '{version}'.*there are: 2, 3"):
        export("clavel-delta3", "fmu", tmp_path / "a.fmu", fmi=version)
    assert not list(tmp_path.iterdir())


def test_command_refuses(tmp_path: Path) -> None:
    robot = tmp_path / "robot.npz"
    robot.write_text("name: x\n")
    (tmp_path / "taken.h").mkdir()
    cases = {
        ("nobody", "c", "a.c"): "no robot file and no catalogue robot",
        ("clavel-delta3", "c", "a.xml"): "must end in .c for --to c",
        ("clavel-delta3", "c", "3.c"): "cannot begin the names of C functions",
        ("clavel-delta3", "c", "taken.c"): "is a folder",
        ("clavel-delta3", "npz", "robot.npz/a.npz"): "is a file, not a folder",
        ("clavel-delta3", "npz", "nowhere"): "a folder that is not there yet ends in a slash: ",
        (str(robot), "npz", "a.npz"): "robot.npz",
    }
    for (name, target, output), message in cases.items():
        refusal = refused("export", name, "--to", target, "-o", tmp_path / output, folder=tmp_path)
        assert message in refusal.replace("\n", " ")
    refusal = refused("export", "clavel-delta3", "--to", "c", "-o", "", folder=tmp_path)
    assert "-o '': nothing is given" in refusal  # of a variable that was never set
    outcome = run("export", "clavel-delta3", "--to", "step", "-o", tmp_path / "a.c")
    assert outcome.code == 2
    assert "step" in outcome.err


def test_a_title_of_any_characters_makes_no_wrong_xml() -> None:
    changed = {"title": "a--->b & <c> \x01 ü--", "name": 'n"<\x02'}
    robot = load_robot("linear-delta").changed(**changed)
    chosen = Model(robot, prior_parameters(robot), "--.yaml")
    made = fmu(chosen, "a", forward=True, compiler=Compiler((), ()))
    unit = zipfile.ZipFile(io.BytesIO(made.parts[".fmu"]))
    for text in (mjcf(chosen), urdf(chosen).text(".urdf"), unit.read("modelDescription.xml")):
        root = ElementTree.fromstring(text)
        assert "ü" in (root.get("description") or "ü")
    name = ElementTree.fromstring(urdf(chosen).text(".urdf")).get("name")
    assert name == 'n"<'


def test_command_takes_a_model(tmp_path: Path) -> None:
    """What is exported are the identified parameters, and not the prior."""
    found = identified("linear-delta")
    accepted("export", found.model_file, "--to", "npz", "-o", tmp_path)
    exported = np.load(tmp_path / "linear_delta.npz")["p"]
    assert (exported == IdentifiedModel.load(found.model_file).p).all()
    assert (exported != prior_parameters(found.robot)).any()


@pytest.mark.slow
def test_examples_of_the_documentation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fmu_binaries, "find_spec", lambda _: None)  # other systems have a test
    chosen = subject("irb360-6-1600")
    z, _, qd, qdd = (part[0] for part in states(chosen, 1))
    tau = model(chosen, z[None], qd[None], qdd[None]).tau[0]
    for target in TARGETS:
        if target != "fmu-inverse":
            export(chosen, target, tmp_path / f"irb360{TARGETS[target].suffixes[0]}")
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "export.md").read_text(encoding="utf-8")
    examples = [text for _, text in blocks(page, "python") if not text.startswith("--8<--")]
    assert len(examples) == 6
    for text in examples:
        scope = {"z": z, "qd": qd, "qdd": qdd, "tau": tau}
        exec(text, scope)
        if "casadi" in text:
            assert_close(np.array(scope["tau"]).ravel(), tau, 1e-12)
        if "pinocchio" in text:
            assert np.isfinite(scope["acceleration"]).all()
        if "fmpy" in text:
            assert scope["out"]["q1"][-1] != scope["out"]["q1"][0]


def test_friction_that_a_target_lacks_is_refused_or_excluded(tmp_path: Path) -> None:
    robot = tmp_path / "robot.yaml"
    law = "drive1: {viscous: 1.5, coulomb: 5.0"
    text = catalogue_text("clavel-delta3")
    assert law in text
    robot.write_text(text.replace(law, f"{law}, load: 0.1"), encoding="utf-8")
    for target in ("mjcf", "urdf"):
        output = tmp_path / f"robot{TARGETS[target].suffixes[0]}"
        refusal = refused("export", robot, "--to", target, "-o", output, folder=tmp_path)
        assert "has load.drive1" in refusal.replace("\n", " ")
        assert "--without-friction" in refusal
        accepted("export", robot, "--to", target, "-o", output, "--without-friction")
        output.unlink()
        done = accepted("export", robot, "--to", target, "-o", output, "--plain-friction")
        assert "drive1 is off by" in done.err.replace("\n", " ")
        output.unlink()
    path = tmp_path / "bare.npz"
    accepted("export", robot, "--to", "npz", "-o", path, "--without-friction")
    data = np.load(path)
    assert len(data["friction_coefficient"]) == 7
    assert not data["friction_coefficient"].any()


def test_command_does_not_overwrite_its_model(tmp_path: Path) -> None:
    model = tmp_path / "model.npz"
    model.write_text(accepted("robots", "clavel-delta3").out)
    refusal = refused("export", model, "--to", "npz", "-o", model, folder=tmp_path)
    assert "would overwrite an input" in refusal


def test_functions_of_jax_without_jax(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("deltaid.libraries.find_spec", lambda name: None)
    with pytest.raises(DeltaidError, match="needs JAX, which is not installed"):
        deltaid.jax_functions("clavel-delta3")
