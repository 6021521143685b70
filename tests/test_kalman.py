"""The Kalman filters of `ff-filter`: their gains, the process noise that they assume, what they estimate."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from baselines import make_policy
from baselines.policies.kalman import Factors, Kalman, filters, left_out, path_jerk
from baselines.policies.parts import measured
from baselines.policies.textbook import FfFilter, FilteredGains
from formation_env import FormationConfig, configure
from formation_env.core.simulation import Simulation, seeded_key
from formation_env.physics.quadrotor import GRAVITY


def test_the_filters_gain_is_where_the_recursion_ends() -> None:
    """Kalman's recursion for the follower's filter, from an unknown start: two minutes later its gain."""
    config = configure("paper")
    h, V = config.control_period, np.diag((0.2**2, 0.1**2))
    G, push = np.array((h * h / 2.0, h)), left_out(config).own_push
    S, K_now = 1e3 * np.eye(2), np.zeros((2, 2))
    F = np.array(((1.0, h), (0.0, 1.0)))
    for _ in range(6000):
        K_now = S @ np.linalg.inv(S + V)
        S = F @ (S - K_now @ S) @ F.T + push**2 * np.outer(G, G)
    assert filters(config, Factors()).own.K[-1] == pytest.approx(K_now, rel=1e-3)
    for f in filters(config, Factors())[:2]:
        k = f.K.shape[-1]
        assert np.abs(np.linalg.eigvals(f.F - f.K[-1] @ f.F[:k])).max() < 1.0
        # From the first estimate down to it: the position's gain falls from a half or so, like 1 / tick.
        assert f.K[0, 0, 0] > 0.2 and f.K[-2] == pytest.approx(f.K[-1], abs=1e-3)
        assert (np.diff(f.K[:20, 0, 0]) < 0.0).all()


def test_without_noise_the_filter_passes_on_what_is_measured() -> None:
    for f in filters(configure("nominal"), Factors())[:2]:
        assert f.K == pytest.approx(np.broadcast_to(np.eye(*f.K.shape[1:]), f.K.shape), abs=2e-3)


def test_estimates_are_nearer_to_the_truth_than_measurements() -> None:
    """On `paper`, ten seconds and more after the trigger: ten times nearer."""
    config = configure("paper")
    policy, simulation = make_policy("ff-filter", config), Simulation(config, 4)
    for i in range(4):
        simulation.seed(i, seeded_key(i))
    policy.reset(seed=0, worlds=4)
    rows = simulation.reset().observations
    kalman: Any = policy.estimator  # type: ignore[attr-defined]
    assert isinstance(kalman, Kalman)
    errors = []
    for tick in range(1800):
        actions = policy.act(rows)
        if tick > 1200:
            m, truth = measured(rows, config), simulation.positions
            pairs = (
                (m.motion.p, kalman._own[..., 0, :], truth[:, 1:]),
                (m.leader.p, kalman._lead[..., 0, :], truth[:, :1]),
            )
            errors.append([[((x - true) ** 2).mean() for x in (a, b)] for a, b, true in pairs])
        rows = simulation.step(actions).observations
    rms = np.sqrt(np.mean(errors, axis=0))
    assert rms[:, 0] == pytest.approx(0.2, rel=0.05)
    assert (rms[:, 1] < 0.1 * rms[:, 0]).all()


def truths(config: FormationConfig, ticks: int, worlds: int = 4) -> dict[str, np.ndarray]:
    """A flight of `ff-filter`: true velocities, vehicles `(ticks, worlds, 1 + n, 3)`, whether the trigger has
    fired, the accelerations that the filter takes the followers' thrust for, its leader's velocities."""
    policy, simulation = make_policy("ff-filter", config), Simulation(config, worlds)
    for i in range(worlds):
        simulation.seed(i, seeded_key(i))
    policy.reset(seed=0, worlds=worlds)
    kalman: Any = policy.estimator  # type: ignore[attr-defined]
    rows, found = simulation.reset().observations, []
    for _ in range(ticks):
        actions = policy.act(rows)
        thrust, lead = kalman._acceleration(measured(rows, config)), kalman._lead[..., 1, :]
        found.append((simulation.velocities, simulation.started, thrust, lead))
        rows = simulation.step(actions).observations
    names = ("velocities", "started", "thrust", "lead")
    return {k: np.array(v) for k, v in zip(names, zip(*found, strict=True), strict=True)}


def rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.square(x).mean()))


def test_what_the_followers_model_leaves_out_is_its_noise() -> None:
    """True accelerations less those by the thrust: by the attitude's noise in the plane, and by gusts, whose
    sum over a second that of white pushes."""
    config = configure("paper", start="formation")
    flight, h = truths(config, 600), config.control_period
    off = np.diff(flight["velocities"][:, :, 1:], axis=0) / h - flight["thrust"][1:]
    push = left_out(config).own_push
    assert push == pytest.approx(GRAVITY * config.noise.attitude)
    assert rms(off[200:, ..., :2]) == pytest.approx(push, rel=0.06)
    # White, not of the vehicle's turning: the same in sums.
    sums = off[200:575, ..., :2].reshape(15, 25, *off.shape[1:-1], 2).sum(axis=1) / 5.0
    assert rms(sums) == pytest.approx(push, rel=0.15)

    config = configure("nominal", gust=0.4, gust_time=0.06)
    flight = truths(config, 1100)
    off = np.diff(flight["velocities"][:, :, 1:], axis=0) / h - flight["thrust"][1:]
    sums = off[-1050:].reshape(21, 50, *off.shape[1:]).sum(axis=1) / np.sqrt(50.0)
    push = left_out(config).own_push
    assert push > 2.0 * config.gust and rms(sums) == pytest.approx(push, rel=0.08)


def test_the_leaders_jerk_is_of_its_noise_of_gusts_and_of_its_path() -> None:
    """Of noise: a thrust that follows at once changes by `sqrt(2) sigma_u` a tick; `k3` of it in a second
    in the plane. Of gusts: what their samples change by."""
    config = configure("paper")
    h, found = config.control_period, left_out(config)
    path = path_jerk(config.trajectory, config.span)
    by_noise = np.sqrt(found.jerk**2 - path**2)
    flight = truths(config, 1500)
    jerk = np.diff(flight["velocities"][:, :, 0], n=2, axis=0)[900:] / h**2
    wanted = by_noise / config.tracker.k3
    assert rms(jerk[..., 2]) == pytest.approx(np.sqrt(2.0) * wanted / h, rel=0.05)
    assert 0.4 < rms(jerk[..., :2]) / found.jerk < 1.2
    assert found.lead_push == pytest.approx(0.5 * h * found.jerk)
    faster = configure("paper", tracker={"k3": 20.0})
    assert np.sqrt(left_out(faster).jerk ** 2 - path**2) == pytest.approx(2.0 * by_noise)

    config = configure("nominal")
    flight, path = truths(config, 600), path_jerk(config.trajectory, config.span)
    jerk = np.diff(flight["velocities"][:, :, 0, 2], n=2, axis=0)[50:] / h**2
    assert rms(jerk) == pytest.approx(np.sqrt(left_out(config).jerk ** 2 - path**2), rel=0.05)


def test_the_jerk_of_a_path_is_its_root_mean_square() -> None:
    """(31): `A w^3 sin(w t)` and `-8 B w^3 cos(2 w t)`, over whole periods; a random one's in its bound."""
    path = configure("nominal").trajectory
    rate = 0.25
    whole = np.sqrt(0.5 * (2.0 * rate**3) ** 2 + 0.5 * (8.0 * rate**3) ** 2)
    assert path_jerk(path, 4.0 * path.period) == pytest.approx(whole, rel=2e-3)
    agile = configure("agile")
    assert 0.5 < path_jerk(agile.trajectory, agile.span) < 8.0


def test_before_the_trigger_the_leaders_velocity_is_filtered_by_itself() -> None:
    """When it fires it is known ten times better than measured, without the position, which is not known."""
    config = configure("paper")
    flight = truths(config, 700, worlds=6)
    fired = flight["started"].argmax(axis=0)
    assert (fired > 200).all()
    off = [flight["lead"][t, w] - flight["velocities"][t, w, :1] for w, t in enumerate(fired)]
    assert rms(np.array(off)) < 0.1 * config.noise.velocity


def test_a_factor_multiplies_what_is_left_out() -> None:
    """Twice the noise of process and measurement is the same filter; of one of them it is another."""
    config = configure("paper", start="formation")
    twice = config.noise._replace(**{n: 2.0 * x for n, x in config.noise._asdict().items()})
    noisier = configure(config, noise=twice)
    plain, both = left_out(config), left_out(noisier)
    alike = Factors(*(2.0 * a / b for a, b in zip(plain, both, strict=True)))
    for f, g in zip(filters(config, Factors())[:2], filters(noisier, alike)[:2], strict=True):
        assert f.K[-1] == pytest.approx(g.K[-1], rel=1e-3)
    for changed in (Factors(own_push=3.0), Factors(lead_push=3.0), Factors(jerk=3.0)):
        ours, theirs = filters(config, Factors()), filters(config, changed)
        moved = [
            not np.array_equal(f.K[-1], g.K[-1]) for f, g in zip(ours[:2], theirs[:2], strict=True)
        ]
        assert moved == [changed.own_push != 1.0, changed.own_push == 1.0]
    with pytest.raises(ValueError, match=r"factors.jerk = 0.0: expected"):
        Kalman(config, Factors(jerk=0.0))
    with pytest.raises(ValueError, match=r"gains.own_push = nan: expected"):
        FfFilter(config, FilteredGains(own_push=float("nan")))
