"""The README is true: its programs run, its commands are what CI runs, its links lead somewhere."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import pytest

from formation_env import configure

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
FENCED = re.findall(r"^```(\w+)\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL)
EXAMPLES = (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")
PROGRAMS = [text for language, text in FENCED if language == "python"]
PROGRAMS += re.findall(r"^```python\n(.*?)^```$", EXAMPLES, flags=re.MULTILINE | re.DOTALL)
# What the programs import that an installation may lack.
OPTIONAL = ("matplotlib", "pygame", "moviepy", "stable_baselines3", "torch")
COMMANDS = [text.strip() for language, text in FENCED if language == "bash"]


def test_there_are_programs() -> None:
    assert len(PROGRAMS) >= 10
    assert all("import" in program for program in PROGRAMS)


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda text: text.splitlines()[-1][:40])
def test_program_runs(program: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each stands alone, warns of nothing (pytest turns warnings into errors) and leaves no file."""
    needed = [name for name in OPTIONAL if re.search(rf"^(from|import) {name}\b", program, re.M)]
    needed += ["pygame"] * ("rgb_array" in program) + ["moviepy"] * ("RecordVideo" in program)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # their own, at import
        for name in needed:
            pytest.importorskip(name)
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    exec(compile(program, "<README>", "exec"), {"__name__": "__main__"})
    assert list(folder.iterdir()) == []


def test_the_first_program_flies_to_the_end(capsys: pytest.CaptureFixture[str]) -> None:
    """Every reader's first run: the expert must not crash in it."""
    exec(compile(PROGRAMS[0], "<README>", "exec"), {"__name__": "__main__"})
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
    pages = [ROOT / "train" / "README.template.md", ROOT / "train" / "README.md"]
    text = README + EXAMPLES + "".join(page.read_text(encoding="utf-8") for page in pages)
    heavy = [
        line for line in text.splitlines() if re.search(r"\[[\w,]*(train|ray|test)[\w,]*\]\"", line)
    ]
    assert len(heavy) > 5
    assert [line for line in heavy if "pip" in line and "-c constraints.txt" not in line] == []


def test_extras_named_here_exist() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    contributing = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = re.findall(r'"\.\[([\w,]+)\]"', README + contributing)
    extras = {extra for group in named for extra in group.split(",")}
    assert {"test", "dev"} <= extras <= set(project["optional-dependencies"])


@pytest.mark.parametrize(
    "document", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/examples.md"]
)
def test_links_lead_to_files(document: str) -> None:
    text = (ROOT / document).read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)#:]+)\)", text)
    assert [target for target in targets if not ((ROOT / document).parent / target).exists()] == []


def test_the_changelogs_duration_is_the_scenarios() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.findall(r"`nominal` lasts (\S+) s", text) == [f"{configure('nominal').duration:g}"]


def test_leaderboard_extract_has_its_place() -> None:
    begin, end = "<!-- leaderboard:begin -->", "<!-- leaderboard:end -->"
    assert README.count(begin) == README.count(end) == 1
    assert README.index(begin) < README.index(end)
