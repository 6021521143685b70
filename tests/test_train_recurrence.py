"""The comparison of memories: both kinds are trained and scored alike, and what is wrong is said."""

from __future__ import annotations

import sys
import warnings
from typing import Any

import numpy as np
import pytest

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # their own, at import
    for module in ("torch", "stable_baselines3", "sb3_contrib", "tensorboard", "tyro"):
        pytest.importorskip(module)
    from benchmarks import recurrence

from formation_env import configure


def test_the_recurrent_policy_remembers_and_forgets_where_an_episode_begins() -> None:
    """As sb3-contrib's own `predict`, world by world; a memory is of use only if it changes something."""
    config = configure("paper", action="reference")
    shape = (3, config.followers, config.layout.size)
    seen = np.random.default_rng(0).normal(size=(4, *shape)).astype(np.float32)

    class Sum:
        """The sum of what was seen since the episode began."""

        def predict(self, rows: Any, state: Any, fresh: Any, deterministic: bool) -> Any:
            assert deterministic
            before = 0.0 if state is None else np.where(fresh, 0.0, state)
            state = before + rows.sum(axis=1)
            return np.repeat(state[:, None], 3, axis=1), state

    pilot = recurrence._policy(config, Sum())
    pilot.reset(worlds=3)
    pilot.act(seen[0])
    pilot.act(seen[1])
    pilot.restart(np.array([False, True, False]))
    got = pilot.act(seen[2])
    wanted = seen[:3].sum(axis=(0, 3))
    wanted[1] = seen[2, 1].sum(axis=1)
    np.testing.assert_allclose(got, np.repeat(wanted[..., None], 3, axis=2), rtol=1e-4)


def test_both_kinds_are_scored_on_the_same_scale() -> None:
    """Untrained, all are about as good as hover, the zero."""
    figures = [recurrence.stacked(4, 0, 1e-9, 1), recurrence.recurrent(0, 1e-9, 1)]
    for figure in figures:
        assert abs(figure.score[0]) < 0.3 and figure.steps < 1000
    lines = recurrence.table(figures).splitlines()
    assert len(lines) == 4 and lines[2].startswith("| history of 4 | 0 |")


@pytest.mark.parametrize(
    ("words", "names"),
    [(["--minutes", "0"], "minutes above 0"), (["--seeds", "x"], "whole number from 1")],
)
def test_impossible_options_are_refused(
    words: list[str], names: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        recurrence.main(words)
    assert end.value.code == 2
    assert names in capsys.readouterr().err


def test_a_missing_package_is_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "sb3_contrib", None)
    with pytest.raises(SystemExit) as end:
        recurrence.main([])
    assert end.value.code == 2
    assert "sb3-contrib" in capsys.readouterr().err
