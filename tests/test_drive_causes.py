"""Faults of recordings that nobody named (`tests/drives/causes.py`): they are what they say."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import maximum_filter1d

from deltaid.dynamics.dynamics import compiled
from deltaid.robot.inertia import pseudo_inertia
from drives import CAUSES, ROWS, Case, case
from drives.errors import half_range
from drives.happening import Happening, Law
from drives.made import Made
from drives.measured import falling_gain, gains, offsets, saturation
from drives.mixture import MIXED
from drives.pulls import Balancer, Cable, Hose
from drives.sensors import Sensors
from oracle.tree import Array
from plants import Truth

# Where what is recorded is compared: samples far from one another.
EVERY = 997


@cache
def case_of(row: str) -> Case:
    return case(row, "linear", 1)


def undisturbed(happening: Happening) -> Happening:
    return replace(happening, pulls=())


def recorded(of: Case, name: str) -> Array:
    return of.logs[0].select(f"{name}{i + 1}" for i in range(of.machine.dof)).to_numpy()


def through_drives(of: Case, truth: Truth, F: Array) -> Array:
    """Jᵀ F with J = (∂q/∂r)⁻¹ by differences of the oracle's positions."""
    J = of.machine.plant.oracle.jacobian(truth.z[::EVERY])
    return np.linalg.solve(J.transpose(0, 2, 1), F[::EVERY, :, None])[:, :, 0]


def test_a_force_at_the_platform_is_in_the_torques_by_the_oracles_jacobian() -> None:
    of = case_of("force")
    happening, (pull,) = of.happenings[0], of.happenings[0].pulls
    assert isinstance(pull, Hose)
    np.testing.assert_allclose(np.linalg.norm(pull.force), 5 * of.unit)
    more = happening.truth.tau - undisturbed(happening).truth.tau
    F = np.broadcast_to(pull.force, (len(more), 3))
    np.testing.assert_allclose(-more[::EVERY], through_drives(of, happening.truth, F), rtol=1e-6)


def test_a_hose_takes_the_power_that_its_force_gives() -> None:
    of = case_of("hose")
    happening = of.happenings[0]
    (pull,), truth = happening.pulls, happening.truth
    assert isinstance(pull, Hose)
    more = truth.tau - undisturbed(happening).truth.tau
    v = truth.zd[:, :3]
    away = truth.z[:, :3] - pull.rest
    given = v @ pull.force - pull.drag * np.linalg.norm(v, axis=1)
    given -= pull.stiffness * np.einsum("sk,sk->s", v, away)
    np.testing.assert_allclose(-np.einsum("sd,sd->s", more, truth.qd), given,
                               atol=1e-6 * np.abs(given).max())  # fmt: skip


def test_a_cable_gives_the_power_that_it_loses_as_its_length_changes() -> None:
    of = case_of("cable")
    happening = of.happenings[0]
    (cable,), truth = happening.pulls, happening.truth
    assert isinstance(cable, Cable)
    more = truth.tau - undisturbed(happening).truth.tau
    x, dx = truth.z[:, :3], 1e-6 * truth.zd[:, :3]
    taut = [np.linalg.norm(at - cable.anchor, axis=1) - cable.slack for at in (x - dx, x + dx)]
    taken = 0.5 * cable.stiffness * (taut[1] ** 2 - taut[0] ** 2) / 2e-6
    np.testing.assert_allclose(np.einsum("sd,sd->s", more, truth.qd), taken,
                               atol=1e-6 * np.abs(taken).max())  # fmt: skip
    middle = of.machine.plant.path[:, :3].mean(axis=0)
    stretch = np.linalg.norm(middle - cable.anchor) - cable.slack
    assert cable.stiffness * stretch == pytest.approx(5 * of.unit)


def test_a_balancer_is_a_spring_of_a_share_of_the_torque() -> None:
    of = case_of("balancer")
    happening, truth = of.happenings[0], of.happenings[0].truth
    (spring,) = happening.pulls
    assert isinstance(spring, Balancer)
    more = truth.tau - undisturbed(happening).truth.tau
    np.testing.assert_allclose(more, spring.stiffness * (truth.q - spring.rest), atol=1e-9)
    share = np.abs(more).max(axis=0) / of.machine.largest_torque
    assert np.all((share > 0.02) & (share < 0.11))


@pytest.mark.parametrize("size", [0.03, 0.15])
def test_true_torque_falls_behind_what_the_drive_believes(size: float) -> None:
    start = Made(case_of("force").happenings[0], Sensors())
    believed = falling_gain(start, np.random.default_rng(0), size).sensors.believed
    assert believed is not None
    true = np.linspace(-1.05, 1.05, 43)
    r = believed(true)
    np.testing.assert_allclose(r * (1 - size * (r / believed(np.ones(1))) ** 2), true, atol=1e-12)
    assert np.all(np.diff(r) > 0)


def test_motors_saturate_at_a_share_of_the_largest_that_is_recorded() -> None:
    start = Made(case_of("force").happenings[0], Sensors())
    believed = saturation(start, np.random.default_rng(0), 0.9).sensors.believed
    assert believed is not None
    true = np.linspace(-1, 1, 41)
    limit = 0.9 * believed(np.ones(1))
    np.testing.assert_allclose(limit * np.tanh(believed(true) / limit), true, atol=1e-12)


def test_a_gear_ratio_that_is_off_scales_one_angle() -> None:
    of = case_of("gear-ratio")
    ratio = np.median(recorded(of, "q") / of.happenings[0].truth.q, axis=0)
    np.testing.assert_allclose(np.sort(ratio), [1, 1, 1.01], atol=1e-5)


def test_one_limb_is_longer_than_the_description_has_it() -> None:
    of = case_of("long-limb")
    limbs = of.machine.plant.oracle.limbs
    longer = [
        np.subtract((limb.arm or 0, limb.strut), (described.upper_arm or 0, described.strut)).sum()
        for limb, described in zip(limbs, of.robot.limbs.geometry(), strict=True)
    ]
    np.testing.assert_allclose(np.sort(longer), [0, 0, 1e-3], atol=1e-12)
    M = [of.machine.plant.oracle.mass_matrix(z) for z in of.machine.poses]
    np.testing.assert_allclose(of.machine.M, M)


def test_a_tilted_base_is_another_gravity() -> None:
    of = case_of("tilt")
    gravity, level = of.machine.plant.oracle.gravity, np.array(of.robot.gravity)
    assert gravity @ level / (level @ level) == pytest.approx(np.cos(np.deg2rad(2)))
    truth = of.happenings[0].truth
    moving = np.all(truth.rates != 0, axis=1)
    tilted = compiled(of.robot.model_copy(update={"gravity": tuple(gravity.tolist())}))
    states = (x[moving][::EVERY] for x in (truth.q, truth.qd, truth.qdd))
    tau = tilted.inverse_dynamics(*states, of.machine.plant.p)
    np.testing.assert_allclose(tau, truth.tau[moving][::EVERY],
                               atol=1e-5 * np.abs(truth.tau).max())  # fmt: skip


def test_zeros_alone_are_off_and_nothing_says_so() -> None:
    of = case_of("homing-0.5")
    error = np.median(recorded(of, "q") - of.happenings[0].truth.q, axis=0)
    np.testing.assert_allclose(error, of.sensors[0].homing, atol=1e-6)
    assert of.machine.plant.oracle.limbs[0].strut == of.robot.limbs.geometry()[0].strut
    assert of.tells == ()
    assert np.all(error != 0)


def test_ripple_is_a_share_of_the_largest_torque() -> None:
    of = case_of("ripple")
    quiet = replace(of.sensors[0], ripple=0.0).recorded(of.happenings[0])
    wave = recorded(of, "tau") - quiet.select("tau1", "tau2", "tau3").to_numpy()
    largest = np.abs(of.happenings[0].truth.tau).max(axis=0)
    np.testing.assert_allclose(np.abs(wave).max(axis=0), 0.03 * largest, rtol=1e-3)


def test_rows_of_the_second_table_have_names_of_their_own_and_words() -> None:
    assert not ROWS.keys() & CAUSES.keys()
    assert case_of("hose-tilted").drawn[1] == "tilt 1°"


def test_a_curve_off_by_a_constant_has_the_right_shape() -> None:
    curve = np.array([-2.0, -1.0, 1.0, 3.0])
    assert half_range(curve + 0.3 - curve) == pytest.approx(0, abs=1e-12)
    assert half_range(np.array([0.1, 0.3])) == pytest.approx(0.1)


def test_bodies_are_off_what_their_description_frees() -> None:
    of, plain = case_of("asymmetric"), case_of("force").machine
    layout, p = of.machine.layout, of.machine.plant.p
    for body, off in (("S", 1e-3), ("C", 4e-3)):
        part = layout.body(body)
        moved = p[part][1:4] / p[part][0] - plain.plant.p[part][1:4] / plain.plant.p[part][0]
        assert np.linalg.norm(moved) == pytest.approx(off)
    S = layout.body("S")
    assert p[S][1] == pytest.approx(plain.plant.p[S][1])  # along its axis nothing moves
    J, straight = (pseudo_inertia(x[S]) for x in (p, plain.plant.p))
    about = [x[:3, :3] - np.outer(x[:3, 3], x[:3, 3]) / x[3, 3] for x in (J, straight)]
    np.testing.assert_allclose(*(np.linalg.eigvalsh(x) for x in about), rtol=1e-6)
    assert abs(about[0][0, 1:]).max() > 1e-3 * about[0][0, 0]
    assert not np.allclose(of.machine.M, plain.M, rtol=1e-6)


def test_a_body_askew_is_turned_about_its_joint() -> None:
    both = (case_of("askew").machine, case_of("force").machine)
    S = both[0].layout.body("S")
    turned, plain = (m.plant.p[S][1:4] / m.plant.p[S][0] for m in both)
    assert np.linalg.norm(turned - plain) > 2e-3
    assert abs(np.linalg.norm(turned) - np.linalg.norm(plain)) < 1e-3


def test_a_bodys_true_shape_is_in_its_torques() -> None:
    of = case_of("asymmetric")
    truth, p = of.happenings[0].truth, of.machine.plant.p
    moving = np.all(truth.rates != 0, axis=1)
    states = (x[moving][::EVERY] for x in (truth.q, truth.qd, truth.qdd))
    tau = compiled(of.robot).inverse_dynamics(*states, p)
    np.testing.assert_allclose(tau, truth.tau[moving][::EVERY],
                               atol=1e-5 * np.abs(truth.tau).max())  # fmt: skip


def test_a_mixture_is_drawn_by_its_seed_from_all_causes() -> None:
    start = Made(case_of("force").happenings[0], Sensors())
    found = [CAUSES["mixture"].make(start, np.random.default_rng(seed)) for seed in range(16)]
    assert {len(mixture.words) for mixture in found} == {3, 4, 5}
    again = CAUSES["mixture"].make(start, np.random.default_rng(3))
    assert again.words == found[3].words
    assert len({mixture.words for mixture in found}) == len(found)
    of = case_of("mixture")
    assert 3 <= len(of.drawn) <= 5
    assert np.all(np.isfinite(of.logs[0].to_numpy()))


@pytest.mark.parametrize("name", MIXED)
def test_every_cause_of_a_mixture_changes_what_is_recorded(name: str) -> None:
    happening = replace(undisturbed(case_of("force").happenings[0]), duration=6.0)
    cause, _, largest = MIXED[name]
    start = Made(happening, Sensors())
    made = cause(start, np.random.default_rng(5), largest)
    assert len(made.words) == 1
    plain, changed = (x.sensors.recorded(x.happening).to_numpy() for x in (start, made))
    assert np.all(np.isfinite(changed))
    assert np.abs(changed - plain).max() > 0


def test_hard_play_is_a_dead_zone_and_changes_its_side_at_once() -> None:
    happening = undisturbed(case_of("force").happenings[0])
    half = 5e-5
    soft, hard = (
        replace(happening, backlash=np.full(3, 2 * half), hard=is_hard) for is_hard in (False, True)
    )
    link = hard.link(hard.truth_at(hard.time))
    changes = np.diff(np.sign(link), axis=0, prepend=np.sign(link[:1])) != 0
    away = ~maximum_filter1d(changes, 2 * round(8e-3 * happening.machine.rate) + 1, axis=0)
    soft_gap, hard_gap = (np.abs(x.truth.q - x.truth_at(x.time).q)[away] for x in (soft, hard))
    np.testing.assert_allclose(hard_gap, half, rtol=1e-6)
    assert soft_gap.min() < 0.9 * half


def test_coulomb_friction_by_direction_alone_is_a_constant() -> None:
    law = Law(np.full(2, 1.5), np.full(2, 5.0), bias=np.array([0.1, -0.1]))
    v = np.array([[-2.0, -2.0], [2.0, 2.0]])
    plain = replace(law, bias=0.0).curve(v)
    np.testing.assert_allclose(law.curve(v) - plain, [[0.5, -0.5]] * 2)


def test_gains_and_offsets_leave_the_scale_and_the_weight_alone() -> None:
    start = Made(undisturbed(case_of("force").happenings[0]), Sensors())
    rng = np.random.default_rng(2)
    gain = gains(start, rng, 0.05).sensors.gain
    assert np.prod(gain) == pytest.approx(1)
    assert np.abs(np.log(gain)).max() == pytest.approx(np.log(1.05))
    offset = np.asarray(offsets(start, rng, 0.02).sensors.offset)
    assert np.sum(offset * start.machine.largest_torque) == pytest.approx(0, abs=1e-9)
    assert np.abs(offset).max() == pytest.approx(0.02)
