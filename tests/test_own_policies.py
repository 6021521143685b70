"""Your own controllers, vehicles, paths and gains: on the command line and from Python."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import baselines
from baselines import Policy, evaluate, make_policy
from baselines.own import PolicyError, is_source
from baselines.policies.simple import Random
from baselines.scoring.rollout import fly
from formation_env import FormationConfig, configure

CODE = """
from dataclasses import dataclass
import numpy as np

class Mine:
    '''Sees one world at a time.'''
    def __init__(self, config):
        self.config = config
        self.draws = None
    def reset(self, seed):
        self.draws = np.random.default_rng(seed)
    def act(self, observation):
        n, k = self.config.followers, self.config.action_size
        assert observation.shape == (n, self.config.layout.size)
        return self.draws.uniform(-1.0, 1.0, (n, k))

class Plain:
    '''Knows nothing of the configuration.'''
    def reset(self, seed): pass
    def act(self, observation): return np.zeros((2, 4))

class Together:
    def __init__(self, config): self.config = config
    def reset(self, seed, worlds=1): self.seeds = np.arange(seed, seed + worlds)
    def act(self, observation):
        n, k = self.config.followers, self.config.action_size
        draws = [np.random.default_rng([s, self.tick()]).uniform(-1, 1, (n, k)) for s in self.seeds]
        return np.array(draws)
    def tick(self): return 0

def made(config): return Plain()
thing = Plain()

class Deaf:
    def reset(self, seed): pass

class Refuses:
    def __init__(self, config): raise ValueError("not for two followers")

class Breaks:
    def __init__(self, config): raise KeyError("gain")

class Shape(Plain):
    def act(self, observation): return np.zeros(3)

class Nan(Plain):
    def act(self, observation): return np.full((2, 4), np.nan)

number = 3
"""


@pytest.fixture
def code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of policies, in the current folder."""
    path = tmp_path / "controllers.py"
    path.write_text(CODE, encoding="utf-8")
    (tmp_path / "broken.py").write_text("x = 1\ny = x / 0\n", encoding="utf-8")
    (tmp_path / "wrong.py").write_text("def (:\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    for name in ("controllers", "broken", "wrong"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return path


SHORT = configure("nominal", duration=0.2)


@pytest.mark.parametrize("place", ["controllers", "controllers.py"])
@pytest.mark.parametrize("name", ["Mine", "Plain", "Together", "made", "thing"])
def test_names_of_code_fly(code: Path, place: str, name: str) -> None:
    columns = fly(make_policy(f"{place}:{name}", SHORT), range(3, 6))
    assert len(columns["return"]) == 3
    hover = fly(make_policy("hover", SHORT), range(3, 6))
    zero = name in ("Plain", "made", "thing")
    assert np.array_equal(columns["return"], hover["return"]) == zero


@pytest.mark.parametrize("name", ["Mine", "Together"])
def test_groups_of_worlds_do_not_matter(code: Path, name: str) -> None:
    """World i draws from `seed + i`, whoever flies beside it."""
    policy = make_policy(f"controllers:{name}", SHORT)
    whole, parts = fly(policy, range(3, 7)), [fly(policy, range(3, 5)), fly(policy, range(5, 7))]
    together = np.concatenate([part["return"] for part in parts])
    assert np.array_equal(whole["return"], together)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nowhere:Mine", "policy nowhere:Mine: there is no module 'nowhere'"),
        ("nowhere.py:Mine", "nowhere.py cannot be read: No such file"),
        ("controllers:Other", "controllers has no 'Other'"),
        ("controllers:Deaf", "has no method act"),
        ("controllers:number", "3: expected a class"),
        ("controllers:Refuses", "policy controllers:Refuses: not for two followers"),
        ("controllers:Breaks", "making it raised KeyError: 'gain'"),
        ("broken:Mine", r"importing broken raised ZeroDivisionError: .*\(broken.py, line 2\)"),
        ("broken.py:Mine", r"importing broken.py raised ZeroDivisionError"),
        ("wrong:Mine", "importing wrong raised SyntaxError"),
    ],
)
def test_what_cannot_be_loaded_is_named(code: Path, name: str, message: str) -> None:
    with pytest.raises(ValueError, match=message) as refusal:
        make_policy(name, SHORT)
    assert len(str(refusal.value)) <= 500 and "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Shape", r"what controllers:Shape.act returned has shape \(3,\): expected \(2, 4\)"),
        ("Nan", "policy controllers:Nan: ValueError"),
    ],
)
def test_what_fails_in_flight_names_the_policy(code: Path, name: str, message: str) -> None:
    with pytest.raises(PolicyError, match=message):
        evaluate(f"controllers:{name}", {"short": SHORT}, episodes=2, threads=2, quiet=True)


def test_the_command_flies_them(
    code: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--policies", "expert,controllers:Mine,controllers.py:Refuses"]
    arguments += ["--scenarios", "nominal", "--episodes", "2", "--duration", "0.2"]
    with pytest.raises(SystemExit):  # one that fits nowhere
        evaluate.main(arguments)  # type: ignore[attr-defined]
    assert "not for two followers" in capsys.readouterr().err
    arguments[1] = "expert,controllers:Mine,controllers.py:Nan"
    assert evaluate.main(arguments) == 1  # type: ignore[attr-defined]
    error = capsys.readouterr().err
    assert "formation-evaluate: error: policy controllers.py:Nan" in error.splitlines()[-1]
    assert not list((tmp_path / "results").iterdir())
    arguments[1] = "expert,controllers:Mine"
    assert evaluate.main(arguments) == 0  # type: ignore[attr-defined]
    assert "controllers:Mine" in capsys.readouterr().out
    text = (tmp_path / "results" / "results.json").read_text(encoding="utf-8")
    assert list(json.loads(text)["scenarios"]["nominal"]["policies"]) == arguments[1].split(",")


def test_module_and_function_share_a_name() -> None:
    """`baselines.evaluate(...)` works whether or not the module has been imported by its name."""
    import importlib

    module = importlib.import_module("baselines.evaluate")
    assert baselines.evaluate is module and callable(module)
    assert callable(module.main) and module.evaluate.__doc__


class Gain(Policy):
    """A user's own subclass, with a knob."""

    def __init__(self, config: FormationConfig, gain: float = 0.0) -> None:
        super().__init__(config)
        self.gain = gain

    def begin(self, seeds: Any) -> None:
        pass

    def decide(self, rows: Any) -> Any:
        return np.full((*rows.shape[:2], 4), self.gain, dtype=np.float32)


class Simple:
    """An object that was made already, and does not say for how many worlds."""

    def __init__(self, thrust: float) -> None:
        self.thrust, self.ticks = thrust, 0

    def reset(self, seed: int) -> None:
        self.ticks = 0

    def act(self, observation: Any) -> Any:
        self.ticks += 1
        return np.array([[self.thrust, 0.0, 0.0, 0.0]] * 2)


def test_classes_and_objects_fly_from_python() -> None:
    simple = Simple(0.0)
    result = evaluate(
        {"expert": "expert", "gain": Gain, "simple": simple, "up": Simple(0.5), "random": Random},
        {"short": SHORT, "gusty": {"duration": 0.2, "gust": 0.5}},
        episodes=3,
        threads=2,
        quiet=True,
    )
    assert simple.ticks == 0, "an object is copied"
    assert result.scenarios["gusty"].config.gust == 0.5
    for scenario in result.scenarios.values():
        assert list(scenario.results) == ["expert", "gain", "simple", "up", "random"]
        scores = {name: each.score.value for name, each in scenario.results.items()}
        assert scenario.results["gain"].summary == scenario.results["simple"].summary
        assert max(scores["up"], scores["random"]) < scores["simple"]
    alone = evaluate("random", {"short": SHORT}, episodes=3, quiet=True)
    again = result.scenarios["short"].results["random"]
    assert alone.scenarios["short"].results["random"].summary == again.summary


def test_policies_in_a_list_are_called_after_their_classes() -> None:
    result = evaluate([Gain, Simple(0.1)], {"short": SHORT}, episodes=1, quiet=True)
    assert list(result.scenarios["short"].results) == ["Gain", "Simple"]
    with pytest.raises(ValueError, match="two are called 'Simple'"):
        evaluate([Simple(0.1), Simple(0.2)], {"short": SHORT}, quiet=True)
    with pytest.raises(ValueError, match="'expert': this name is taken"):
        evaluate({"expert": Gain}, {"short": SHORT}, quiet=True)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"episodes": 0}, "episodes = 0: expected an integer from 1"),
        ({"seed": -1}, "seed = -1: expected"),
        ({"seed": True}, "seed = True: expected"),
        ({"threads": 1.5}, "threads = 1.5: expected"),
        ({"scenarios": "windy"}, "'windy': expected some of nominal"),
        ({"policies": []}, "expected at least one"),
        ({"policies": 3}, "expected a class"),
        ({"policies": "best"}, "'best': expected one of"),
    ],
)
def test_wrong_arguments_from_python(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        evaluate(**{"policies": "hover", "scenarios": {"short": SHORT}, "quiet": True, **options})


def test_what_names_code() -> None:
    assert all(map(is_source, ("a:B", "a.b:C", "dir/file.py:D", r"C:\dir\file.py:E")))
    assert not any(map(is_source, ("a", ":B", "a:", "a:1", "a: b c", "dir/file.safetensors")))


def test_names_for_users_are_in_the_package_itself() -> None:
    """Wherever their modules lie."""
    for name in ("PolicyError", "EpisodeWarning", "TransferWarning", "UntunedWarning"):
        assert issubclass(getattr(baselines, name), Exception)
    assert baselines.PolicyError is PolicyError
    assert set(baselines.__all__) <= set(dir(baselines))
