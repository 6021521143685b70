"""What a process pays before its first step, and whether it grows afterwards. Each in a fresh process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent

_FIRST_STEPS = """
import json, sys, time
begin = time.perf_counter()
import gymnasium as gym, numpy as np
import formation_env
seconds = {"import": time.perf_counter() - begin}
makers = {
    "gym.make": lambda: gym.make("Formation-v0"),
    "gym.make_vec": lambda: gym.make_vec("Formation-v0", num_envs=4096, threads=2),
}
for name in sys.argv[1:]:
    begin = time.perf_counter()
    env = makers[name]()
    env.reset(seed=0)
    env.step(np.zeros(env.action_space.shape, dtype=np.float32))
    seconds[name] = time.perf_counter() - begin
print(json.dumps(seconds))
"""

_MEMORY = """
import json, sys
from benchmarks.grid import Point, memory, task
scenario, followers, worlds, threads = sys.argv[1], *map(int, sys.argv[2:])
print(json.dumps(memory(task(Point(scenario, "wrench", followers, worlds)), worlds, threads)))
"""

_LONG = """
import json, sys
import gymnasium as gym, numpy as np
from benchmarks.grid import resident_bytes
env = gym.make("Formation-v0")
actions = np.random.default_rng(0).uniform(-0.02, 0.02, (64, 8)).astype(np.float32)
def go(steps):
    env.reset(seed=0)
    for k in range(steps):
        _, _, terminated, truncated, _ = env.step(actions[k % 64])
        if terminated or truncated:
            env.reset()
go(20_000)
before = resident_bytes()
go(int(sys.argv[1]))
print(json.dumps(resident_bytes() - before))
"""


def python(
    *arguments: str, path: Sequence[Path] = (ROOT,), cache: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run the interpreter in the first folder of `path`, importing from those; `cache` is Numba's folder.

    Raises `subprocess.CalledProcessError` if it fails.
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, path))}
    if cache is not None:
        environment["NUMBA_CACHE_DIR"] = str(cache)
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=path[0],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )


def printed(process: subprocess.CompletedProcess[str]) -> Any:
    """What the last line that a process printed holds as JSON."""
    return json.loads(process.stdout.splitlines()[-1])


def imported(repeats: int) -> float:
    """Seconds that `import formation_env` takes by `-X importtime`, the least of some repeats."""
    least = float("inf")
    for _ in range(repeats):
        report = python("-X", "importtime", "-c", "import formation_env").stderr
        lines = [line.split("|") for line in report.splitlines() if line.startswith("import time:")]
        total = next(int(row[1]) for row in lines if row[2].strip() == "formation_env")
        least = min(least, 1e-6 * total)
    return least


def until_first_step(*makers: str, cache: Path, root: Path = ROOT) -> dict[str, float]:
    """Seconds to the first step of `gym.make` or `gym.make_vec`, one after the other, in a fresh process
    of the checkout `root`, the import apart."""
    return dict(printed(python("-c", _FIRST_STEPS, *makers, path=[root], cache=cache)))


def first_steps() -> dict[str, Any]:
    """Seconds to the first step of `gym.make` and then of `make_vec`, with an empty and a full cache."""
    makers = ("gym.make", "gym.make_vec")
    with tempfile.TemporaryDirectory() as cache:
        cold = until_first_step(*makers, cache=Path(cache))
        warm = until_first_step(*makers, cache=Path(cache))
    return {"cold": cold, "warm": warm}


def growth(steps: int) -> int:
    """Bytes by which a process that steps `gym.make("Formation-v0")` so often grows after warming up."""
    return int(printed(python("-c", _LONG, str(steps))))


def memory(scenario: str, followers: int, worlds: int, threads: int) -> dict[str, float]:
    """`grid.memory` in a process that has no memory of its own left over to use again."""
    numbers = map(str, (followers, worlds, threads))
    return dict(printed(python("-c", _MEMORY, scenario, *numbers)))
