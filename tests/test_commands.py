"""The commands: each that a page names has its console script, and helps on a terminal of 80 columns."""

from __future__ import annotations

import argparse
import importlib
import os
import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pages
import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parent.parent
PAGES = [*pages.PAGES, ROOT / "train" / "README.md", ROOT / "CONTRIBUTING.md"]
SCRIPTS: dict[str, str] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
    "project"
]["scripts"]
MODULES = {target.partition(":")[0]: name for name, target in SCRIPTS.items()}
# They need a checkout and are not installed.
CHECKOUT = (
    "train.cards",
    "benchmarks.against",
    "benchmarks.profile",
    "benchmarks.recurrence",
    "benchmarks.throughput",
)
# A part of `benchmarks.against`, and a table that is printed.
WITHOUT_OPTIONS = {"benchmarks.turn", "baselines.reproduction.assumptions"}
# Where the commands that use argparse make their parsers: not those of training.
PARSERS = {
    module: "baselines.scoring.options" if module == "baselines.evaluate" else module
    for module in (*MODULES, *CHECKOUT)
    if not module.startswith("train.") or module == "train.cards"
}


def helped(
    module: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> list[str]:
    """The lines of a command's help."""
    if module.startswith("train.") and module != "train.cards":
        pytest.importorskip("tyro")
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.delenv("OMP_WAIT_POLICY", raising=False)
    main = importlib.import_module(module).main
    with suppress(SystemExit):
        assert main(["--help"]) == 0
    return capsys.readouterr().out.splitlines()


def test_every_documented_command_has_a_script() -> None:
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    named = set(re.findall(r"python -m ((?:baselines|train|benchmarks)(?:\.\w+)+)", text))
    named |= set(re.findall(r"`((?:baselines|train)\.\w+)`", text)) & set(MODULES)
    assert named - {*CHECKOUT, *WITHOUT_OPTIONS} <= set(MODULES)
    scripts = set(re.findall(r"\b(formation-[a-z-]+)\b(?!\.)", text)) - {"formation-env"}
    assert scripts == set(SCRIPTS), "the pages use each of them and no other"


@pytest.mark.parametrize("module", [*MODULES, *CHECKOUT])
def test_help_fits_and_is_the_scripts_own(
    module: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = helped(module, capsys, monkeypatch)
    assert len(lines) > 8
    assert [line for line in lines if len(line) > 80] == []
    assert lines[0].startswith(f"usage: {MODULES.get(module, module)} ")


def test_every_command_is_known() -> None:
    """All files that run as a command.

    But for the process that `benchmarks.against` starts itself, and a table that is printed without options.
    """
    folders = [ROOT / "baselines", ROOT / "benchmarks"]
    files = {path for folder in folders for path in folder.rglob("*.py")}
    runs = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in files
        if '__name__ == "__main__"' in path.read_text(encoding="utf-8")
    }
    packages = {"train.cards", "baselines.play", "baselines.replay"}  # run by their `__main__`
    assert runs - WITHOUT_OPTIONS == set(PARSERS) - packages


@pytest.mark.parametrize("columns", [80, 100])
@pytest.mark.parametrize("module", list(PARSERS))
def test_every_option_says_what_it_does_and_its_default(
    module: str, columns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full phrase, with a stop, and then the default that the parser has."""
    monkeypatch.setenv("COLUMNS", str(columns))
    parser = importlib.import_module(PARSERS[module]).parser()
    text = parser.format_help()
    assert max(map(len, text.splitlines())) <= columns
    options = [action for action in parser._actions if action.dest != "help"]
    assert options
    for action in options:
        said = " ".join((action.help or "").split()) % {**vars(action), "prog": parser.prog}
        phrase = re.fullmatch(r"[A-Z]\S*( \S+){3,}\. \((default: (?P<default>.+)|required)\)", said)
        assert phrase, f"{action.option_strings}: {said}"
        assert said in re.sub(r"\s+", " ", text), "as it is shown"
        assert (phrase["default"] is None) == action.required, said
        default = "off" if action.default is False else action.default
        if isinstance(default, str | int | float | Path) and default != argparse.SUPPRESS:
            assert re.match(rf"{re.escape(str(default))}(,|;|$)", phrase["default"]), said


@pytest.mark.parametrize("module", [m for m in MODULES if m.startswith("train.")])
def test_every_option_is_a_phrase(
    module: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It begins with what the value is, ends with a stop, and the default follows."""
    lines = helped(module, capsys, monkeypatch)
    text = " ".join(line.strip("│| ") for line in lines[1:] if line[:1] in " │|")
    options = re.split(r"(?:^|(?<=\)) )(?=--[a-z-]+)", text)[1:]
    assert len(options) > 10
    for option in options:
        assert re.search(r"[A-Z]\S*( \S+){3,}\. \((default: .*|required)\)", option), option


@pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX shell")
@pytest.mark.parametrize(
    "module",
    [
        "baselines.paper",
        "train.cards",
        "train.imitate",
        "train.ppo",
        "train.rllib",
        "train.tune_expert",
    ],
)
def test_help_is_cut_short_in_peace(module: str) -> None:
    """What `python -m` prints goes to a closed pipe; nothing is said on the standard error."""
    if module.startswith("train.") and module != "train.cards":
        pytest.importorskip("tyro")
    read, write = os.pipe()
    os.close(read)
    run = subprocess.run(
        [sys.executable, "-m", module, "--help"],
        cwd=ROOT, stdout=write, stderr=subprocess.PIPE, text=True, check=False,
    )  # fmt: skip
    os.close(write)
    assert (run.returncode, run.stderr) == (0, "")


def test_threads_that_wait_sleep_and_there_is_one() -> None:
    """Set before PyTorch is loaded, which is later too late; what the user has set stays."""
    pytest.importorskip("tyro")
    code = (
        "import os, sys; from train import imitate, ppo; assert 'torch' not in sys.modules\n"
        "from train.command_line import wait_passively\n"
        "wait_passively(); print(os.environ['OMP_WAIT_POLICY'])\n"
        "from train.ppo.options import Options; print(Options('x').threads)\n"
    )
    for given, expected in ((None, "PASSIVE"), ("ACTIVE", "ACTIVE")):
        env = {k: v for k, v in os.environ.items() if k != "OMP_WAIT_POLICY"}
        env |= {} if given is None else {"OMP_WAIT_POLICY": given}
        run = subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, env=env, capture_output=True, text=True
        )
        assert run.stdout.split() == [expected, "1"], run.stderr


@pytest.mark.parametrize("module", ["train.ppo", "train.imitate", "train.rllib"])
def test_trainers_wait_passively(
    module: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    helped(module, capsys, monkeypatch)
    assert os.environ.pop("OMP_WAIT_POLICY") == "PASSIVE"
