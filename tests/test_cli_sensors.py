"""`deltaid sensors`: tables, JSON, page, a list of one's own, and what is refused."""

from pathlib import Path

import pytest

from command import accepted, json_of, refused, run
from deltaid.sensors.planning.offers import load_offers, shipped_offers

DELTA = "clavel-delta3"


def test_tables_name_what_stays_open_and_what_to_buy() -> None:
    outcome = accepted("sensors", DELTA, "--goal", "P", "--budget", 100, "--full", width=300)
    for said in (
        "a random motion within the robot's limits",
        "all ten entries of each are unknown",
        "what to buy next for body P",
        "mass at the elbow's ball joints may pass between upper arm and strut",
        "kitchen-scale:S, kitchen-scale:P, lab-scale:S",
        "nothing else in the list is worth it, or within the budget",
    ):
        assert said in outcome.out, said


def test_json_has_what_the_tables_say() -> None:
    found = json_of("sensors", DELTA, "--combine", "edge:S,kitchen-scale:P", "--steps", 2)
    assert found["described"] is None
    assert found["combinations"][0]["name"] == "edge:S + kitchen-scale:P"
    assert len(found["steps"]) == 2
    torques, plan = found["torques"]["std"], found["steps"][-1]["std"]
    assert all(plan[name] <= torques[name] * (1 + 1e-9) for name in torques)
    opened = {opening["with"]: opening for opening in found["open"]}
    assert (opened["torques"]["visible"], opened["torques"]["rank"]) == (20, 18)
    assert len(opened["plan"]["directions"]) == opened["plan"]["visible"] - opened["plan"]["rank"]
    assert set(opened) == {"torques", "plan", *(use["name"] for use in found["uses"])}


def test_the_list_is_printed_and_read_again(tmp_path: Path) -> None:
    path = tmp_path / "list.yaml"
    path.write_text(run("sensors", DELTA, "--list").out, encoding="utf-8")
    assert load_offers(path) == shipped_offers()
    cheap = path.read_text("utf-8").replace("price: 8000", "price: 0").replace("hours: 16", "")
    path.write_text(cheap, encoding="utf-8")
    found = json_of("sensors", DELTA, "--sensors", path)
    assert found["steps"][0]["name"] == "plate-tared"
    assert run("sensors", DELTA, "--list", "--sensors", path).out == cheap
    path.write_text(cheap.replace("price: 0", "price: much"), encoding="utf-8")
    assert "price" in refused("sensors", DELTA, "--list", "--sensors", path, folder=tmp_path)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--goal", "Q"), "choose from bodies, forces, gains, U, S, P"),
        (("--combine", "edge:Q"), "has no use 'edge:Q'\n  → did you mean edge:"),
        (("--entries", "S.mcx,Q.m"), "no entry 'Q.m'"),
        (("--budget", "0"), "must be a positive number"),
        (("--enough", "2"), "must lie between"),
        (("--gain-spread", "nan"), "must lie between"),
        (("--sensors", "nowhere.yaml"), "no such file"),
        (("nowhere.csv",), "nowhere.csv"),
        (("--report", "page.txt"), "must end in .html"),
    ],
)
def test_what_cannot_be_is_refused_in_one_message(
    arguments: tuple[str, ...], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert said in refused("sensors", DELTA, *arguments, folder=tmp_path)


def test_a_mechanism_of_ones_own_and_its_page(tmp_path: Path) -> None:
    folder = Path(__file__).parents[1] / "examples" / "planar_delta"
    page = tmp_path / "page.html"
    outcome = accepted(
        "--mechanism", folder / "mechanism.py", "sensors", folder / "robot.yaml",
        "--report", page, "--full", width=300,
    )  # fmt: skip
    assert "mass where arm and rod meet may pass between arm and rod" in outcome.out
    text = page.read_text(encoding="utf-8")
    assert "gauges at the platform" in text  # the robot has no place for them: told
    assert "What stays open" in text
    verdict = text[text.index('<div class="verdict untested"') :]
    assert "directions stay open." in verdict[: verdict.index("</div>")]
    assert "Buy " in verdict[: verdict.index("</div>")]
