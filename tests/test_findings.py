"""What a board says in sentences: true of any figures, and of those that it is made of."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping

import numpy as np
import pytest
from made_reports import Floats, large, scenario

from baselines.policies.textbook_tuned import LAWS
from baselines.policies.tuned import GAINS
from baselines.registry import POLICIES
from baselines.reporting import budgets
from baselines.reporting.budgets import Budget
from baselines.reporting.findings import findings
from baselines.reporting.further import PLAIN, Ceiling, Further, fly_further, relieved
from baselines.reporting.report import details
from baselines.reporting.rows import agreed_best, hardest, unseparated
from baselines.scoring.evaluation import evaluate, find_flyable
from baselines.scoring.results import Report, Scenario
from baselines.scoring.suite import matrix, suite_score
from formation_env import FormationConfig, configure
from formation_env.config import NO_NOISE

FIVE = {name: configure(name) for name in ("nominal", "paper", "agile", "swarm")}
NONE: budgets.Budgets = {}


def near(level: float, seed: int = 0, count: int = 30) -> Floats:
    """Scores around a level."""
    return level + 0.01 * np.random.default_rng(seed).standard_normal(count)


@pytest.fixture(autouse=True)
def textbook(monkeypatch: pytest.MonkeyPatch) -> None:
    """All laws of `made_reports` are programmed ones."""
    for name in ("ff", "ff-filter", "ff-tuned", "lee", "lee-tuned", "lqr", "lqr-tuned"):
        monkeypatch.setitem(POLICIES, name, POLICIES["expert"])


def said(report: Report, further: Further | None = None, spent: budgets.Budgets = NONE) -> str:
    return "\n".join(findings(report, matrix(report), further or Further(), spent))


def of_laws(
    configs: Mapping[str, FormationConfig], levels: Mapping[str, float], failed: float = 0.0
) -> Report:
    """Every law at its level in every scenario."""
    runs = {law: [near(level, i)] for i, (law, level) in enumerate(levels.items())}
    return Report(0, 30, {name: scenario(runs, config=config) for name, config in configs.items()})


# -- the paper's law among the textbook's ---------------------------------------------------------


def test_laws_are_ranked_by_the_mean_where_the_papers_own_tracker_flies() -> None:
    """At `rates` another tracker flies: those scenarios do not count, whatever is scored there."""
    levels = {"expert": 0.7, "ff": 0.8, "lqr": 0.6}
    own = of_laws(FIVE, levels)
    rates = of_laws(
        {"nominal:rates": configure("nominal", action="rates")},
        {"expert": 0.99, "ff": 0.1, "lqr": 0.1},
    )
    report = own._replace(scenarios={**own.scenarios, **rates.scenarios})
    text = said(report)
    assert "at `wrench`, the level that it is printed for. Own gains, 4 scenarios: `ff` 0." in text
    assert "`expert` is number 2 of 3" in text and "At `rates` its tracker is a variant" in text
    m = matrix(own)
    for law in levels:
        score = suite_score(m, law)
        assert f"`{law}` {score.mean.value:.3f} ({score.interquartile_mean.value:.3f})" in text
    assert "and an episode of `ff` scores above one of `expert` with probability" in text
    assert "variant" not in said(own)
    assert "printed for" not in said(rates)


def test_searched_laws_are_ranked_among_themselves() -> None:
    text = said(of_laws(FIVE, {"expert": 0.7, "ff": 0.8, "expert-tuned": 0.95, "ff-tuned": 0.9}))
    assert "Own gains, 4" in text and "`expert` is number 2 of 2" in text
    assert "Searched gains, 4" in text and "`expert-tuned` is number 1 of 2" in text


def test_gusts_that_are_not_the_papers_have_their_score_without() -> None:
    report = of_laws(FIVE, {"expert": 0.7, "ff": 0.8})
    value = report.scenarios["nominal"].results["expert"].score.value
    text = said(report, Further(calm={"nominal": 0.876}))
    assert (
        f"Without gusts, which are this package's, `expert` scores 0.876 instead of {value:.3f} on `nominal`."
        in text
    )
    assert "Without gusts" not in said(report)


def test_the_collision_rule_is_named_where_the_papers_law_fails_by_it() -> None:
    def collided(share: float) -> Report:
        made = scenario(
            {"expert": [near(0.1)], "ff": [near(0.8)]},
            config=configure("experiment", action="wrench"),
        )
        row = made.results["expert"]._replace(
            failures={"collision": round(30 * share), "impact": 0}
        )
        return Report(
            0, 30, {"experiment:wrench": made._replace(results={**made.results, "expert": row})}
        )

    text = said(collided(0.9))
    rule = "end by the rule that centres stay 0.353 m apart: [why](docs/experiment.md)"
    assert f"90 % on `experiment:wrench` {rule}" in text
    assert "centres" not in said(collided(0.0))


# -- searched gains -------------------------------------------------------------------------------


def test_budgets_are_those_of_the_commands() -> None:
    assert budgets.budget_of("formation-tune-expert") == Budget(2000, 64, "both")
    words = "formation-tune-expert --policy lee --evaluations 300 --episodes=16 --feedforward zero"
    assert budgets.budget_of(words) == Budget(300, 16, "zero")


def test_budgets_without_an_option_are_those_of_the_search() -> None:
    """The defaults of a package that this one does not import."""
    pytest.importorskip("tyro")
    from train.tune_expert.options import Options

    usual = Options()
    assert Budget() == (usual.evaluations, usual.episodes, usual.feedforward)


def test_every_file_of_gains_has_its_budgets() -> None:
    found = budgets.read()
    files = {"expert-tuned": GAINS, **{f"{law}-tuned": known.file for law, known in LAWS.items()}}
    assert set(found) == set(files)
    for policy, path in files.items():
        gains = json.loads(path.read_text(encoding="utf-8"))["gains"]
        keys = {(scenario, action) for scenario, each in gains.items() for action in each}
        assert set(found[policy]) == keys
        for (name, action), budget in found[policy].items():
            made = gains[name][action]["made"]
            first, last = made["training"]
            assert budget.episodes == last - first + 1


def test_budgets_are_told_and_where_they_differ() -> None:
    levels = {
        "expert": 0.7,
        "expert-tuned": 0.9,
        "ff": 0.8,
        "ff-tuned": 0.9,
        "lee": 0.7,
        "lee-tuned": 0.8,
    }
    report = of_laws(FIVE, levels)
    keys = [(name, "wrench") for name in FIVE]
    same = {
        name: dict.fromkeys(keys, Budget(300, 16, "both"))
        for name in levels
        if name.endswith("-tuned")
    }
    text = said(report, spent=same)
    assert "Candidates x episodes: `expert-tuned`, `ff-tuned`, `lee-tuned` 300 x 16." in text
    assert "differ" not in text and "each by one search" in text
    assert "That of `expert` also chose between 2 feedforwards." in text
    other = {**same, "ff-tuned": {**same["ff-tuned"], ("swarm", "wrench"): Budget(1000, 6, "both")}}
    text = said(report, spent=other)
    told = "`expert-tuned`, `lee-tuned` 300 x 16; `ff-tuned` 300 x 16, 1000 x 6 on `swarm`."
    assert f"{told} Budgets differ on `swarm`." in text
    # From scenario to scenario, but not from policy to policy.
    smaller = {name: {**each, ("swarm", "wrench"): Budget(300, 6)} for name, each in same.items()}
    text = said(report, spent=smaller)
    assert "`lee-tuned` 300 x 16, 300 x 6 on `swarm`." in text and "differ" not in text
    fixed = {**same, "expert-tuned": dict.fromkeys(keys, Budget(300, 16, "zero"))}
    assert "feedforwards" not in said(report, spent=fixed)
    assert "Candidates" not in said(report)


def test_what_searches_bring_and_which_laws_have_none() -> None:
    report = of_laws(FIVE, {"expert": 0.7, "expert-tuned": 0.9, "ff": 0.8, "lqr": 0.8})
    text = said(report)
    gain = np.mean([
        s.results["expert-tuned"].score.value - s.results["expert"].score.value
        for s in report.scenarios.values()
    ])  # fmt: skip
    assert f"`expert` {gain:+.3f}, each by one search. `ff`, `lqr`: none searched yet." in text


# -- learned --------------------------------------------------------------------------------------


def taught(teachers: Mapping[str, str]) -> Report:
    scenarios = {}
    for name, teacher in teachers.items():
        made = scenario(
            {"expert": [near(0.7)], "dagger": [near(0.8)] * 5}, {"dagger": name}, configure(name)
        )
        source = made.sources["dagger"]._replace(teacher=teacher)
        scenarios[name] = made._replace(sources={"dagger": source})
    return Report(0, 30, scenarios)


def test_teachers_are_named() -> None:
    text = said(taught({"nominal": "lqr", "agile": "expert-tuned", "swarm": "expert-tuned"}))
    assert "`dagger` clones `expert-tuned`, on `nominal` `lqr`." in text
    assert "`dagger` clones `lqr`." in said(taught({"nominal": "lqr", "agile": "lqr"}))
    assert "clones" not in said(taught({"nominal": "", "agile": ""}))


def test_failures_are_those_of_all_runs() -> None:
    """One run of five fails always: a fifth, where the median of the runs is none."""
    made = scenario({"expert": [near(0.7)], "ppo": [near(0.8)] * 5}, {"ppo": "nominal"})
    runs = dict(made.results["ppo"].runs)
    runs["ppo#3"] = {**runs["ppo#3"], "failed": np.ones(30)}
    row = made.results["ppo"]._replace(runs=runs)
    assert row.failed == pytest.approx(0.2)
    own = made._replace(results={**made.results, "ppo": row})
    other = scenario({"expert": [near(0.7)], "ppo": [near(0.1)]}, {"ppo": "paper"})
    text = said(Report(0, 30, {"a": own, "b": other}))
    assert re.search(r"trained for the task 0\.\d{3} and 20 %, trained for another one", text)
    assert "Of 1 cell, of 5 training runs," in text


# -- what is left ---------------------------------------------------------------------------------


def test_the_hardest_scenario_and_what_limits_it() -> None:
    report = of_laws({"nominal": FIVE["nominal"]}, {"expert": 0.9, "ff": 0.8})
    hard = of_laws({"paper": FIVE["paper"]}, {"expert": 0.5, "ff": 0.6})
    report = report._replace(scenarios={**report.scenarios, **hard.scenarios})
    assert hardest(report) == "paper"
    best = {PLAIN: 0.61, "exact measurements": 0.97}
    text = said(report, Further(ceiling=Ceiling("paper", 20, best)))
    assert "The highest score is lowest on `paper`: 0." in text and "by `ff`, 2." in text
    assert (
        "On 20 episodes the highest score of a law is 0.610, and 0.970 with exact measurements."
        in text
    )
    assert "Agreed to be the best: `expert` on 1, `ff` on 1, of 2 scenarios." in text
    text = said(report, Further(ceiling=Ceiling("paper", 20, {PLAIN: 0.6})))
    assert "Its measurements are exact and nothing pushes the vehicles." in text


def test_the_highest_score_is_not_called_the_best_where_one_episode_makes_the_difference() -> None:
    """Better on all but one seed, on which it crashes: the mean is below, and nothing is separated."""
    scores = near(0.74, 3, 100)
    crashed = scores + 0.003
    crashed[74] = 0.0
    names = {"expert-tuned": scores, "lee-tuned": crashed, "ff": scores - 0.03}
    hard = scenario({name: [x] for name, x in names.items()}, config=FIVE["paper"])
    easy = scenario({name: [x + 0.2] for name, x in names.items()})
    text = said(Report(0, 100, {"paper": hard, "nominal": easy}))
    assert "by `expert-tuned`, not separated (95 %, paired) from `lee-tuned`, 2." in text
    assert unseparated(hard) == ["lee-tuned"]
    page = "\n".join(details(hard))
    assert "`expert-tuned`; by intervals (95 %) of the differences" in page
    assert "not separated from it are `lee-tuned`." in page
    clear = scenario({"expert": [near(0.9)], "ff": [near(0.8)]})
    assert unseparated(clear) == []
    assert "it is separated from all others." in "\n".join(details(clear))


def test_of_several_runs_each_has_to_be_separated() -> None:
    runs = {"expert": [near(0.9, 9)], "ppo": [near(x, i) for i, x in enumerate((0.8, 0.9, 0.8))]}
    assert unseparated(scenario(runs, {"ppo": "nominal"})) == ["ppo"]


def test_what_may_limit_a_score_is_taken_away_one_by_one() -> None:
    assert relieved(configure("agile")) == {}
    assert list(relieved(configure("nominal"))) == ["no gusts"]
    both = relieved(configure("experiment"))
    assert both["no gusts"] == configure("experiment", gust=0.0)
    exact = both["exact measurements"]
    assert (exact.noise, exact.estimator, exact.measurement_period) == (NO_NOISE, "direct", None)
    assert exact.gust == configure("experiment").gust


def test_a_tuned_law_is_not_agreed_to_be_the_best() -> None:
    """One search says as little of another as one training does."""

    def made(best: str) -> Scenario:
        return scenario({best: [near(0.95, 1)], "expert": [near(0.9, 2)]})

    assert agreed_best(made("ff")) == "ff"
    assert agreed_best(made("ff-tuned")) is None


def test_findings_without_a_subject_are_left_out() -> None:
    alone = Report(0, 30, {"nominal": scenario({"hover": [near(0.1)]})})
    assert findings(alone, matrix(alone), Further(), NONE) == []


def test_at_most_five_findings_each_said_once() -> None:
    report = large(9)
    texts = findings(report, matrix(report), Further(), NONE)
    titles = [re.match(r"\*\*(.+?)\.\*\*", text)[1] for text in texts]  # type: ignore[index]
    assert len(set(titles)) == len(titles) == 5


# -- the flights ----------------------------------------------------------------------------------


def test_what_is_flown_for_them() -> None:
    """The paper's law without gusts, and the laws of the hardest scenario without what limits it."""
    configs = {
        "nominal": configure("nominal", duration=0.4),
        "experiment": configure("experiment", duration=0.4),
    }
    policies = ["expert", "hover"]
    flyable = find_flyable(configs, policies)
    report = evaluate(configs, policies, episodes=3, flyable=flyable)
    found = fly_further(report, flyable, quiet=True)
    calm = evaluate({"x": configure("nominal", duration=0.4, gust=0.0)}, ["expert"], episodes=3)
    assert found.calm == {"nominal": calm.scenarios["x"].results["expert"].score.value}
    assert found.ceiling is not None and found.ceiling.scenario == "experiment"
    assert list(found.ceiling.best) == [PLAIN, "exact measurements", "no gusts"]
    plain = report.scenarios["experiment"].results["expert"].score.value
    assert found.ceiling.episodes == 3 and found.ceiling.best[PLAIN] == pytest.approx(plain)
    assert set(found.demands) == set(configs)
    assert found.robustness is not None and found.robustness.policies == ["expert"]
