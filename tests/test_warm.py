"""`python -m formation_env.warm`: compiles everything once, keeps it, and says where."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from test_startup import READ_ONLY, SMALL

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

from formation_env import warm

ROOT = Path(__file__).resolve().parent.parent

pytestmark = pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT", "0") != "0", reason="nothing is compiled"
)

USE = """
def use():
    assert octuple(1.0) == 8.0
    assert quadruple(1.0) == 4.0
"""


def command(
    folder: Path, *words: str, before: str = "", **environment: str
) -> subprocess.CompletedProcess[str]:
    """The command in a fresh process that finds modules in `folder`, after the statements `before`."""
    inherited = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    run = "import runpy, sys; runpy.run_module('formation_env.warm', run_name='__main__')"
    path = os.pathsep.join(map(str, (folder, ROOT)))
    return subprocess.run(
        [sys.executable, "-B", "-c", f"{before}\n{run}", *words],
        env={**inherited, "PYTHONPATH": path, **environment},
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
    )


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A folder with a module that has two kernels."""
    (tmp_path / "small.py").write_text(SMALL + USE, encoding="utf-8")
    return tmp_path


def test_it_compiles_and_then_finds_that_all_is_there(small: Path) -> None:
    kept = str(small / "kept")
    first = command(small, "small:use", NUMBA_CACHE_DIR=kept)
    assert first.returncode == 0, first.stderr
    said = first.stdout.splitlines()
    assert said[0].startswith("compiled 2 of 2 kernels (")
    assert said[1:3] == ["  small.quadruple", "  small.octuple"]
    assert said[3].startswith("kept in ") and Path(said[3][8:]).parent == Path(kept)
    again = command(small, "small:use", NUMBA_CACHE_DIR=kept)
    assert again.returncode == 0 and again.stderr == ""
    assert again.stdout.startswith("all 2 kernels were there already (")
    assert kept in again.stdout


def test_what_it_kept_is_not_compiled_again(small: Path) -> None:
    kept = str(small / "kept")
    command(small, "small:use", NUMBA_CACHE_DIR=kept)
    code = "import small; small.use(); print(sum(small.octuple.stats.cache_misses.values()))"
    environment = {**os.environ, "NUMBA_CACHE_DIR": kept, "PYTHONPATH": str(ROOT)}
    run = [sys.executable, "-c", code]
    later = subprocess.run(run, cwd=small, env=environment, capture_output=True, text=True)
    assert (later.stdout, later.stderr) == ("0\n", "")


def test_several_at_once_do_not_disturb_one_another(small: Path) -> None:
    code = "import small; small.use()"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(small), "PYTHONPATH": str(ROOT)}
    runs = [
        subprocess.Popen([sys.executable, "-c", code], cwd=small, env=environment) for _ in range(3)
    ]
    assert [run.wait(120) for run in runs] == [0, 0, 0]
    later = command(small, "small:use", NUMBA_CACHE_DIR=str(small))
    assert later.stdout.startswith("all 2 kernels")


def test_nowhere_to_write_is_one_clear_message(small: Path) -> None:
    done = command(small, "small:use", before=READ_ONLY, FORBIDDEN=os.sep)
    assert done.returncode == 1 and done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: no folder to keep what is compiled in: ")
    assert "NUMBA_CACHE_DIR" in line


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("nothing:use", "nothing:use: No module named 'nothing'; expected module:function"),
        ("small:no", "small:no: module 'small' has no attribute 'no'; expected module:function"),
        ("small:__name__", "small:__name__: expected a function without arguments"),
        ("gc:collect", "gc:collect: no kernel was used"),
    ],
)
def test_a_wrong_name_is_one_clear_message(
    small: Path, monkeypatch: pytest.MonkeyPatch, word: str, said: str
) -> None:
    monkeypatch.syspath_prepend(str(small))
    monkeypatch.setattr(warm, "KERNELS", [])
    with pytest.raises(ValueError) as refused:  # noqa: PT011
        warm.warm([word])
    assert str(refused.value) == said


def test_without_a_compiler_there_is_nothing_to_do(small: Path) -> None:
    done = command(small, "small:use", NUMBA_DISABLE_JIT="1")
    assert done.returncode == 1
    assert done.stderr == "error: NUMBA_DISABLE_JIT is set: nothing is compiled\n"


# -- what is compiled -----------------------------------------------------------------------------


def test_installed_packages_add_theirs(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    about = small / "other-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[{warm.GROUP}]\nother = small:use\n")
    monkeypatch.syspath_prepend(str(small))
    found = warm._sources([])
    assert found[0] == warm.OWN and "small:use" in found
    assert warm._sources(["small:use"]) == ["small:use"]


def test_the_policies_are_declared() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    points = declared["project"]["entry-points"][warm.GROUP]
    assert points == {"baselines": "baselines.warm:use_kernels"}
    assert all(callable(warm._found(source)) for source in (warm.OWN, *points.values()))


# Every kernel has been used, and flights of every kind ask for no other types of arguments.
COMPLETE = """
import sys
import gymnasium as gym, numpy as np
from formation_env import warm
from formation_env._jit import KERNELS
from formation_env import SCENARIOS, formation_v0
import formation_env.vector
warm.use_kernels()
unused = [one.py_func.__name__ for one in KERNELS if not one.signatures]
assert not unused, unused
used = [len(one.signatures) for one in KERNELS]
for scenario in SCENARIOS:
    for action in ("wrench", "rates", "reference"):
        task = {"scenario": scenario, "action": action}
        parallel = formation_v0.parallel_env(**task)
        for env in (
            gym.make("Formation-v0", **task),
            gym.make_vec("Formation-v0", num_envs=2, **task),
            gym.make_vec("Formation-v0", num_envs=1024, threads=2, **task),
        ):
            env.reset(seed=0)
            for _ in range(2):
                env.step(np.zeros(env.action_space.shape, dtype=np.float32))
            env.close()
        observations, _ = parallel.reset(seed=0)
        parallel.step({a: np.zeros(parallel.action_space(a).shape, np.float32) for a in observations})
more = [one.py_func.__name__ for one, n in zip(KERNELS, used) if len(one.signatures) > n]
assert not more, more
"""

# The same for what `baselines.evaluate` does by default, and at every other action level.
POLICIES = """
import warnings
from formation_env._jit import KERNELS
from baselines import POLICIES, evaluate, warm
warm.use_kernels()
used = {one.py_func: len(one.signatures) for one in KERNELS}
warnings.simplefilter("ignore")
tasks = {level: {"scenario": "nominal", "action": level} for level in ("wrench", "rates", "reference")}
for level, task in tasks.items():
    tasks[level] = {**task, "duration": 0.1}
evaluate(list(POLICIES), tasks, episodes=40, quiet=True)
more = [k.py_func.__name__ for k in KERNELS if len(k.signatures) > used.get(k.py_func, 0)]
assert not more, more
"""


@pytest.mark.parametrize("program", [COMPLETE, POLICIES])
def test_nothing_is_left_to_compile_afterwards(program: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
