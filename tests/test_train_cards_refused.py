"""What the guide to training does not take in: one line, and nothing is changed."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from training_runs import (
    a_run,
    bare_checkout,
    card,
    contents,
    main,
    policy,
    refused,
    row,
)

from train.cards import guide, shipping
from train.log import to_csv


@pytest.fixture
def checkout(tmp_path: Path, root: Path) -> Path:
    return bare_checkout(tmp_path, root)


def test_ship_refuses_what_is_no_finished_run(
    checkout: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = a_run(tmp_path / "run")
    refused(checkout, capsys, "no best.safetensors", "--ship", tmp_path / "nowhere")
    (run / "log.csv").write_text("steps\n1\n")
    refused(checkout, capsys, "log.csv: expected a log", "--ship", run)
    (run / "log.csv").write_text(to_csv([row(1, 0.5, seed=4)]))
    refused(checkout, capsys, "seed 4", "--ship", run)
    (run / "log.csv").unlink()
    refused(checkout, capsys, "no log.csv", "--ship", run)
    (run / "log.csv").write_text(to_csv([row(1, 0.5)]))
    (run / "best.safetensors").write_bytes(b"not a policy")
    refused(checkout, capsys, "best.safetensors: not a whole", "--ship", run)


def test_ship_refuses_a_policy_that_does_not_fit_or_is_too_large(
    checkout: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = a_run(tmp_path / "short", card(entries=7), policy(entries=7))
    refused(checkout, capsys, "observation entries", "--ship", short)
    odd = a_run(tmp_path / "odd", card(scenario="elsewhere"))
    refused(checkout, capsys, "'elsewhere'", "--ship", odd)
    unknown = a_run(tmp_path / "unknown", card(method="home-made"))
    refused(checkout, capsys, "'home-made'", "--ship", unknown)
    large = a_run(tmp_path / "large", None, policy(hidden=6000))
    refused(checkout, capsys, "bytes: expected at most", "--ship", large)


def test_wrong_options_and_folders_are_refused(
    checkout: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = a_run(tmp_path / "run")
    refused(checkout, capsys, "--method", "--method", "ppo")
    refused(checkout, capsys, "--method", "--ship", run, "--method", "../ppo")
    refused(checkout, capsys, "no policy of 'nominal'", "--generalise")
    refused(tmp_path / "run", capsys, "expected a checkout", "--curve", run)
    refused(checkout, capsys, "no best", "--curve", run, tmp_path / "nowhere")
    (checkout / shipping.CURVES).mkdir(parents=True)
    (checkout / shipping.CURVES / "mine.csv").write_text(to_csv([row(1, 0.5)]))
    refused(checkout, capsys, "mine.csv: expected a name")
    (checkout / shipping.CURVES / "mine.csv").unlink()
    (checkout / shipping.GENERALISATION).write_text("task\nnominal\n")
    refused(checkout, capsys, "generalisation.csv: not what")
    (checkout / shipping.GENERALISATION).unlink()
    template = checkout / guide.TEMPLATE
    template.write_text(template.read_text(encoding="utf-8").replace("<!-- cards -->", ""))
    refused(checkout, capsys, "<!-- cards -->")


def test_a_missing_extra_is_named(
    checkout: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    refused(checkout, capsys, 'pip install "formation-env[plot]"')


def test_a_full_disk_leaves_the_earlier_page(
    checkout: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    assert main(checkout) == 0
    before = contents(checkout)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    assert main(checkout) == 1
    assert "No space left" in capsys.readouterr().err
    assert contents(checkout) == before
