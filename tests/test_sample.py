"""Files of models and of their draws: records, arrays, ensembles, refusals, what is beside them."""

import csv
from pathlib import Path

import mujoco
import numpy as np
import pytest
from ruamel.yaml import YAML

import deltaid
from command import accepted, json_of, run
from deltaid.dynamics.parameters import least_margin
from deltaid.errors import DeltaidError, DescriptionError
from deltaid.identification.identify import identify
from deltaid.identification.judgement import base_covariance
from deltaid.model.model import Model, load
from deltaid.model.record import IdentifiedModel
from deltaid.recording.mapping import ColumnMapping
from identified import identified
from posteriors import ROBOT, hasten
from test_loads import table


@pytest.fixture(autouse=True)
def _hastened(monkeypatch: pytest.MonkeyPatch) -> None:
    hasten(monkeypatch)


@pytest.fixture
def model() -> IdentifiedModel:
    return identified("stout").result.model


@pytest.fixture
def model_file() -> Path:
    return identified("stout").model_file


def test_files_of_earlier_versions_and_robots_are_refused(model_file: Path, tmp_path) -> None:
    yaml, path = YAML(typ="safe"), tmp_path / "old.yaml"
    content = yaml.load(model_file)
    del content["posterior"]
    content["format"] = 3
    yaml.dump(content, path)
    old = load(path)
    with pytest.raises(DescriptionError, match=r"kept no posterior.*\n.*identify it again"):
        old.sample(10)
    with pytest.raises(DescriptionError, match="is a robot with its prior"):
        load(ROBOT).sample(10)


@pytest.mark.parametrize(
    ("change", "fragment"),
    [
        (lambda c: c["values"].pop(), "combinations for"),
        (lambda c: c["factor"].pop(), "lower triangle"),
        (lambda c: c["factor"][0].__setitem__(0, -1.0), "positive diagonal"),
        (lambda c: c["unseen"].append("X.m"), "X.m, which is no parameter"),
    ],
)
def test_a_damaged_record_is_named(model_file: Path, tmp_path, change, fragment: str) -> None:
    yaml, path = YAML(typ="safe"), tmp_path / "model.yaml"
    content = yaml.load(model_file)
    change(content["posterior"])
    yaml.dump(content, path)
    with pytest.raises(DescriptionError) as caught:
        load(path)
    assert fragment in str(caught.value)


def test_the_command_writes_arrays(model_file: Path, tmp_path: Path) -> None:
    output = tmp_path / "new" / "models.npz"
    said = json_of("sample", model_file, "-n", 50, "--seed", 3, "-o", output)
    arrays = np.load(output)
    assert arrays["p"].shape == (50, len(arrays["names"]))
    np.testing.assert_array_equal(arrays["p"], load(model_file).sample(50, seed=3).p)
    assert said["models"] == 50
    assert said["rhat"] == arrays["rhat"].max()
    assert [parameter["unit"] for parameter in said["parameters"]] == arrays["units"].tolist()
    wrong = run("sample", model_file, "-o", tmp_path / "models.txt")
    assert wrong.code == 2
    assert "must end in .npz" in wrong.err
    assert run("sample", model_file, "-n", 0, "-o", output).code == 2


def test_the_command_writes_models_for_mujoco(model_file: Path, tmp_path: Path) -> None:
    folder = tmp_path / "ensemble"
    words = ("sample", model_file, "-n", 3, "--to", "mjcf", "--limb-tolerance", 0.05)
    accepted(*words, "-o", folder)
    with (folder / "index.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {path.name for path in folder.iterdir()} == {"index.csv", *(r["file"] for r in rows)}
    masses = []
    for row in rows:
        loaded = mujoco.MjModel.from_xml_path(str(folder / row["file"]))
        names = [loaded.body(i).name for i in range(loaded.nbody)]
        mass = dict(zip(names, loaded.body_mass.tolist(), strict=True))
        arms = sorted(m for name, m in mass.items() if name.startswith("U"))
        assert arms == pytest.approx(sorted(float(row[f"U{i}.m"]) for i in (1, 2, 3)))
        masses.append(loaded.body_mass.sum())
        state = mujoco.MjData(loaded)
        mujoco.mj_step(loaded, state)
        assert np.all(np.isfinite(state.qacc))
    assert len(set(masses)) == 3
    again = run(*words, "-o", folder)
    assert again.code == 2
    assert "is there already" in again.err


def test_a_folder_that_fails_leaves_nothing(
    model: IdentifiedModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from deltaid.exports import mjcf

    written, plain = list[str](), mjcf.mjcf

    def fails(drawn: Model) -> str:
        written.append(drawn.source)
        if len(written) == 2:
            raise DeltaidError("no more")
        return plain(drawn)

    monkeypatch.setattr(mjcf, "mjcf", fails)
    with pytest.raises(DeltaidError, match="no more"):
        model.sample(3).mjcf(tmp_path / "folder")
    assert len(written) == 2
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("held", [pytest.param("cycles", marks=pytest.mark.slow), "always"])
def test_what_is_beside_the_robot_is_averaged_out(held: str) -> None:
    """Against the joint normal distribution of base parameters and of what is beside them."""
    columns = ColumnMapping(load=deltaid.Load(column="gripper"))
    found = identify(ROBOT, table(3, held, ROBOT), columns=columns)
    problem, record = found.problem.with_own_friction, found.model.posterior
    assert record is not None
    assert problem.layout.added >= 10
    own, base = len(problem.p), problem.base
    K, robots = base.combination(), np.array([g.representative < own for g in base.groups])
    r, added = int(robots.sum()), problem.layout.added
    design = np.zeros((len(K), r + added))
    design[robots, :r] = np.eye(r)
    design[:, r:] = K[:, own:]
    scale = np.array([parameter.scale for parameter in problem.layout.parameters[own:]])
    prior = np.array([parameter.prior for parameter in problem.layout.parameters[own:]])
    size = np.sqrt(np.diag(base_covariance(problem)))
    information = np.linalg.inv(base_covariance(problem) / np.outer(size, size))
    unit = np.concatenate([size[robots], record.spread * scale])
    scaled = design / size[:, None] * unit
    H = scaled.T @ information @ scaled
    H[r:, r:] += np.eye(added)
    g = scaled.T @ information @ (problem.estimate.values / size)
    g[r:] += prior / (record.spread * scale)
    joint = np.linalg.inv(H)
    values = (joint @ g)[:r] * unit[:r]
    std = np.sqrt(np.diag(joint)[:r]) * unit[:r]
    np.testing.assert_allclose(np.linalg.norm(record.root, axis=1), std, rtol=1e-4)
    assert np.abs(np.array(record.values) - values).max() < 1e-3 * np.abs(values).max()
    assert np.all(np.abs(np.array(record.values) - values) < 1e-2 * std)
    wider = std / np.sqrt(np.diag(base_covariance(problem)))[robots]
    assert (wider.max() > 2) == (held == "always")
    assert min(least_margin(found.model.layout, p)[1] for p in found.model.sample(20).p) > 0
