"""Lists of what one can buy: read, and refused with the place of what is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from deltaid.errors import DeltaidError, DescriptionError
from deltaid.robot.load import parse
from deltaid.sensors.planning.bench import PlanSettings
from deltaid.sensors.planning.offers import Offers, load_offers, shipped_offers, shipped_text
from deltaid.sensors.planning.plan import sensor_plan
from descriptions import refusal

DELTA = "clavel-delta3"
LIST = """\
offers:
  scale:
    title: scale
    price: 20
    weigh: {quantity: mass, std: 0.001}
"""


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("quantity: mass, std: 0.001", "quantity: mass", "gives neither std nor share"),
        ("quantity: mass", "quantity: weight", "offers.scale.weigh.quantity"),
        ("quantity: mass", "quantity: mass, axis: x", "a mass has no axis"),
        ("quantity: mass", "quantity: inertia", "inertia needs its axis"),
        ("quantity: mass", "quantity: centre, axis: x, of: limb", "centre of a limb"),
        ("quantity: mass", "quantity: inertia, axis: [0, 0, 0]", "weigh.axis: has no direction"),
        ("quantity: mass, std: 0.001", "quantity: centre, axis: x, share: 0.1", "needs std, in m"),
        ("price: 20", "price: -1", "line 4, offers.scale.price"),
        ("price: 20", "cost: 20", "offers.scale.cost: unknown key"),
        ("    price: 20\n", "", "offers.scale.price: is missing"),
        ("    weigh: {quantity: mass, std: 0.001}\n", "", "nothing to do with it"),
        ("weigh:", "sensors: {g: {kind: joint-torque, drive: each}}\n    weigh:", "weigh and"),
        ("weigh: {quantity: mass, std: 0.001}", "sensors: {g: {kind: bathroom}}", "bathroom"),
        ("scale:", "a scale:", "a scale"),
    ],
)
def test_bad_lists_are_refused(old: str, new: str, said: str) -> None:
    assert old in LIST
    message = refusal(LIST.replace(old, new, 1), Offers)
    assert said in message
    assert "deltaid schema sensors" in message


@pytest.mark.parametrize(
    ("weigh", "said"),
    [
        ({"quantity": "mass", "of": "X", "std": 1e-3}, "has no body 'X'"),
        ({"quantity": "mass", "of": {"S": 2, "Q": 1}, "std": 1e-3}, "has no body 'Q'"),
        ({"quantity": "first_moment", "of": "P", "axis": "x", "share": 0.01}, "is zero at the"),
    ],
)
def test_lists_that_do_not_fit_the_robot_are_refused(weigh: dict, said: str) -> None:
    listed = Offers.model_validate({"offers": {"a": {"title": "a", "price": 1, "weigh": weigh}}})
    with pytest.raises(DescriptionError, match=said):
        sensor_plan(DELTA, offers=listed)


def test_what_cannot_be_asked_for_is_refused() -> None:
    with pytest.raises(DeltaidError, match="no goal 'Q'"):
        sensor_plan(DELTA, goal="Q")
    with pytest.raises(DeltaidError, match="nothing called 'scale:S'"):
        sensor_plan(DELTA, combinations=[("scale:S",)])
    with pytest.raises(DeltaidError, match="no goal"):
        sensor_plan(DELTA, goal="gains", settings=PlanSettings(gain_spread=0.0))
    with pytest.raises(DescriptionError, match="no such file"):
        sensor_plan(DELTA, offers="nowhere.yaml")


def test_the_shipped_list_is_a_file_of_its_own_kind(tmp_path: Path) -> None:
    path = tmp_path / "list.yaml"
    path.write_text(shipped_text(), encoding="utf-8")
    assert load_offers(path) == shipped_offers()
    assert parse(LIST, Offers, where="x").offers["scale"].weighs[0].of == "each"
