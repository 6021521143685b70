"""Policy files that fly: the numbers of the network, other tasks, worlds that begin anew."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from networks import ENTRIES, NOMINAL, card, looks, network
from numpy.typing import NDArray

from baselines import make_policy, registry
from baselines.files import Card, Network, save
from baselines.policies.expert import Expert
from baselines.policies.learned import Learned, Misfit
from baselines.policies.transfer import TransferWarning
from formation_env import FeasibilityWarning, configure
from formation_env.physics.vehicle import Vehicle
from formation_env.scenarios import PAPER_NOISE
from formation_env.trajectories import hover
from formation_env.validation.checks import LONGEST

# -- what flies -----------------------------------------------------------------------------------


def plainly(own: Card, numbers: Network, observation: NDArray[Any]) -> NDArray[Any]:
    """The network in double precision, one row `(history, entries)`."""
    scaled = (observation.astype(float) - numbers.mean.astype(float)) / numbers.scale.astype(float)
    x = np.clip(scaled, -own.clip, own.clip).ravel()
    last = len(numbers.weights) - 1
    for i, (weight, bias) in enumerate(zip(numbers.weights, numbers.biases, strict=True)):
        x = weight.astype(float) @ x + bias.astype(float)
        if i < last:
            x = np.tanh(x) if own.activation == "tanh" else np.maximum(x, 0.0)
    return np.clip(x, -1.0, 1.0)


@pytest.mark.parametrize("activation", ["tanh", "relu"])
@pytest.mark.parametrize("hidden", [(), (37, 51), (128, 128)])
def test_forward_pass(activation: str, hidden: tuple[int, ...]) -> None:
    own = card(activation=activation, clip=1.5)
    numbers = network(own, hidden)
    rows = looks(50)
    actions = Learned(NOMINAL, (own, numbers)).act(rows)
    expected = [plainly(own, numbers, row) for row in rows.reshape(-1, ENTRIES)]
    assert actions.dtype == np.float32
    assert actions.reshape(-1, 4) == pytest.approx(np.array(expected), abs=3e-6)
    assert (np.abs(actions) < 1.0).any() and np.ptp(actions) > 1.0


@pytest.mark.filterwarnings("ignore::baselines.policies.transfer.TransferWarning")
@pytest.mark.parametrize("hidden", [(), (37, 51), (128, 128)])
@pytest.mark.parametrize("history", [1, 3])
def test_a_row_is_independent_of_the_others(hidden: tuple[int, ...], history: int) -> None:
    """Bit for bit, however many are decided together and wherever among them it stands."""
    solo = configure("nominal", followers=1, neighbours=NOMINAL.neighbours)
    own = card(history=history)
    source = own, network(own, hidden)
    rows = looks(2, 600).reshape(2, 1200, 1, ENTRIES)

    def flown(which: slice) -> NDArray[np.float32]:
        policy = Learned(solo, source)
        return np.stack([policy.act(each[which]) for each in rows])

    whole = flown(slice(0, 1200))
    for count in (1, 7, 31, 32, 33, 64, 65, 1000, 1025):
        for start in (0, 1, 5, 17, 70):
            part = slice(start, start + count)
            assert np.array_equal(flown(part), whole[:, part]), (count, start)
    assert len(np.unique(whole)) > 1200


def test_history_is_stacked_newest_last_and_begins_anew() -> None:
    own = card(history=3)
    numbers = network(own)
    policy = Learned(NOMINAL, (own, numbers))
    seen = looks(5, 4)  # ticks, worlds
    mask = np.array([False, True, False, True])
    actions = []
    for tick, rows in enumerate(seen):
        if tick == 3:
            policy.restart(mask)
        actions.append(policy.act(rows))
    for world in range(4):
        for tick in range(5):
            first = 3 if tick >= 3 and mask[world] else 0
            ticks = [max(first, t) for t in (tick - 2, tick - 1, tick)]
            for i in range(2):
                expected = plainly(own, numbers, seen[ticks, world, i])
                assert actions[tick][world, i] == pytest.approx(expected, abs=3e-6)
    policy.reset(worlds=4)
    assert np.array_equal(policy.act(seen[0]), actions[0])


@pytest.mark.filterwarnings("ignore::baselines.policies.transfer.TransferWarning")
@pytest.mark.parametrize("level", ["wrench", "rates", "reference"])
def test_residual_policies_add_to_the_expert(level: str) -> None:
    config = configure("paper", action=level)
    own = card(config, residual=0.2)
    numbers = network(own)
    nothing = numbers._replace(
        weights=tuple(np.zeros_like(W) for W in numbers.weights),
        biases=tuple(np.zeros_like(b) for b in numbers.biases),
    )
    alone, still = Expert(config), Learned(config, (own, nothing))
    learned, output = (
        Learned(config, (own, numbers)),
        Learned(config, (replace(own, residual=0), numbers)),
    )
    rng = np.random.default_rng(3)
    for tick in range(6):
        rows = rng.normal(size=(5, 2, config.layout.size)).astype(np.float32)
        if tick == 3:
            for policy in (alone, still, learned):
                policy.restart(np.array([True, False, False, True, False]))
        expert = alone.act(rows)
        assert np.array_equal(still.act(rows), expert)
        expected = np.clip(expert + 0.2 * output.act(rows).astype(float), -1.0, 1.0)
        assert learned.act(rows) == pytest.approx(expected, abs=1e-6)


def test_a_policy_that_does_not_fit(tmp_path: Path) -> None:
    path = tmp_path / "mine.safetensors"
    save(path, card(), network(card()))
    with pytest.raises(Misfit, match=r"mine.*action level 'wrench'.*has 'rates'"):
        make_policy(str(path), configure("nominal", action="rates"))
    with pytest.raises(Misfit, match="entries 48: the configuration has 55"):
        make_policy(str(path), configure("nominal", neighbours=3))
    spoilt = network(card())._replace(mean=np.full(ENTRIES, np.nan, np.float32))
    with pytest.raises(ValueError, match="tensor mean"):
        Learned(NOMINAL, (card(), spoilt))


# -- another task than it was trained for ---------------------------------------------------------


@pytest.mark.parametrize(
    ("scenario", "given", "expected"),
    [
        ("nominal", {"followers": 3}, "flies another task: 3 followers"),
        ("nominal", {"followers": 1, "gust": 1.0}, "flies another task: 1 follower, gust"),
        ("nominal", {"followers": 64}, "64 followers"),
        ("agile", {}, "flies another task: scenario 'agile' with 2 followers"),
        ("swarm", {}, "scenario 'swarm' with 16 followers"),
        ("nominal", {"trajectory": hover((0.0, 0.0, -2.0))}, "another task: trajectory"),
        ("nominal", {"noise": PAPER_NOISE, "gust": 0.1}, "another task: noise, gust"),
        ("nominal", {"offsets": ((0.4, 0.4, 0.0), (0.4, -0.4, 0.0))}, "another task: offsets"),
        ("nominal", {"vehicle": Vehicle(mass=0.2)}, "another task: vehicle"),
    ],
)
def test_a_policy_on_a_task_it_was_not_trained_for(
    scenario: str, given: dict[str, Any], expected: str
) -> None:
    """The file of `nominal`, flown by two followers there, says in what another task differs."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FeasibilityWarning)
        config = configure(scenario, neighbours=2, **given)
    with pytest.warns(TransferWarning) as told:
        make_policy(str(registry.SHIPPED / "dagger-nominal-wrench.safetensors"), config)
    (message,) = {str(one.message) for one in told}
    said = "(dagger) trained on scenario 'nominal' at action level 'wrench' with 2 followers"
    assert message.startswith("policy ") and said in message
    assert expected in message and len(message) <= LONGEST


def test_what_a_policy_does_not_feel_is_no_other_task() -> None:
    """Starts, lengths, rewards and limits of episodes; and a scenario of one's own is what its card says."""
    rewards = NOMINAL.reward._replace(failure=1.0)
    limits = NOMINAL.limits._replace(lost=5.0)
    make_policy("dagger", configure("nominal", duration=3.0, reward=rewards, limits=limits))
    make_policy("dagger", configure("nominal", start="ground", start_offset=0.1))
    mine = replace(configure("agile"), scenario="mine")
    Learned(mine, (card(mine, scenario="mine"), network(card(mine))))
    with pytest.warns(TransferWarning, match=r"trained on scenario 'mine' .* scenario 'agile'"):
        Learned(configure("agile"), (card(mine, scenario="mine"), network(card(mine))))


def test_python_shows_the_warning_once() -> None:
    config = configure("nominal", followers=3)
    with warnings.catch_warnings(record=True) as told:
        warnings.resetwarnings()
        for _ in range(5):
            make_policy("dagger", config)
    assert len(told) == 1


# -- restarting some worlds -----------------------------------------------------------------------


@pytest.mark.parametrize("level", ["wrench", "rates", "reference"])
@pytest.mark.parametrize("record", [False, True])
def test_the_expert_restarts_worlds_one_by_one(level: str, record: bool) -> None:
    """A restarted world is one that begins; the others do not notice. Some tiles hold both."""
    config = configure("swarm", action=level, followers=5)
    worlds, ticks, again = 9, 7, 3
    mask = np.arange(worlds) % 3 == 1
    rng = np.random.default_rng(5)
    shape = (ticks, worlds, 5, config.layout.size)
    seen = rng.normal(size=shape).astype(np.float32)
    mixed, going = (Expert(config, keep_record=record) for _ in range(2))
    begun = Expert(config)
    begun.reset(worlds=worlds)
    mixed.reset(worlds=worlds)
    for tick, rows in enumerate(seen):
        if tick == again:
            mixed.restart(mask)
        actions, others = mixed.act(rows), going.act(rows)
        expected = (
            np.where(mask[:, None, None], begun.act(rows), others) if tick >= again else others
        )
        assert np.array_equal(actions, expected)
    assert not np.array_equal(mixed.act(seen[0])[mask], going.act(seen[0])[mask])


@pytest.mark.parametrize(
    "mask", [np.ones(3, bool), np.ones((2, 1), bool), np.array([0, 1]), True, [[1, 2], [3]]]
)
def test_a_mask_that_is_none(mask: Any) -> None:
    policy = make_policy("expert", NOMINAL)
    policy.reset(worlds=2)
    with pytest.raises(ValueError, match=r"^mask .*expected (bool \(2,\)|a bool array)"):
        policy.restart(mask)


@pytest.mark.parametrize("name", ["ff", "hover", "random"])
def test_policies_without_memory_go_on(name: str) -> None:
    restarted, going = make_policy(name, NOMINAL), make_policy(name, NOMINAL)
    rows = looks(3)
    for policy in (restarted, going):
        policy.reset(seed=4, worlds=3)
        policy.act(rows)
    restarted.restart(np.array([True, False, True]))
    assert np.array_equal(restarted.act(rows), going.act(rows))
