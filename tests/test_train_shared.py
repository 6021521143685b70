"""What the training commands share: options that a command line repeats, early ends, corrections."""

from __future__ import annotations

import ast
import importlib
import re
import shlex
from dataclasses import fields
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("tyro")

from baselines.files import Card, Network
from baselines.policies.actions import corrected, correction_towards
from baselines.policies.expert import Expert
from baselines.policies.learned import Learned
from formation_env import configure
from formation_env.task import NEIGHBOUR_ENTRIES
from train import imitate, ppo, rllib
from train.command_line import read_options
from train.imitate.options import Options as ImitateOptions
from train.options import PPOOptions, RunOptions
from train.ppo.options import Options as PPO
from train.rllib.options import Options as RLlib
from train.rows import EarlyEnds
from train.scales import fixed_scales

ROOT = Path(__file__).resolve().parent.parent
# A value for each option that is not its default.
OTHER: dict[str, Any] = {
    "output": Path("elsewhere"), "scenario": "paper", "action": "rates", "seed": 7, "hidden": (8, 4),
    "activation": "relu", "episodes": 5, "threads": 2, "quiet": True, "steps": 1000, "minutes": 2.5,
    "resume": True, "critic": "central", "worlds": 9, "rollout": 16, "batch": 32, "epochs": 2,
    "learning_rate": 0.01, "gamma": 0.9, "gae_lambda": 0.8, "clip_range": 0.1, "entropy": 0.01,
    "value": 0.25, "gradient": 1.5, "std": 0.125, "evaluate_every": 3, "save_every": 2.0,
    "init": Path("a b.safetensors"), "residual": 0.25, "history": 2, "start": "ground",
    "start_offset": 0.5, "scenario_duration": 4.0, "actor_rate": 0.5, "kl": 0.01, "critic_steps": 10,
    "normalise": "running", "profile": True, "runners": 2, "address": "host:1", "method": "bc",
    "teacher": "expert-tuned", "rounds": 3, "ticks": 10, "updates": 4, "buffer": 50, "share": 0.25,
    "stray": 5.0, "noise": 0.5, "explore": 0.1, "magnify": 2.0, "huber": 0.5, "tensorboard": True,
    "margin": False,
}  # fmt: skip

CHECKED_BY_CONFIGURATION = {"start_offset", "scenario_duration"}


@pytest.mark.parametrize("neighbours", [0, 3])
@pytest.mark.parametrize("level", ["wrench", "reference"])
def test_networks_divide_by_what_is_typical_of_each_quantity(level: str, neighbours: int) -> None:
    """Its spread, not its bound; of the upright third body axis alone the mean is not zero."""
    layout = configure(action=level, neighbours=neighbours).layout
    mean, scale = (layout.unpack(rows) for rows in fixed_scales(layout))
    for entry in (*layout.entries, *NEIGHBOUR_ENTRIES):
        assert (scale[entry.name] == np.float32(entry.typical)).all()
        expected = (0.0, 0.0, 1.0) if entry.name == "body_z" else 0.0
        assert (mean[entry.name] == expected).all()
    assert (scale["slot_error"] < 1.0).all() and (scale["position"] > 10.0).all()
    fixed_scales(layout)[1][:] = 7.0
    assert not (layout.typical == 7.0).any()


@pytest.mark.parametrize("kind", [PPO, RLlib, ImitateOptions])
def test_the_command_of_a_run_repeats_its_options(kind: type[RunOptions]) -> None:
    """Read as a command line, it gives every option back but for those that change no result.

    It begins with the script that the help of the command names.
    """
    names = [f.name for f in fields(kind)]
    options = kind(**{name: OTHER[name] for name in names})
    words = shlex.split(options.command())
    assert words[0] == importlib.import_module(kind.__module__.rpartition(".")[0]).SCRIPT
    again = read_options(kind, "script", [*words[1:], "--output", "x"])
    for name in names:
        same = getattr(again, name) == getattr(options, name)
        assert same == (name not in kind.without_effect), name


@pytest.mark.parametrize("kind", [PPO, RLlib, ImitateOptions])
def test_what_a_command_leaves_out(kind: type[RunOptions]) -> None:
    """Where files lie, threads, what is printed or profiled, and whether a run was resumed."""
    switches = {f.name for f in fields(kind) if f.type == "bool"} - {"margin"}
    assert {"output", "threads", "quiet", *switches} == set(kind.without_effect) - {"address"}


def help_texts() -> dict[str, str]:
    """The help text of each option of the training commands, by file and name."""
    texts = {}
    for path in [ROOT / "train/options.py", *(ROOT / "train").glob("*/options.py")]:
        for kind in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            body = kind.body if isinstance(kind, ast.ClassDef) else []
            for option, text in pairwise(body):
                if isinstance(option, ast.AnnAssign) and isinstance(text, ast.Expr):
                    place = f"{path.parent.name}.{ast.unparse(option.target)}"
                    texts[place] = ast.literal_eval(text.value)
    return texts


def test_help_names_the_thing_that_an_option_sets() -> None:
    """It does not begin or end as an answer to a question that it leaves out."""
    texts = help_texts()
    assert len(texts) > 60
    for place, text in texts.items():
        assert text.split()[0] not in ("At", "Of", "In", "As", "By", "With", "So", "From"), place
        assert not re.search(r"\bso (many|much)\b|\bor so\b", text), place


def test_what_can_be_given_to_a_resumed_run_is_an_option() -> None:
    for kind in (PPO, RLlib):
        assert set(kind.free_on_resume) <= {f.name for f in fields(kind)}
        assert {"steps", "minutes", "resume", "output", "quiet"} <= set(kind.free_on_resume)


@pytest.mark.parametrize("kind", [PPO, RLlib, ImitateOptions])
def test_every_number_has_a_range(kind: type[RunOptions]) -> None:
    """But for the two that the configuration checks; a number outside is refused by its option's name."""
    ranges = {**kind.integers, **kind.numbers}
    for f in fields(kind):
        numeric = str(f.type).removesuffix(" | None") in ("int", "float")
        assert (f.name in ranges) == (numeric and f.name not in CHECKED_BY_CONFIGURATION), f.name
    assert set(kind.integers).isdisjoint(kind.numbers)
    for name, (least, most) in ranges.items():
        for bad in (least - 1 - abs(least), 2 * most + 1):
            with pytest.raises(ValueError, match=f"^--{name.replace('_', '-')} "):
                kind(Path("x"), **{name: bad})


def test_shared_options_have_one_help_text() -> None:
    """Only these are said anew by a command, because they mean something else there."""
    said_again = {
        PPO: {"resume", "std", "hidden", "activation"},
        RLlib: {"resume", "worlds", "rollout", "batch", "threads"},
        ImitateOptions: {"threads"},
    }
    for kind, expected in said_again.items():
        shared = {f.name for f in fields(PPOOptions if kind is not ImitateOptions else RunOptions)}
        assert set(kind.__annotations__) & shared == expected
    for module in (ppo, rllib, imitate):
        assert module.SCRIPT.startswith("formation-train-")


# -- early ends -----------------------------------------------------------------------------------


def test_first_episodes_end_once_at_ages_of_an_episode() -> None:
    ends = EarlyEnds(2000)
    assert not ends.tick().any(), "none before they are staggered"
    ends.stagger(np.random.default_rng(0), 10)
    when = np.zeros(2000, dtype=int)
    for tick in range(1, 31):
        due = ends.tick()
        assert (when[due] == 0).all()
        when[due] = tick
        ends.cancel(due)
    counts = np.bincount(when, minlength=11)
    assert counts[0] == 0 and len(counts) == 11, "from the first tick to the last"
    assert (abs(counts[1:] - 200) < 60).all()


def test_only_worlds_that_fly_come_nearer_to_their_end() -> None:
    ends = EarlyEnds(3)
    ends.end_next(np.array([True, True, False]))
    assert ends.tick(np.array([True, False, True])).tolist() == [True, False, False]
    assert ends.tick(np.array([False, True, True])).tolist() == [True, True, False]


# -- corrections ----------------------------------------------------------------------------------


def test_a_correction_towards_an_action_gives_it_where_the_bound_allows() -> None:
    rng = np.random.default_rng(0)
    wanted, expert = rng.uniform(-1.0, 1.0, (2, 5000, 4)).astype(np.float32)
    for bound in (0.1, 0.5, 1.0):
        got = corrected(expert, correction_towards(wanted, expert, bound), bound)
        assert got.dtype == np.float32
        nearest = expert + np.clip(wanted - expert, -bound, bound)
        np.testing.assert_allclose(got, nearest, atol=1e-6)


@pytest.mark.parametrize("bound", [0.2, 1.0])
def test_a_policy_file_corrects_the_expert_with_the_same_bits(bound: float) -> None:
    """`Learned` with a network whose output is constant, far beyond the bound in some entries."""
    config = configure("paper", action="rates")
    output = np.array([0.3, -0.7, 5.0, -1.5], dtype=np.float32)
    entries = config.layout.size
    network = Network(
        (np.zeros((4, entries), np.float32),), (output,), np.zeros(entries, np.float32),
        np.ones(entries, np.float32),
    )  # fmt: skip
    card = Card(action="rates", entries=entries, action_size=4, scenario="paper",
                method="residual", residual=bound)  # fmt: skip
    policy, expert = Learned(config, (card, network)), Expert(config)
    policy.reset(worlds=3)
    expert.reset(worlds=3)
    shape = (3, config.followers, entries)
    rows = np.random.default_rng(1).normal(0.0, 0.5, shape).astype(np.float32)
    wanted = corrected(expert.act(rows), np.broadcast_to(output, (*shape[:2], 4)), bound)
    assert np.array_equal(policy.act(rows), wanted)
