"""The README and the manual are true: programs run, commands are what CI runs, links lead somewhere."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import pages
import pytest
from pages import APART, DOCS, PAGES, ROOT, Program

from formation_env import configure

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

README = (ROOT / "README.md").read_text(encoding="utf-8")
TEXTS = {path: path.read_text(encoding="utf-8") for path in PAGES}
# `docs/training.md` flies a file that its commands make: `test_train_cards.py` has one for it.
PROGRAMS = [
    program
    for path in PAGES
    for program in pages.programs(path)
    if path.relative_to(ROOT).as_posix() not in ("docs/training.md", *(f"docs/{x}" for x in APART))
]
# What the programs import that an installation may lack.
OPTIONAL = ("matplotlib", "pygame", "moviepy", "stable_baselines3", "torch")
COMMANDS = [text.strip() for text in pages.blocks(ROOT / "README.md", "bash")]


def test_there_are_programs() -> None:
    assert len(PROGRAMS) >= 18
    assert all("import" in program.text for program in PROGRAMS)
    assert all(len(pages.programs(DOCS / page)) == 1 for page in APART)


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda p: f"{p.page}-{p.number}")
def test_program_runs(program: Program, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each stands alone, warns of nothing (pytest turns warnings into errors) and leaves no file."""
    text = program.text
    needed = [name for name in OPTIONAL if re.search(rf"^(from|import) {name}\b", text, re.M)]
    needed += ["pygame"] * ("rgb_array" in text) + ["moviepy"] * ("RecordVideo" in text)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # their own, at import
        for name in needed:
            pytest.importorskip(name)
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    pages.run(program)
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("page", ["README.md", "docs/start.md"])
def test_the_first_program_flies_to_the_end(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Every reader's first run: the expert must not crash in it."""
    pages.run(pages.programs(ROOT / page)[0])
    assert "flew to the end" in capsys.readouterr().out


@pytest.mark.skipif(
    sys.platform == "win32" or shutil.which("bash") is None, reason="needs a POSIX shell"
)
def test_ci_runs_the_two_set_up_commands() -> None:
    run = subprocess.run(
        ["bash", ".ci/run", "show"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    main, tests = run.stdout.splitlines()
    assert COMMANDS[:2] == [main, tests], "both stand on the first screen, each in its own block"
    assert main.endswith("-m baselines.evaluate")
    assert "constraints.txt" in tests
    assert tests.endswith("-m pytest")


def test_main_job_installs_the_base_dependencies_only() -> None:
    assert "pip install -e . &&" in COMMANDS[0]


def test_torch_is_pinned_wherever_it_comes_in() -> None:
    """An extra that brings PyTorch without `-c constraints.txt` takes the newest there is."""
    lines = [line for text in TEXTS.values() for line in text.splitlines()]
    heavy = [line for line in lines if re.search(r"\[[\w,]*(train|ray|test)[\w,]*\]\"", line)]
    assert len(heavy) > 5
    assert [line for line in heavy if "pip" in line and "-c constraints.txt" not in line] == []


def test_extras_named_here_exist() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    contributing = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = re.findall(r'"\.\[([\w,]+)\]"', "".join([contributing, *TEXTS.values()]))
    extras = {extra for group in named for extra in group.split(",")}
    assert {"test", "dev", "train", "ray"} <= extras <= set(project["optional-dependencies"])


OTHERS = [
    ROOT / x for x in ("CONTRIBUTING.md", "CHANGELOG.md", "LEADERBOARD.md", "train/README.md")
]


@pytest.mark.parametrize(
    "page",
    [*PAGES, DOCS / "trained.md", *OTHERS],
    ids=lambda path: path.relative_to(ROOT).as_posix(),
)
def test_links_lead_to_files(page: Path) -> None:
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    targets = re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", text)
    assert [target for target in targets if not (page.parent / target).exists()] == []


def test_the_changelogs_duration_is_the_scenarios() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.findall(r"`nominal` lasts (\S+) s", text) == [f"{configure('nominal').duration:g}"]


def test_leaderboard_extract_has_its_place() -> None:
    begin, end = "<!-- leaderboard:begin -->", "<!-- leaderboard:end -->"
    assert README.count(begin) == README.count(end) == 1
    assert README.index(begin) < README.index(end)


def test_every_page_has_its_place_in_the_manual() -> None:
    """In the contents, or in those of the page that has contents of its own."""
    listed = set()
    for path in (DOCS / "index.md", DOCS / "libraries/index.md", DOCS / "api/index.md"):
        for block in re.findall(r"^```\{toctree\}\n(.*?)^```$", TEXTS[path], re.M | re.S):
            lines = [line for line in block.splitlines() if line and not line.startswith(":")]
            names = [re.sub(r"^.+ <(.+)>$", r"\1", line) for line in lines]
            listed |= {path.parent / name for name in names}
    there = {path.with_suffix("") for path in [*pages.MANUAL, DOCS / "trained.md"]}
    there |= {path.with_suffix("") for path in (DOCS / "notebooks").glob("*.ipynb")}
    assert listed == there - {DOCS / "index"}
