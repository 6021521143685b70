"""The bar of a training run: towards the limit in force, with the score, no time of compiling in it."""

from __future__ import annotations

import pytest

pytest.importorskip("scipy")

from tqdm import tqdm

from train.log import LogRow
from train.progress import BAR, Progress, described, part_done

ROWS = [
    LogRow(0, 0.0, 0.25, 0.2, 0.3, 1.0, 1.0, 0.0, 0),
    LogRow(5, 1.0, 0.9, 0.8, 1.0, 2.0, 0.5, 0.0, 0),
]


@pytest.mark.parametrize(
    ("steps", "minutes", "most_minutes", "part", "text"),
    [
        (250, 1.0, None, 0.25, "250 of 1.00k steps"),
        (250, 1.0, 10.0, 0.25, "250 of 1.00k steps"),
        (250, 5.0, 10.0, 0.5, "5.0 of 10 min, 250 steps"),
        (2000, 5.0, 10.0, 1.0, "2.00k of 1.00k steps"),
        (0, 30.0, 10.0, 1.0, "30.0 of 10 min, 0.00 steps"),
    ],
)
def test_the_nearer_limit_counts(
    steps: int, minutes: float, most_minutes: float | None, part: float, text: str
) -> None:
    assert part_done(steps, minutes, 1000, most_minutes) == part
    assert described(steps, minutes, 1000, most_minutes, ()) == text
    assert described(steps, minutes, 1000, most_minutes, ROWS) == f"{text}, score 0.900"


def test_it_fits_a_terminal_and_goes_on(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A resumed run begins where it was; nothing is shown before the first call, or if quiet."""
    monkeypatch.setenv("COLUMNS", "80")
    bar = Progress(20_000_000, 10.0, quiet=False)
    assert capsys.readouterr().err == ""
    bar.show(10_000_000, 2.0, ROWS)
    bar.show(20_000_000, 3.0, ROWS)
    bar.close()
    shown = [line for line in capsys.readouterr().err.replace("\n", "\r").split("\r") if line]
    assert shown[0].startswith(" 50 %") and shown[-1].startswith("100 %")
    assert "20.0M of 20.0M steps, score 0.900" in shown[-1]
    quiet = Progress(10, None, quiet=True)
    quiet.show(5, 1.0, ROWS)
    quiet.close()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("score", [{}, {"score": -0.123}])
def test_the_bar_of_cloning_fits_a_terminal(
    score: dict[str, float], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A terminal of 80 columns cuts nothing off, and some of it is a bar."""
    monkeypatch.setenv("COLUMNS", "80")
    run = pytest.importorskip("train.imitate.run")
    text = run.described(40, 40, {"loss": 0.25, "held_out": 0.0123456, **score})
    assert text == "40 of 40 rounds, error 0.0123" + (", score -0.123" if score else "")
    bar = tqdm(total=1, bar_format=BAR, ncols=80)
    bar.set_description_str(text)
    bar.update()
    bar.close()
    last = capsys.readouterr().err.rstrip("\n").split("\r")[-1]
    assert text in last and last.endswith("left]")
    assert len(last) <= 80 and last.startswith("100 %|█████")
