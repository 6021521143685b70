"""The guide to training: made from what is checked in, the same every time, and never stale."""

from __future__ import annotations

import importlib
import json
import math
import re
import shlex
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from training_runs import (
    CONFIG,
    a_run,
    bare_checkout,
    card,
    contents,
    main,
    policy,
    refused,
    row,
    rows_of,
)

from baselines import files
from train import cards
from train.cards import guide, shipping
from train.cards.curves import Curve, Key, read_curve, read_log, thinned, to_text
from train.log import to_csv


@pytest.fixture
def checkout(tmp_path: Path, root: Path) -> Path:
    return bare_checkout(tmp_path, root)


# -- what is checked in here ----------------------------------------------------------------------


def test_the_guide_is_the_one_that_the_script_makes(root: Path) -> None:
    assert (root / guide.PAGE).read_text(encoding="utf-8") == guide.page(guide.gather(root)), (
        "run python -m train.cards"
    )


def test_the_pictures_show_the_curves_that_are_checked_in(root: Path) -> None:
    from train.cards.pictures import digest

    facts = guide.gather(root)
    for name, curves in guide.pictures(facts.curves).items():
        data = (root / shipping.CURVES / name).read_bytes()
        compared = facts.board.get((curves[0].key.scenario, curves[0].key.action), {})
        assert digest(curves, compared).encode() in data, f"{name}: run python -m train.cards"
        assert len(data) < 60_000


def test_generalisation_is_of_the_policies_that_ship(root: Path) -> None:
    assert guide.gather(root).stale == [], "run python -m train.cards --generalise"


def test_what_ships_is_small_and_where_it_says(root: Path) -> None:
    for key, path in shipping.shipped(root):
        made, _ = files.load(path)
        assert path.stat().st_size <= shipping.LARGEST_FILE
        assert (made.scenario, made.action) == (key.scenario, key.action)
        assert key.scenario in made.score


# -- the text -------------------------------------------------------------------------------------


def test_the_program_flies_a_policy_of_ones_own(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (program,) = re.findall(r"^```python\n(.*?)^```$", guide_of(root), re.MULTILINE | re.DOTALL)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    a_run(tmp_path / "runs/ppo")
    exec(compile(program, "docs/training.md", "exec"), {"__name__": "__main__"})
    assert capsys.readouterr().out.startswith("return ")


@pytest.mark.parametrize("module", ["ppo", "imitate", "tune_expert", "rllib"])
def test_the_options_in_the_commands_exist(root: Path, module: str) -> None:
    tyro = pytest.importorskip("tyro")
    options = importlib.import_module(f"train.{module}.options").Options
    program = {"tune_expert": "tune-expert"}.get(module, f"train-{module}")
    found = re.findall(rf"^formation-{program} (.*)$", guide_of(root), re.M)
    assert found
    for words in found:
        given = tyro.cli(options, args=shlex.split(words))
        if hasattr(given, "check"):
            given.check()


def test_the_policies_in_the_commands_are_made_by_earlier_commands(root: Path) -> None:
    text = guide_of(root)
    for found in re.finditer(r"runs/[\w-]+/best\.safetensors", text):
        folder = found[0].rpartition("/")[0]
        assert f"--output {folder} " in text[: found.start()], found[0]


def guide_of(root: Path) -> str:
    """How to train, as the manual has it."""
    return (root / "docs/training.md").read_text(encoding="utf-8")


# -- curves ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "best"), [(7, 2), (60, 59), (61, 30), (1000, 0), (1000, 517)])
def test_thinning_keeps_first_last_and_best(count: int, best: int) -> None:
    rows = rows_of(count, best)
    kept = thinned(rows)
    assert len(kept) == min(count, len(kept)) <= 60
    assert {rows[0], rows[-1], rows[best]} <= set(kept)
    assert list(kept) == [r for r in rows if r in set(kept)]
    widest = max(b.steps - a.steps for a, b in pairwise(kept))
    assert widest <= 1000 * math.ceil((count - 1) / min(count - 1, 58))


def test_a_curve_is_read_back_as_written(tmp_path: Path) -> None:
    curve = Curve(Key("paper", "rates", "bc-ppo"), 3, "python -m train.ppo", (row(10, 0.25),))
    path = tmp_path / curve.name
    path.write_text(to_text(curve))
    assert read_curve(path) == Curve(*curve[:3], (row(10, 0.25)._replace(minutes=0.0),))
    assert path.name == "bc-ppo-paper-rates-3.csv"


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("", "begins with steps,minutes"),
        (to_csv([]), "no evaluation"),
        (to_csv([row(2, 0.5), row(1, 0.5)]), "do not grow"),
        (to_csv([row(1, math.nan)]), "nan"),
        (to_csv([row(1, 0.5)]) + "2,0.1\n", "'2,0.1'"),
    ],
)
def test_a_log_that_is_not_one_is_refused(text: str, names: str) -> None:
    with pytest.raises(ValueError, match=names):
        read_log(text)


def test_runs_are_averaged_where_all_have_been() -> None:
    """Two straight lines: at every step the mean, the lower and the upper one, as by hand."""
    from train.cards.pictures import band

    key = Key("nominal", "wrench", "ppo")
    one = Curve(key, 0, "", (row(0, 0.0), row(100, 1.0)))
    two = Curve(key, 1, "", (row(20, 0.4), row(60, 0.8), row(120, 0.2)))
    b = band([one, two])
    assert b.steps.tolist() == [20, 60, 100]
    np.testing.assert_allclose(b.low, [0.2, 0.6, 0.4], atol=1e-12)
    np.testing.assert_allclose(b.high, [0.4, 0.8, 1.0], atol=1e-12)
    np.testing.assert_allclose(b.mean, [0.3, 0.7, 0.7], atol=1e-12)
    with pytest.raises(ValueError, match=r"ppo-nominal-wrench-1\.csv"):
        band([one, Curve(key, 1, "", (row(200, 0.4),))])


# -- the whole way --------------------------------------------------------------------------------


def test_a_run_becomes_a_policy_a_curve_and_a_page(
    checkout: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    run = a_run(tmp_path / "run")
    assert cards._ship([run], None, checkout, 1, episodes=2) == 0
    _, result = shipping.scored([shipping.open_run(run)], 2, 1)
    assert f"score {result.score.value:.3f} of " in capsys.readouterr().out
    assert main(checkout, "--curve", run, "--method", "rllib-ppo") == 0
    made, network = files.load(checkout / "baselines/policies/ppo-nominal-wrench.safetensors")
    assert made.score["nominal"] == pytest.approx(result.score[:3], abs=1e-5)
    assert result.score.value < 0.5, "flown, not taken from the card it came with"
    np.testing.assert_array_equal(network.weights[0], policy().weights[0])

    assert main(checkout) == 0
    first = contents(checkout)
    assert main(checkout) == 0
    assert contents(checkout) == first
    text = first["docs/trained.md"].decode()
    assert f"{result.score.value:.3f}" in text and "`rllib-ppo` | - | 2.000, 1 seed" in text
    assert "`python -m train.ppo --seed 3`" in text and "48-8-4 tanh" in text
    assert "curves/nominal-wrench.png" in text


def test_curves_are_drawn_beside_the_scores_of_the_board(checkout: Path, tmp_path: Path) -> None:
    """Of the expert and `ff`, at the curve's scenario and level; another score gives another picture."""
    pytest.importorskip("matplotlib")
    run = a_run(tmp_path / "run")
    assert main(checkout, "--curve", run) == main(checkout) == 0
    picture = checkout / shipping.CURVES / "nominal-wrench.png"
    alone = picture.read_bytes()
    (checkout / guide.BOARD).parent.mkdir(parents=True)
    scores = {"expert": 0.91, "ff": 0.95, "hover": 0.1}
    policies = {name: {"metrics": {"score": [s, s, s, 9]}} for name, s in scores.items()}
    other = {"action": "rates", "policies": {}}
    document = {
        "scenarios": {"nominal": {"action": "wrench", "policies": policies}, "x:rates": other}
    }
    (checkout / guide.BOARD).write_text(json.dumps(document))
    shown = {"expert": 0.91, "ff": 0.95}
    assert guide.gather(checkout).board == {("nominal", "wrench"): shown, ("x", "rates"): {}}
    assert main(checkout) == 0
    assert picture.read_bytes() != alone
    (checkout / guide.BOARD).write_text("{}")
    with pytest.raises(ValueError, match=r"results\.json: not what"):
        guide.gather(checkout)


def test_the_median_of_several_runs_ships_and_all_curves(checkout: Path, tmp_path: Path) -> None:
    """Whatever their order: the scores of the networks are those of the folders' names."""
    flown = {}
    for seed, scale in enumerate((0.1, 0.0, 0.003)):
        folder = tmp_path / f"run-{seed}"
        a_run(folder, card(seed=seed), policy(scale))
        (folder / "log.csv").write_text(to_csv([row(1, 0.5, seed)]))
        _, result = shipping.scored([shipping.open_run(folder)], 3, 1)
        flown[folder] = result.score.value
    assert len(set(flown.values())) == 3
    median = sorted(flown, key=lambda folder: flown[folder])[1]
    assert cards._ship([*flown], None, checkout, 1, episodes=3) == 0
    made, _ = files.load(checkout / "baselines/policies/ppo-nominal-wrench.safetensors")
    assert f"run-{made.seed}" == median.name
    value, low, high = made.score["nominal"]
    assert value == pytest.approx(flown[median], abs=1e-5)
    assert low == pytest.approx(min(flown.values()), abs=0.02) and high > low
    curves = sorted(p.name for p in (checkout / shipping.CURVES).glob("*.csv"))
    assert curves == [f"ppo-nominal-wrench-{seed}.csv" for seed in range(3)]


def test_runs_that_do_not_belong_together_are_not_shipped(
    checkout: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, same = a_run(tmp_path / "one"), a_run(tmp_path / "same")
    other = a_run(tmp_path / "other", card(scenario="agile"))
    refused(checkout, capsys, "seed 3 twice", "--ship", one, same)
    refused(checkout, capsys, "agile wrench ppo: expected runs of one method", "--ship", one, other)


def test_generalisation_tells_its_policies_apart_from_later_ones(
    checkout: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shipping, "tasks", lambda action: {"nominal": CONFIG})
    run = shipping.open_run(a_run(tmp_path / "run"))
    shipping.ship(run, shipping.Estimate(0.5, 0.4, 0.6, 2), checkout)
    text = shipping.transfers_text(shipping.transfers(checkout, 1, episodes=2))
    (checkout / shipping.GENERALISATION).write_text(text)
    facts = guide.gather(checkout)
    assert [t.policy for t in facts.transfers] == ["expert", "ff", "ppo"]
    score = facts.transfers[0].score
    assert 0.5 < score < 1.0 and facts.stale == []
    assert f"| nominal | {score:.3f} (" in guide.page(facts)
    shipping.ship(run, shipping.Estimate(0.6, 0.4, 0.7, 2), checkout)
    facts = guide.gather(checkout)
    assert [t.policy for t in facts.transfers] == ["expert", "ff"]
    assert facts.stale == ["ppo-nominal-wrench.safetensors"]


def test_the_tasks_are_others_than_the_one_trained_on() -> None:
    for action in ("wrench", "reference"):
        tasks = shipping.tasks(action)
        assert {config.action for config in tasks.values()} == {action}
        assert len({(c.scenario, c.offsets) for c in tasks.values()}) == len(tasks) == 8
