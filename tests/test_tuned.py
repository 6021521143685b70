"""The expert with gains of its own: what the file may say, and what flying with it means."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines import TransferWarning, make_policy
from baselines.policies import textbook_tuned
from baselines.policies.expert import Expert
from baselines.policies.tuned import ExpertTuned, Gains, UntunedWarning, lawful, own, read
from baselines.scoring.rollout import fly
from formation_env import SCENARIOS, FeasibilityWarning, FormationConfig, configure
from formation_env.core.simulation import Simulation, seeded_key
from formation_env.validation.checks import LONGEST

SHIPPED = read()
VALIDATION = 300_000  # neither those of the search nor those of the leaderboard


@pytest.mark.parametrize("feedforward", ["zero", "derived"])
@pytest.mark.parametrize("level", ["wrench", "rates", "reference"])
def test_with_the_configurations_own_gains_it_is_the_expert(level: str, feedforward: str) -> None:
    config = configure("paper", action=level)
    expert, tuned = (
        Expert(config, feedforward),
        ExpertTuned(config, own(config, feedforward)),
    )
    simulation = Simulation(config, 3)
    for i in range(3):
        simulation.seed(i, seeded_key(i))
    rows = simulation.reset().observations
    expert.reset(0, 3)
    tuned.reset(0, 3)
    for _ in range(20):
        actions = expert.act(rows)
        assert np.array_equal(tuned.act(rows), actions)
        rows = simulation.step(actions).observations


def test_worlds_restart_one_by_one() -> None:
    """A world that begins again is one that begins: bit for bit, and its neighbour goes on."""
    config = configure("paper")
    worlds = [Simulation(config, 1) for _ in range(2)]
    rows = []
    for i, world in enumerate(worlds):
        world.seed(0, seeded_key(i))
        rows.append(world.reset().observations)
    both, first, second = (ExpertTuned(config) for _ in range(3))
    both.reset(0, 2)
    first.reset(0, 1)
    second.reset(0, 1)
    for tick in range(6):
        if tick == 3:
            rows[1] = worlds[1].reset().observations
            both.restart(np.array([False, True]))
            second.reset(0, 1)
        actions = both.act(np.concatenate(rows))
        assert np.array_equal(actions[:1], first.act(rows[0]))
        assert np.array_equal(actions[1:], second.act(rows[1]))
        rows = [w.step(actions[i : i + 1]).observations.copy() for i, w in enumerate(worlds)]


def test_only_the_followers_own_law_changes() -> None:
    """The configuration that a rollout makes its worlds from, leader and all, keeps its gains."""
    config = configure("nominal")
    tuned = make_policy("expert-tuned", config)
    assert tuned.config is config
    assert isinstance(tuned, ExpertTuned)
    law = lawful(config, tuned.gains)
    assert law.planner != config.planner and law.tracker != config.tracker
    assert law.rates_tracker == config.rates_tracker
    assert configure(law, planner=config.planner, tracker=config.tracker) == config


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_every_scenario_has_gains_at_its_own_action_level(scenario: str) -> None:
    assert (scenario, configure(scenario).action) in SHIPPED


@pytest.mark.parametrize(("scenario", "action"), SHIPPED)
def test_shipped_gains_are_lawful_and_no_worse_than_the_expert(scenario: str, action: str) -> None:
    """`lawful` checks theorems 1 and 2 and (53); the episodes are of seeds that no search used."""
    config = configure(scenario, action=action)
    tuned = ExpertTuned(config)
    law = lawful(config, tuned.gains)
    assert tuned.tuned and law.planner == tuned.gains.planner
    seeds = range(VALIDATION, VALIDATION + 8)
    best, expert = fly(tuned, seeds), fly(Expert(config), seeds)
    assert best["return"].mean() >= expert["return"].mean()
    assert best["failed"].mean() <= expert["failed"].mean()


def test_a_scenario_without_gains_is_flown_with_its_own_and_says_so() -> None:
    with warnings.catch_warnings():  # of the paper's own pair, see `configure`
        warnings.simplefilter("ignore", FeasibilityWarning)
        config = replace(configure("paper"), scenario="mine")
    with pytest.warns(UntunedWarning, match="'mine' at action level 'wrench'"):
        policy = ExpertTuned(config)
    assert not policy.tuned and policy.gains == own(config)


def test_gains_that_do_not_fit_are_refused() -> None:
    config = configure("nominal")
    mine = own(config)
    with pytest.raises(ValueError, match=r"expert-tuned: tracker = None: expected the tracker's"):
        ExpertTuned(config, Gains(mine.planner, None))
    steep = Gains(replace(mine.planner, z_max=6.0), mine.tracker)
    with pytest.raises(ValueError, match=r"expert-tuned: .*sigma_max < g - z_max.*\(53\)"):
        ExpertTuned(config, steep)
    with pytest.raises(ValueError, match="feedforward = 'some': expected one of 'zero', 'derived'"):
        Gains(mine.planner, mine.tracker, "some")


# -- the file -------------------------------------------------------------------------------------

Change = Callable[[dict[str, Any]], object]

WRONG: dict[str, tuple[Change, str]] = {
    "version": (lambda d: d.update(version=2), "version = 2: expected 1"),
    "table": (lambda d: d.update(gains=[]), r"gains = \[\]: expected an object"),
    "scenario": (lambda d: d["gains"].update(nominal=3), "nominal = 3: expected an object"),
    "level": (
        lambda d: d["gains"].update(nominal={"thrust": entry(d)}),
        "nominal.thrust: action level = 'thrust': expected one of wrench",
    ),
    "unknown": (
        lambda d: entry(d)["planner"].update(k9=1.0),
        r"nominal.wrench: planner = \['k9'\]: expected only k1",
    ),
    "missing": (lambda d: entry(d)["tracker"].pop("kz"), "nominal.wrench: tracker = .*also kz"),
    "not finite": (
        lambda d: entry(d)["planner"].update(k1=float("nan")),
        "nominal.wrench: planner.k1 = nan: expected a finite number above 0",
    ),
    "text": (lambda d: entry(d)["tracker"].update(c="50"), "tracker.c = '50': expected a finite"),
    "theorem 1": (lambda d: entry(d)["planner"].update(k2=1.0), "planner.k2 = 1.0: expected"),
    "theorem 2": (lambda d: entry(d)["tracker"].update(p11=1e6), r"so that P \(56\) is positive"),
    "feedforward": (lambda d: entry(d).update(feedforward="some"), "feedforward = 'some'"),
    "unhashable": (lambda d: entry(d).update(feedforward=["zero"]), r"feedforward = \['zero'\]"),
    "no tracker": (lambda d: entry(d).update(tracker=None), "tracker = None: expected an object"),
    "tracker of the world": (
        lambda d: d["gains"]["nominal"].update(reference=entry(d)),
        "nominal.reference: tracker = .*expected null",
    ),
}


def entry(document: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = document["gains"]["nominal"]["wrench"]
    return found


@pytest.fixture
def document() -> dict[str, Any]:
    mine = {**own(configure("nominal")).document(), "made": {}}
    return {"version": 1, "gains": {"nominal": {"wrench": mine}}}


def test_what_is_written_is_read(tmp_path: Path, document: dict[str, Any]) -> None:
    path = tmp_path / "gains.json"
    path.write_text(json.dumps(document))
    mine = own(configure("nominal"))
    assert read(path) == {("nominal", "wrench"): mine}


@pytest.mark.parametrize("change", WRONG)
def test_a_wrong_file_is_refused(tmp_path: Path, document: dict[str, Any], change: str) -> None:
    path = tmp_path / "gains.json"
    spoil, message = WRONG[change]
    spoil(document)
    path.write_text(json.dumps(document))
    with pytest.raises(ValueError, match=message) as refused:
        read(path)
    assert str(refused.value).startswith(str(path))


def test_a_pipe_is_not_waited_for_and_messages_stay_short(
    tmp_path: Path, document: dict[str, Any]
) -> None:
    os.mkfifo(tmp_path / "pipe.json")
    with pytest.raises(ValueError, match=r"pipe.json: a pipe, not a regular file; expected a file"):
        read(tmp_path / "pipe.json")
    path = tmp_path / "gains.json"
    document["gains"] = {"x" * 3000: {"wrench": {}}}
    for text in (json.dumps(document), "[" * 100_000):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"gains.json: ") as refusal:
            read(path)
        assert len(str(refusal.value)) <= LONGEST


@pytest.mark.parametrize("text", ["", '{"version": 1', "\x00", "[]", '{"version": 1}'])
def test_what_is_no_file_of_gains_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "gains.json"
    with pytest.raises(ValueError, match=r"gains.json: .*expected a file of gains"):
        read(path)
    path.write_text(text)
    with pytest.raises(ValueError, match=r"gains.json: .*expected"):
        read(path)


def test_a_name_that_stands_twice_is_refused(tmp_path: Path, document: dict[str, Any]) -> None:
    """As after a merge gone wrong: JSON would keep the last and drop the other's gains silently."""
    path = tmp_path / "gains.json"
    gains = json.dumps(document["gains"]["nominal"])
    path.write_text(f'{{"version": 1, "gains": {{"nominal": {gains}, "nominal": {gains}}}}}')
    with pytest.raises(ValueError, match=r"gains.json: .*'nominal'.*every name once"):
        read(path)


def test_what_is_made_directly_is_not_taken_for_nominal() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FeasibilityWarning)
        config = FormationConfig()
    with pytest.warns(UntunedWarning, match="scenario 'custom' at action level 'wrench'"):
        policy = make_policy("expert-tuned", config)
    assert isinstance(policy, ExpertTuned) and not policy.tuned
    with pytest.warns(TransferWarning, match="'nominal' .* flies another task: scenario 'custom'"):
        make_policy("dagger", config)


# -- the textbook's laws --------------------------------------------------------------------------


@pytest.mark.parametrize("law", textbook_tuned.LAWS)
def test_a_textbook_law_without_gains_flies_the_plain_ones_and_says_so(law: str) -> None:
    with warnings.catch_warnings():  # of the paper's own pair, see `configure`
        warnings.simplefilter("ignore", FeasibilityWarning)
        config = replace(configure("nominal"), scenario="mine")
    kind = textbook_tuned.TUNED[law]
    with pytest.warns(UntunedWarning, match=f"{law}-tuned: no gains .* 'mine' .*; the plain ones"):
        policy = kind(config)
    assert not policy.tuned
    plain, given = make_policy(law, config), kind(config, textbook_tuned.LAWS[law].gains())
    assert given.tuned
    simulation = Simulation(config, 2)
    for i in range(2):
        simulation.seed(i, seeded_key(i))
    rows = simulation.reset().observations
    for each in (policy, given):
        assert np.array_equal(each.act(rows), plain.act(rows))


@pytest.mark.parametrize("law", textbook_tuned.LAWS)
def test_shipped_gains_of_a_textbook_law_can_be_flown(law: str) -> None:
    for (scenario, action), gains in textbook_tuned.read(
        law, textbook_tuned.LAWS[law].file
    ).items():
        policy = textbook_tuned.TUNED[law](configure(scenario, action=action))
        assert policy.tuned and isinstance(gains, textbook_tuned.LAWS[law].gains)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"gains": {}}, r"nominal.wrench: gains = \[\]: expected also attitude"),
        ({"gains": {"k9": 1.0}}, r"nominal.wrench: gains = \['k9'\]: expected only position"),
        ({"planner": {}}, r"nominal.wrench: entry = \['planner'\]: expected only gains"),
        ({"gains": 3}, r"nominal.wrench: gains = 3: expected an object"),
    ],
)
def test_a_wrong_file_of_a_textbook_laws_gains_is_refused(
    tmp_path: Path, entry: dict[str, Any], message: str
) -> None:
    path = tmp_path / "ff.json"
    document = {"version": 1, "gains": {"nominal": {"wrench": {**entry, "made": {}}}}}
    path.write_text(json.dumps(document))
    with pytest.raises(ValueError, match=message) as refused:
        textbook_tuned.read("ff", path)
    assert str(refused.value).startswith(str(path))
    plain = textbook_tuned.LAWS["ff"].gains()._asdict()
    for name, value in (("rate", -1.0), ("upwards", 9.81), ("position", "4")):
        bad = {"gains": {**plain, name: value}, "made": {}}
        path.write_text(json.dumps({"version": 1, "gains": {"nominal": {"wrench": bad}}}))
        with pytest.raises(ValueError, match=f"nominal.wrench: gains.{name} = "):
            textbook_tuned.read("ff", path)
