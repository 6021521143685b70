"""What a first start does: compile, say so once, and keep the result for the next process."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

pytestmark = pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT", "0") != "0", reason="nothing is compiled"
)

SMALL = """
from formation_env._compiling import announced
from formation_env._jit import device, kernel

@device
def twice(x):
    return 2.0 * x

@announced("four times")
@kernel
def quadruple(x):
    return twice(twice(x))

@announced("eight times")
@kernel
def octuple(x):
    return 2.0 * quadruple(x)
"""
CALL = """
import gc
import small
before = gc.get_threshold()
assert small.octuple(1.0) == 8.0 and small.quadruple(1.0) == 4.0
assert gc.get_threshold() == before
stats = small.octuple.stats
print(sum(stats.cache_hits.values()), stats.cache_path)
"""


def run(program: str, *path: Path, **environment: str) -> tuple[list[str], str]:
    """Words on the standard output, and all of the standard error, of a fresh process."""
    inherited = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, "-B", "-c", program],
        env={**inherited, "PYTHONPATH": os.pathsep.join(map(str, path)), **environment},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split(), done.stderr


def test_compiling_is_announced_once_and_kept_for_the_next_process(tmp_path: Path) -> None:
    (tmp_path / "small.py").write_text(SMALL, encoding="utf-8")
    kept = tmp_path / "kept"
    (hits, folder), said = run(CALL, tmp_path, ROOT, NUMBA_CACHE_DIR=str(kept))
    assert hits == "0" and Path(folder).parent == kept
    assert said.count("formation_env: compiling") == 1 and folder in said
    (hits, _), said = run(CALL, tmp_path, ROOT, NUMBA_CACHE_DIR=str(kept))
    assert hits == "1" and said == ""


def test_a_change_in_another_folder_of_the_package_is_compiled_anew(tmp_path: Path) -> None:
    """A kernel in one folder links laws of others."""
    package = tmp_path / "formation_env"
    for folder in (package, package / "core", package / "laws"):
        folder.mkdir()
        (folder / "__init__.py").write_text("", encoding="utf-8")
    for source in (ROOT / "formation_env").glob("_[a-z]*.py"):
        shutil.copy(source, package)
    (package / "core" / "small.py").write_text(SMALL, encoding="utf-8")
    (package / "laws" / "law.py").write_text("", encoding="utf-8")
    # Without the folder that the tests run in, which is the checkout.
    call = "import sys\nsys.path.remove('')\n"
    call += CALL.replace("import small", "from formation_env.core import small")
    assert run(call, tmp_path)[0][0] == "0"
    assert run(call, tmp_path)[0][0] == "1"
    (package / "laws" / "law.py").write_text("GAIN = 1.0", encoding="utf-8")
    assert run(call, tmp_path)[0][0] == "0"


def test_a_change_in_a_law_is_compiled_anew(tmp_path: Path) -> None:
    """Numba itself would look at the kernel's file alone."""
    (tmp_path / "small.py").write_text(SMALL, encoding="utf-8")
    (tmp_path / "law.py").write_text("", encoding="utf-8")
    assert run(CALL, tmp_path, ROOT)[0][0] == "0"
    assert run(CALL, tmp_path, ROOT)[0][0] == "1"
    (tmp_path / "law.py").write_text("GAIN = 1.0", encoding="utf-8")
    assert run(CALL, tmp_path, ROOT)[0][0] == "0"


# Root may write everywhere, so Numba's attempt itself is made to fail.
READ_ONLY = """
import os, tempfile
attempt = tempfile.TemporaryFile
forbidden = os.environ["FORBIDDEN"].split(os.pathsep)
def refuse(*args, **options):
    if any(str(options.get("dir", "")).startswith(folder) for folder in forbidden):
        raise PermissionError("read-only")
    return attempt(*args, **options)
tempfile.TemporaryFile = refuse
"""


def test_a_read_only_installation_is_cached_in_the_users_folder(tmp_path: Path) -> None:
    code, home = tmp_path / "code", tmp_path / "home"
    code.mkdir()
    home.mkdir()
    (code / "small.py").write_text(SMALL, encoding="utf-8")
    settings = {"FORBIDDEN": str(code), "HOME": str(home), "LOCALAPPDATA": str(home)}
    settings["XDG_CACHE_HOME"] = str(home)
    (hits, folder), _ = run(READ_ONLY + CALL, code, ROOT, **settings)
    assert hits == "0" and home in Path(folder).parents
    (hits, _), said = run(READ_ONLY + CALL, code, ROOT, **settings)
    assert hits == "1" and said == ""


def test_with_no_folder_to_write_it_works_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "small.py").write_text(SMALL, encoding="utf-8")
    words, said = run(READ_ONLY + CALL, tmp_path, ROOT, FORBIDDEN=os.sep)
    assert words[0] == "0" and "NUMBA_CACHE_DIR" in said


def test_an_archive_of_the_package_works_without_a_cache(tmp_path: Path) -> None:
    (tmp_path / "formation_env").mkdir()
    (tmp_path / "formation_env" / "__init__.py").write_text("", encoding="utf-8")
    for source in (ROOT / "formation_env").glob("_[a-z]*.py"):
        shutil.copy(source, tmp_path / "formation_env")
    (tmp_path / "small.py").write_text(SMALL, encoding="utf-8")
    archive = Path(shutil.make_archive(str(tmp_path / "all"), "zip", tmp_path))
    # Without the folder that the tests run in, which is the checkout.
    words, _ = run("import sys\nsys.path.remove('')\n" + CALL, archive)
    assert words == ["0", "None"]
