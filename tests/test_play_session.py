"""Flights that go on: changes, pushes and losses in flight, and commands that are refused."""

from __future__ import annotations

import json
import threading
from typing import Any

import numpy as np
import pytest
from replays import flown

from baselines.play.carrying import carry
from baselines.play.flight import Flight
from baselines.play.session import COMMANDS, Session
from formation_env import FormationConfig, configure
from formation_env.core.simulation import Simulation, seeded_key

pytestmark = pytest.mark.filterwarnings("ignore::formation_env.FeasibilityWarning")


def flight(name: str = "expert", ticks: int = 0, seed: int = 3, **fields: Any) -> Flight:
    found = Flight(name, configure(**{"scenario": "nominal", "duration": 2.0, **fields}), seed)
    for _ in range(ticks):
        found.tick()
    return found


def rows(frame: dict[str, Any], name: str, width: int = 3) -> np.ndarray:
    return np.array(frame[name]).reshape(-1, width)


@pytest.mark.parametrize("name", ["expert", "lee", "random"])
def test_it_flies_what_the_replay_records(name: str) -> None:
    e, mine = flown(name, 3), flight(name)
    for j in range(len(e.actions)):
        frame = mine.frame()
        assert frame["time"] == pytest.approx(e.time[j])
        assert np.abs(rows(frame, "positions") - e.positions[j]).max() <= 0.5001e-4
        assert np.abs(rows(frame, "slots") - e.slots[j]).max() <= 0.5001e-4
        mine.tick()
        frame = mine.frame()
        assert np.abs(np.reshape(frame["actions"], e.actions[j].shape) - e.actions[j]).max() < 1e-4
        if len(e.lyapunov):
            V = 10.0 ** np.reshape(frame["lyapunov"], (2, 4))
            np.testing.assert_allclose(V, np.maximum(e.lyapunov[j], 1e-9), rtol=3e-4)
        else:
            assert frame["lyapunov"] is None
    assert mine.ended and mine.end() == (e.end() if e.failure.any() else "time is up")
    assert np.abs(np.array(mine.path()) - e.path).max() <= 0.5001e-3


def test_a_flight_goes_on_as_if_nothing_had_changed_where_nothing_has() -> None:
    """Carried to a simulation of an equal configuration, numbers stay what they would have been."""
    for fields in ({}, {"scenario": "paper"}, {"scenario": "experiment"}, {"action": "reference"}):
        one, other = flight(ticks=40, **fields), flight(**fields)
        assert other.go_on_from(one)
        for _ in range(30):
            one.tick()
            other.tick()
        assert one.frame() == other.frame(), fields


@pytest.mark.parametrize(
    "change",
    [
        {"gust": 0.5},
        {"gust": 0.0},
        {"noise": {"position": 0.01}},
        {"measurement_delay": 3},
        {"estimator": "differenced"},
        {"planner": {"k1": 0.3}},
        {"offsets": [[0.5, 0.5, -0.3], [0.5, -0.5, -0.3]]},
    ],
    ids=str,
)
def test_what_is_carried_is_where_it_was(change: dict[str, Any]) -> None:
    one = flight(ticks=40)
    other = flight(**change)
    before = other.frame()["positions"]
    assert other.go_on_from(one)
    after = other.frame()
    for name in ("time", "positions", "attitudes", "started"):
        assert after[name] == one.frame()[name]
    assert after["positions"] != before
    for _ in range(20):
        other.tick()
    moved = rows(other.frame(), "positions") - rows(after, "positions")
    assert 0.0 < np.abs(moved).max() < 1.0


@pytest.mark.parametrize(
    "change",
    [
        {"trajectory": "circle"},
        {"path": "as given"},
        {"action": "rates"},
        {"control_period": 0.01},
        {"followers": 3},
        {"start": "ground"},
    ],
    ids=str,
)
def test_what_cannot_go_on_is_left_at_its_start(change: dict[str, Any]) -> None:
    one = flight(ticks=40)
    other = flight(**change)
    before = other.frame()
    if change == {"start": "ground"}:
        assert other.go_on_from(one), "in the air the start no longer matters"
        return
    assert not other.go_on_from(one)
    assert other.frame() == before


def test_a_flight_that_has_ended_does_not_go_on() -> None:
    one = flight(ticks=200)
    assert one.ended and not flight(gust=0.5).go_on_from(one)


def test_carrying_keeps_the_right_followers() -> None:
    a, b = Simulation(configure(followers=4)), Simulation(configure(followers=2))
    for each in (a, b):
        each.seed(0, seeded_key(1))
        each.reset()
    assert not carry(a, b)
    assert carry(a, b, [1, 3])
    np.testing.assert_array_equal(b.positions[0], a.positions[0, [0, 2, 4]])
    np.testing.assert_array_equal(b.velocities[0], a.velocities[0, [0, 2, 4]])


@pytest.mark.parametrize("vehicle", [0, 2])
def test_a_push_changes_one_velocity_and_nothing_else(vehicle: int) -> None:
    one, pushed = flight(ticks=20), flight(ticks=20)
    pushed.push(vehicle, [0.5, -1.0, 0.25])
    before, after = one._simulation, pushed._simulation
    change = np.zeros((3, 3))
    change[vehicle] = [0.5, -1.0, 0.25]
    np.testing.assert_allclose(after.velocities[0] - before.velocities[0], change, atol=1e-15)
    for name in ("positions", "attitudes", "angular_velocities", "time"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    one.tick()
    pushed.tick()
    moved = rows(pushed.frame(), "positions") - rows(one.frame(), "positions")
    np.testing.assert_allclose(moved, 0.02 * change, atol=2e-3)


def test_a_policy_that_raises_ends_its_flight_and_says_so(tmp_path: Any) -> None:
    file = tmp_path / "mine.py"
    file.write_text(
        "class Mine:\n"
        "    def reset(self, seed): self.left = 5\n"
        "    def act(self, observation):\n"
        "        self.left -= 1\n"
        "        return observation[:, :4] * 0 if self.left else 1 / 0\n"
    )
    mine = flight(f"{file}:Mine", ticks=10)
    assert mine.ended and "ZeroDivisionError" in (mine.end() or "")
    assert mine.frame()["time"] == pytest.approx(0.08)


# -- the session ----------------------------------------------------------------------------------


def session(policies: tuple[str, ...] = ("expert",), ticks: int = 20, **options: Any) -> Session:
    found = Session(policies, **options)
    for _ in range(ticks):
        found.tick()
    return found


def do(of: Session, **command: Any) -> dict[str, Any]:
    return of.do(json.loads(json.dumps(command)))


def frame(of: Session) -> Any:
    """The latest frame."""
    return json.loads(of.frames())["frames"][-1]


def test_a_change_takes_effect_in_flight_and_is_told() -> None:
    s = session()
    version, epoch = s.latest()[0], s.epoch
    assert do(s, do="set", name="gust", value=0.5) == {"ok": True, "began": False}
    state = s.state()[1]
    assert s.config.gust == 0.5 and s.epoch == epoch and s.latest()[0] > version
    assert state["changes"] == {"gust": 0.5} and state["values"]["gust"] == 0.5
    assert state["base"]["gust"] == configure().gust
    assert 'configure("nominal", gust=0.5)' in state["python"]
    assert frame(s)["flights"][0]["time"] == pytest.approx(0.4)
    assert do(s, do="unset", name="gust")["ok"] and s.config == configure()


def test_an_impossible_change_leaves_all_as_it_was() -> None:
    s = session(("expert", "hover"))
    before, seen = s.state(), s.frames()
    for command, message in (
        ({"do": "set", "name": "planner.k2", "value": 0.5}, "planner.k2 = 0.5"),
        ({"do": "set", "name": "gust", "value": "strong"}, "gust = 'strong'"),
        ({"do": "set", "name": "gust", "value": 1e999}, "gust = inf"),
        ({"do": "set", "name": "gust"}, "value"),
        ({"do": "set", "name": "wings", "value": 2}, "name = 'wings'"),
        ({"do": "policies", "value": ["pilot"]}, "policy = 'pilot'"),
        ({"do": "policies", "value": ["ppo", "expert", "hover"]}, "one or two"),
        ({"do": "policies", "value": "expert"}, "one or two"),
        ({"do": "policies", "value": ["mine.py:Mine"]}, "mine.py:Mine"),
        ({"do": "policies", "value": ["bc"]}, "no file for action level"),
        ({"do": "scenario", "value": "storm"}, "scenario = 'storm'"),
        ({"do": "push", "vehicle": 3, "change": [0, 0, 0]}, "vehicle = 3"),
        ({"do": "push", "vehicle": 1, "change": [0, 0]}, "change"),
        ({"do": "push", "vehicle": 1, "change": [0, 0, 21]}, "change"),
        ({"do": "lose", "follower": 0}, "follower = 0"),
        ({"do": "reset", "seed": -1}, "seed = -1"),
        ({"do": "reset", "seed": 1.5}, "seed = 1.5"),
        ({"do": "pause", "value": 1}, "pause = 1"),
        ({"do": "speed", "value": 100}, "speed = 100"),
        ({"do": "close"}, "do = 'close'"),
        ({"do": "state"}, "do = 'state'"),
        ({"do": ["set"]}, "do = "),
        ({}, "do = None"),
        ([], "command"),
        (None, "command"),
    ):
        answer = s.do(command)
        assert set(answer) == {"error"} and message in answer["error"], (command, answer)
    assert s.state() == before and s.frames() == seen


def test_the_commands_are_few() -> None:
    assert set(COMMANDS) == {
        *("scenario", "policies", "set", "unset", "clear", "lose"),
        *("push", "reset", "pause", "speed", "again"),
    }


def test_a_lost_follower_is_gone_and_the_others_are_where_they_were() -> None:
    s = session(("expert", "lee"), changes={"followers": 3})
    s._publish()
    before, epoch = frame(s)["flights"], s.epoch
    assert do(s, do="lose", follower=2) == {"ok": True, "began": False}
    after = frame(s)["flights"]
    for a, b in zip(before, after, strict=True):
        assert a["time"] == b["time"]
        np.testing.assert_array_equal(rows(a, "positions")[[0, 1, 3]], rows(b, "positions"))
    assert s.epoch > epoch and s.state()[1]["cards"][0]["followers"] == 2
    offsets = configure(followers=3).offsets
    assert s.config.offsets == (offsets[0], offsets[2])
    assert do(s, do="lose", follower=1)["ok"]
    assert "last follower" in do(s, do="lose", follower=1)["error"]


def test_two_policies_fly_the_same_world_and_are_pushed_alike() -> None:
    s = session(("expert", "hover"), ticks=0)
    one, other = frame(s)["flights"]
    assert one["positions"] == other["positions"]
    do(s, do="push", vehicle=1, change=[1.0, 0.0, 0.0])
    s.tick()
    s._publish()
    for moved, before in zip(frame(s)["flights"], (one, other), strict=True):
        north = (rows(moved, "positions") - rows(before, "positions"))[:, 0]
        assert north[1] - north[2] == pytest.approx(0.02, abs=5e-3)


def test_another_scenario_or_policy_begins_anew() -> None:
    s = session(changes={"gust": 0.3})
    assert do(s, do="policies", value=["lee"]) == {"ok": True, "began": True}
    assert s.changes == {"gust": 0.3} and frame(s)["flights"][0]["time"] == 0.0
    assert do(s, do="scenario", value="paper") == {"ok": True, "began": True}
    assert s.changes == {} and s.config.scenario == "paper"


def test_reset_is_by_seed() -> None:
    s = session()
    do(s, do="reset", seed=7)
    seven = frame(s)["flights"]
    do(s, do="reset", seed=8)
    assert frame(s)["flights"] != seven
    do(s, do="reset", seed=7)
    assert frame(s)["flights"] == seven
    assert s.state()[1]["seed"] == 7


def test_history_is_bounded_and_of_this_episode() -> None:
    s = session(("expert", "lee"), changes={"followers": 16})
    for _ in range(900):
        s._publish()
    assert 1_000_000 < sum(map(len, s._frames)) <= 3_000_000
    count = s.latest()[2]
    assert json.loads(s.frames(count))["frames"] == []
    assert len(json.loads(s.frames(count - 3))["frames"]) == 3
    assert 100 < len(json.loads(s.frames())["frames"]) <= 300
    s.tick()
    s._publish()
    assert json.loads(s.frames(1))["frames"][-1] == json.loads(s._frames[-1]), "the last among them"
    do(s, do="reset", seed=1)
    (only,) = json.loads(s.frames())["frames"]
    assert only["epoch"] == s.epoch and only["flights"][0]["time"] == 0.0


def test_it_flies_by_itself_pauses_and_begins_the_next_episode() -> None:
    s = session(ticks=0, changes={"duration": 0.5})
    told = threading.Event()
    s.listen(told.set)
    s.start()
    try:
        assert told.wait(60)
        while s.seed == 0:
            told.clear()
            assert told.wait(60)
        assert do(s, do="again", value=False)["ok"]
        assert do(s, do="pause", value=True)["ok"]
        here = s._flights[0].time
        do(s, do="push", vehicle=0, change=[0, 0, 0])
        assert s._flights[0].time == here
        do(s, do="reset", seed=5)
        do(s, do="pause", value=False)
        while not s._flights[0].ended:
            told.clear()
            assert told.wait(60)
        assert s.seed == 5
    finally:
        s.close()
    assert not s._thread.is_alive()  # type: ignore[union-attr]


def test_what_is_flown_and_said_is_json() -> None:
    s = session(scenario="paper")
    for content in (s.hello(), s.state()[1]):
        text = json.dumps(content, allow_nan=False)
        assert json.loads(text)["type"] in ("hello", "state")
    assert isinstance(s.config, FormationConfig)
    assert "bc" not in s.state()[1]["available"] and "expert" in s.state()[1]["available"]
