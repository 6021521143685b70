"""The search for gains: every point lawful, the same result again, nothing lost when interrupted."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("tyro")
pytest.importorskip("cma")

from baselines.policies import textbook_tuned, tuned
from baselines.policies.tuned import lawful, own, read
from baselines.scoring import rollout
from baselines.scoring.changes import CHANGES
from formation_env import SCENARIOS, configure
from formation_env.laws.gains import PlannerGains, TrackerGains
from train.margin import changes, with_margin
from train.tune_expert import main, options
from train.tune_expert.gain_space import PLANNER, REACH, GainSpace
from train.tune_expert.loop_space import LoopSpace
from train.tune_expert.options import Options
from train.tune_expert.scores import mean_score
from train.tune_expert.search import Candidate, Search, search
from train.tune_expert.tunables import TUNABLES
from train.tune_expert.tuning import write_gains

TINY = ["--episodes", "4", "--evaluations", "36", "--validation", "8", "--finalists", "3"]
TINY += ["--threads", "2", "--quiet"]


@pytest.mark.parametrize("action", ["wrench", "rates", "reference"])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_every_point_of_the_space_is_lawful(scenario: str, action: str) -> None:
    """Corners included; theorem 1, theorem 2 and (53) are checked by the gains and `lawful`."""
    config = configure(scenario, action=action)
    space = GainSpace(config)
    rng = np.random.default_rng(0)
    size = len(space.names)
    points = [*rng.uniform(-REACH, REACH, (20, size)), *rng.choice([-REACH, REACH], (20, size))]
    for x in points:
        lawful(config, space.gains(x, "zero"))


@pytest.mark.parametrize("action", ["wrench", "rates", "reference"])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_its_origin_is_the_own_gains(scenario: str, action: str) -> None:
    config = configure(scenario, action=action)
    space, mine = GainSpace(config), own(config)
    origin = space.gains(np.zeros(len(space.names)), "zero")
    assert origin.document()["planner"] == pytest.approx(mine.document()["planner"])
    assert origin.feedforward == mine.feedforward
    if mine.tracker is None:
        assert origin.tracker is None
    else:
        assert origin.document()["tracker"] == pytest.approx(mine.document()["tracker"])


@pytest.mark.parametrize("action", ["wrench", "rates", "reference"])
def test_every_coordinate_moves_something(action: str) -> None:
    space = GainSpace(configure("nominal", action=action))
    size = len(space.names)
    origin = space.gains(np.zeros(size), "zero")
    moved = [space.gains(0.5 * np.eye(size)[i], "zero") for i in range(size)]
    assert len({origin, *moved}) == 1 + size
    assert space.names[: len(PLANNER)] == PLANNER


@pytest.mark.parametrize("action", ["wrench", "rates", "reference"])
@pytest.mark.parametrize("law", textbook_tuned.LAWS)
def test_every_point_of_a_textbook_laws_space_flies(law: str, action: str) -> None:
    """Corners included: gains are checked where a policy is made of them, weights have a regulator. The
    origin is the plain gains, and every coordinate moves one gain alone."""
    config = configure("nominal", action=action)
    space, kind = LoopSpace(law, config), textbook_tuned.TUNED[law]
    size, rng = len(space.names), np.random.default_rng(0)
    # What the environment's tracker does at level `reference` has no gains here.
    flown_there = action == "reference" and law != "lqr"
    assert {"attitude", "rate", "own_push"}.isdisjoint(space.names) == flown_there
    assert space.gains(np.zeros(size), "plain") == pytest.approx(textbook_tuned.LAWS[law].gains())
    for x in (*rng.choice([-REACH, REACH], (10, size)), rng.uniform(-REACH, REACH, size)):
        tracker = kind(config, space.gains(x, "plain")).tracker
        assert all(np.isfinite(np.asarray(g)).all() for g in getattr(tracker, "gains", ()))
    for i, name in enumerate(space.names):
        moved = space.gains(0.5 * np.eye(size)[i], "plain")
        plain = textbook_tuned.LAWS[law].gains()
        assert [
            f for f in plain._fields if abs(getattr(moved, f) / getattr(plain, f) - 1) > 1e-9
        ] == [name]


def _hill(distance: float) -> tuple[Search, list[Candidate]]:
    """A search of a hill whose top is `distance` from the own gains in every coordinate."""
    space = GainSpace(configure("nominal", action="reference"))
    top = space.gains(np.full(len(space.names), distance), "zero").document()["planner"]

    def mean_scores(candidates: Any) -> list[float]:
        rows = [[g.document()["planner"][name] for name in PLANNER] for g in candidates]
        goal = np.array([top[name] for name in PLANNER])
        return [-float(np.square(np.log1p(row) - np.log1p(goal)).sum()) for row in rows]

    seen: list[Candidate] = []
    keep: Any = lambda _, generation: seen.extend(generation)  # noqa: E731
    return Search(space, mean_scores, keep, 0.5, 3, ("zero", "derived")), seen


def test_the_search_finds_the_top_of_a_hill_and_restarts_when_it_has() -> None:
    drive, seen = _hill(0.7)
    search(drive, "zero", 3000, ())
    assert len(seen) == 3000
    assert seen[0].x == (0.0,) * 7
    assert max(c.value for c in seen) > -1e-4 > seen[0].value
    far = [c.value < -0.01 for c in seen]
    assert not any(far[800:900]) or any(far[2000:])  # it scatters again after having converged


def test_what_is_known_is_not_flown_again() -> None:
    """The journal's values lead the search along the same points; only the rest is flown."""
    drive, seen = _hill(0.7)
    search(drive, "zero", 60, ())
    flown: list[int] = []
    again: list[Candidate] = []

    def counting(candidates: Any) -> list[float]:
        flown.append(len(candidates))
        return drive.mean_scores(candidates)

    def noted(_: str, generation: Any) -> None:
        again.extend(generation)

    resumed = drive._replace(mean_scores=counting, on_generation=noted)
    search(resumed, "zero", 60, [c.value for c in seen[:25]])
    assert again == seen
    assert sum(flown) == 35


def _detuned(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `nominal` start from gains that are much too slow for its leader."""
    plain = configure

    def slow(scenario: Any, **given: Any) -> Any:
        config = plain(scenario, **given)
        if given or not isinstance(scenario, str):
            return config
        from dataclasses import replace

        return plain(config, planner=replace(config.planner, k1=0.05, kz1=0.02), duration=6.0)

    monkeypatch.setattr(options, "configure", slow)


def test_a_small_search_improves_detuned_gains(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """By more than its interval, on seeds not searched; twice the same; gone on with after a stop."""
    _detuned(monkeypatch)
    gains, other = tmp_path / "gains.json", tmp_path / "other.json"
    assert main([*TINY, "--output", f"{tmp_path / 'a'}", "--gains", f"{gains}"]) == 0
    made = json.loads(gains.read_text())["gains"]["nominal"]["wrench"]["made"]
    assert made["score"][1] > 0.0 and made["score_minus_expert"][1] > 0.0
    assert "return" not in made
    margin = made["margin"]
    assert margin["measurement_delay"] == 1 and margin["noise"]["position"] == 0.002
    assert "return" not in margin
    assert margin["score_minus_expert"][1] > 0.0 and margin["score"] != made["score"]
    assert made["seed"] == 1 and made["command"].startswith("formation-tune-expert --episodes 4 ")
    assert list(read(gains)) == [("nominal", "wrench")]

    # Stopped in the midst of the second choice of feedforward.
    plain, count = rollout.fly, [0]

    def stopping(*given: Any) -> Any:
        count[0] += 1
        if count[0] > 30:
            raise KeyboardInterrupt
        return plain(*given)

    words = [*TINY, "--output", f"{tmp_path / 'b'}", "--gains", f"{other}"]
    with monkeypatch.context() as patch:
        patch.setattr(rollout, "fly", stopping)
        assert main(words) == 130
    journal = json.loads((tmp_path / "b" / "nominal-wrench.json").read_text())
    assert 18 <= journal["evaluations"] < 36 and journal["result"] is None
    assert not other.exists()
    assert main([*words, "--resume"]) == 0
    whole = json.loads((tmp_path / "a" / "nominal-wrench.json").read_text())
    assert whole["margin"] == {name: margin[name] for name in ("measurement_delay", "noise")}
    flown = with_margin(options.configure("nominal"))
    own_score = mean_score(tuned.ExpertTuned(flown, own(flown)), range(100_000, 100_004))
    assert whole["values"]["zero"][0] == pytest.approx(own_score, rel=1e-9)
    again = json.loads((tmp_path / "b" / "nominal-wrench.json").read_text())
    assert again["values"] == whole["values"]
    assert read(other) == read(gains)
    capsys.readouterr()


def test_a_textbook_law_is_tuned_by_the_same_search(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Detuned gains become better on seeds not searched; what is written is read and flown."""
    law = textbook_tuned.LAWS["lee"]

    def slow(**given: float) -> Any:
        return law.gains(**{"position": 0.5, "velocity": 0.4, **given})

    slow._fields = law.gains._fields  # type: ignore[attr-defined]
    gains = tmp_path / "gains.json"
    words = ["--policy", "lee", "--output", f"{tmp_path / 'a'}", "--gains", f"{gains}"]
    with monkeypatch.context() as patch:
        patch.setitem(textbook_tuned.LAWS, "lee", law._replace(gains=slow))
        monkeypatch.setattr(options, "configure", lambda s, **o: configure(s, duration=6.0, **o))
        assert main([*TINY, *words]) == 0
    assert (tmp_path / "a" / "lee-nominal-wrench.json").exists()
    ((key, found),) = textbook_tuned.read("lee", gains).items()
    assert key == ("nominal", "wrench")
    config = configure("nominal", duration=6.0)
    better, before = (
        rollout.fly_all(textbook_tuned.LeeTuned(config, g), range(400_000, 400_008))["score"]
        for g in (found, slow())
    )
    assert better.mean() > before.mean() + 0.02
    capsys.readouterr()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--scenario", "moon"], "scenario = 'moon': expected one of"),
        (["--policy", "pid"], "policy = 'pid': expected one of expert, ff, ff-filter, lee, lqr"),
        (["--action", "yaw"], "action = 'yaw': expected one of"),
        (["--feedforward", "some"], "feedforward = 'some': expected one of both"),
        (["--episodes", "0"], "episodes = 0: expected an integer"),
        (["--validation", "100001"], "validation = 100001"),
        (["--spread", "nan"], "spread = nan: expected a finite number above 0"),
        (["--seed", "-1"], "seed = -1"),
        (["--resume"], "--resume: "),
    ],
)
def test_impossible_options_are_one_line(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main([*words, "--output", f"{tmp_path / 'out'}"])
    assert stopped.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith("formation-tune-expert: error: ") and message in said
    assert said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_earlier_files_are_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A journal is not begun anew, one of another search or no journal is not gone on with, and a
    broken file of gains is not overwritten."""
    journal, gains = tmp_path / "nominal-wrench.json", tmp_path / "gains.json"
    head = {"options": {"seed": 5}, "package": "0", "values": {}}
    gains.write_text("{}")
    for text, words, message in (
        (json.dumps(head), [], "exists: expected --resume"),
        (json.dumps(head), ["--resume"], "was begun with seed = 5, not 1"),
        ("[1]", ["--resume"], "is not a journal"),
        (None, ["--gains", f"{gains}"], "gains.json: the file = "),
    ):
        journal.unlink(missing_ok=True)
        if text is not None:
            journal.write_text(text)
        with pytest.raises(SystemExit, match="2"):
            main([*TINY, "--output", f"{tmp_path}", *words])
        assert message in capsys.readouterr().err
        assert text is None or journal.read_text() == text
    assert gains.read_text() == "{}"


def test_searches_that_end_together_all_write_their_gains(tmp_path: Path) -> None:
    path, tunable = tmp_path / "gains.json", TUNABLES["lee"]
    entry = {**tunable.document(tunable.own(configure("nominal"))), "made": {}}
    names = [f"task {i}" for i in range(24)]
    with ThreadPoolExecutor(8) as pool:
        written = [pool.submit(write_gains, tunable, path, name, "wrench", entry) for name in names]
        assert [each.result() for each in written] == [None] * len(names)
    assert set(tunable.read(path)) == {(name, "wrench") for name in names}
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_library_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "cma", None)
    with pytest.raises(SystemExit, match="2"):
        main(TINY)
    assert 'cma is missing: pip install "formation-env[train]"' in capsys.readouterr().err


# -- the margin -----------------------------------------------------------------------------------


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_margin_is_on_exact_sensors_alone(scenario: str) -> None:
    config = configure(scenario)
    flown = with_margin(config)
    if scenario in ("paper", "experiment"):
        assert flown is config and changes(config, flown) == {}
        return
    assert (flown.measurement_delay, flown.noise) == (1, (0.002, 0.005, 0.01, 0.001, 0.01))
    assert configure(flown, measurement_delay=0, noise=config.noise) == config
    assert list(changes(config, flown)) == ["measurement_delay", "noise"]
    late = configure(config, measurement_delay=2)
    assert with_margin(late) is late
    assert with_margin(flown) is flown


def test_the_board_says_which_of_its_changes_the_margin_has() -> None:
    """The same delay and noise, which a page of the board names as met before."""
    config = configure("nominal")
    flown = with_margin(config)
    told = {name for c in CHANGES if c.margin for name in changes(config, c.changed(config))}
    assert told == set(changes(config, flown))
    late, noisy = (c.changed(config) for c in CHANGES if c.margin)
    assert late.measurement_delay == flown.measurement_delay
    assert noisy.noise == flown.noise._replace(acceleration=0.0)


def test_gains_at_the_edge_of_stability_lose_the_search() -> None:
    """Of the expert on `nominal`: found on exact sensors, where they win, they fail with the margin."""
    planner = PlannerGains(0.1722, 3.2374, 0.6877, 0.1749, 1.4773, 2.8068, 2.6114)
    tracker = TrackerGains(5.6177, 1.9445, 45.166, 9.0099, 10.151, 5.0417, 8.4128, 0.10272)
    gains = tuned.Gains(planner, tracker, "zero")
    config, seeds = configure("nominal"), range(100_000, 100_004)
    tunable = TUNABLES["expert"]
    for task, wins in ((config, True), (with_margin(config), False)):
        edge, mine = (
            mean_score(tunable.policy(task, g), seeds) for g in (gains, tunable.own(config))
        )
        assert (edge > mine + 0.2) if wins else (edge < mine - 0.2)


def test_without_the_margin_the_task_itself_is_searched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command says so, and there is one result."""
    monkeypatch.setattr(options, "configure", lambda s, **o: configure(s, duration=1.0, **o))
    assert main([*TINY, "--policy", "lqr", "--no-margin", "--output", f"{tmp_path}"]) == 0
    made = json.loads((tmp_path / "lqr-nominal-wrench.json").read_text())["result"]["made"]
    assert made["margin"] is None and "--no-margin" in made["command"].split()
    assert "with the margin" not in capsys.readouterr().out


def test_options_are_checked_by_their_own_names() -> None:
    assert Options(action="rates").check().action == "rates"
    reference = configure("nominal", action="reference")
    assert Options().choices(reference) == ("zero",)
    assert Options().choices(configure("nominal")) == ("zero", "derived")
