"""Directions of a null space that have no name, and what is not seen at all."""

from __future__ import annotations

import numpy as np
import pytest

from deltaid.dynamics.parameters import parameter_layout
from deltaid.robot.inertia import pseudo_inertia
from deltaid.robot.load import load_robot
from deltaid.sensors.planning.exchange import point_mass
from deltaid.sensors.planning.null_space import null_space, whole_null_space


def test_what_no_proposal_explains_is_told_by_its_entries() -> None:
    layout = parameter_layout(load_robot("clavel-delta3"))
    names, rng = layout.names, np.random.default_rng(0)
    at = [names.index(name) for name in ("U.m", "S.mcx", "P.Izz")]
    rows = np.zeros((40, len(names)))
    rows[:, at[:2]] = rng.standard_normal((40, 2))
    rows[:, at[2]] = rows[:, at[0]] - 2 * rows[:, at[1]]
    null = null_space(rows, layout, ())
    assert (null.visible, null.rank) == (3, 2)
    assert null.directions[0].words == "a combination of U.m, S.mcx, P.Izz"
    d = null.directions[0].direction[at]
    assert d / d[2] == pytest.approx([-1.0, 2.0, 1.0])
    assert len(null.invisible) == len(names) - 3


def test_what_is_left_beside_named_directions_is_told_sparsely() -> None:
    layout = parameter_layout(load_robot("clavel-delta3"))
    rng = np.random.default_rng(1)
    rows = np.zeros((40, len(layout.names)))
    a, b, c, d = 0, 1, 10, 11
    rows[:, [a, c]] = rng.standard_normal((40, 2))
    rows[:, b], rows[:, d] = rows[:, a], rows[:, c]
    from deltaid.sensors.planning.exchange import Exchange

    named = np.zeros(len(layout.names))
    named[[a, b]] = 1.0, -1.0
    null = null_space(rows, layout, [Exchange("the first two", named)])
    assert [one.words for one in null.directions] == [
        "the first two",
        f"a combination of {layout.names[c]}, {layout.names[d]}",
    ]


def test_a_point_mass_is_a_body() -> None:
    r = np.array([0.3, -0.2, 0.5])
    M = pseudo_inertia(2.0 * point_mass(r))
    assert np.allclose(M, 2.0 * np.outer([*r, 1.0], [*r, 1.0]))


def test_a_whole_null_space_holds_what_is_not_seen_at_all() -> None:
    layout = parameter_layout(load_robot("clavel-delta3"))
    rows = np.zeros((5, len(layout.names)))
    rows[:, 3:5] = np.random.default_rng(0).standard_normal((5, 2))
    basis = whole_null_space(rows, layout)
    assert basis.shape == (len(layout.names), len(layout.names) - 2)
    assert np.abs(rows * [one.scale for one in layout.parameters] @ basis).max() < 1e-9


def test_what_is_weaker_than_a_billionth_of_the_strongest_is_open() -> None:
    """n columns of length 1 that are nearly the same have singular values √n and √n ε."""
    layout = parameter_layout(load_robot("clavel-delta3"))
    scale = np.array([one.scale for one in layout.parameters])
    n = len(scale)
    for small, dimension in ((3e-9, n - 1), (3e-8, n - 2)):
        turned = small / np.sqrt(n) * np.where(np.arange(n) % 2, 1.0, -1.0)
        rows = np.vstack([np.ones(n), turned]) / scale
        assert whole_null_space(rows, layout).shape == (n, dimension)
