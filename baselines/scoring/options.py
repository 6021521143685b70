"""The options of `baselines.evaluate`."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from baselines.files import SUFFIX
from baselines.registry import METHODS, POLICIES, is_policy, known_names
from baselines.scoring import tasks
from baselines.scoring.evaluation import EPISODES
from baselines.system.arguments import Parser, reader, seconds, whole
from formation_env import SCENARIOS
from formation_env.laws.levels import NAMES as LEVEL_NAMES
from formation_env.validation.checks import shown


def _read_scenario(text: str) -> str:
    """A scenario's name, perhaps with an action level after a colon."""
    tasks.check_scenario(text)
    return text


def _scenarios(text: str) -> list[str]:
    names = [name for name in text.replace(",", " ").split() if name]
    return list(dict.fromkeys(map(_read_scenario, names or [text])))


def read_policies(text: str) -> list[str]:
    """Names and paths; only commas divide them, since a path may have spaces."""
    names = [name for name in map(str.strip, text.split(",")) if name]
    for name in names or [text]:
        if not is_policy(name):
            raise ValueError(f"{shown(name)}: expected {known_names()}")
    return list(dict.fromkeys(names))


EXAMPLES = """\
your own controller, vehicle, path and gains:
  --policies expert,mypkg.mymodule:MyPolicy,path/to/file.py:MyPolicy
      classes called with the configuration; an object has reset(seed) and
      act(observation), see `python -c "help('baselines.own')"`
  --set noise.position=0.1 --set planner.k1=0.3
  --set vehicle.mass=0.12 --set vehicle.thrust_max=1.962
      a mass alone changes nothing: the default thrust follows it
  --set 'trajectory={"path": "circle", "radius": 2.0}'
  --config mine.json      the same fields as a JSON object; "scenario" in it
                          names the scenario that they change (nominal)
robustness against a field, the same episodes at each of its values:
  --sweep gust=0:2:9                   nine values from 0 to 2
  --sweep noise.position=0,0.1,0.2     those; several sweeps are combined
  --sweep measurement_delay=0:4:5 --plot pictures
                          the scores by value also as a picture
fields and units: `python -c "help('formation_env.config.FormationConfig')"`
"""


def parser() -> Parser:
    """The options of the command, none of them read yet."""
    own = Parser(
        "formation-evaluate",
        "Score policies on scenarios, on the same seeds for every policy.",
        EXAMPLES,
    )
    _add_what(own)
    _add_how(own)
    return own


def add_task(own: Parser) -> None:
    """Options that name one task: `--scenario`, `--action` and `--set`, as `settings`."""
    add = own.add_argument
    add("--scenario", type=reader(_read_scenario), default="nominal", metavar="NAME",
        help=f"Scenario to fly: {', '.join(SCENARIOS)}; NAME:LEVEL flies it at another action level. "
        "(default: %(default)s)")  # fmt: skip
    add("--action", choices=tuple(LEVEL_NAMES), metavar="LEVEL",
        help=f"Action level of a scenario that is named without one: {', '.join(LEVEL_NAMES)}. "
        "(default: the scenario's own)")  # fmt: skip
    add("--set", type=reader(tasks.read_setting), action="append", default=[], metavar="FIELD=VALUE",
        dest="settings", help="Set a field of the scenario, in SI units, or the number of followers; the "
        "value is JSON or a name; may be repeated. (default: the scenario's own values)")  # fmt: skip


def _add_what(own: Parser) -> None:
    """Options that decide what is flown."""
    add = own.add_argument
    add("--policies", type=reader(read_policies), default=argparse.SUPPRESS, metavar="NAMES",
        help=f"Policies to score, separated by commas: {', '.join(POLICIES)}; learned ones that are "
        f"shipped, {', '.join(METHODS)}; paths of *{SUFFIX} files; your own code as module:Name or "
        "file.py:Name. (default: all of these names that fly a chosen scenario)")  # fmt: skip
    add("--runs", type=Path, action="append", default=[], metavar="PATH",
        help="Policy file of a training run, or folder with such runs (every best.safetensors below it); the "
        "runs of one method are scored as one policy, where they were trained for a scenario and level "
        "instead of the file that ships: the median run with an interval over runs and episodes. May "
        "be repeated. (default: none)")  # fmt: skip
    add("--scenarios", type=reader(_scenarios), metavar="NAMES",
        help=f"Scenarios to fly, separated by commas: {', '.join(SCENARIOS)}; NAME:LEVEL flies one at "
        f"another action level, of {', '.join(LEVEL_NAMES)}. (default: all; with --leaderboard also nominal "
        "and paper at the other levels; with --config none)")  # fmt: skip
    add("--config", type=Path, action="append", default=[], metavar="FILE",
        help="JSON file with fields of a configuration, flown as a scenario of the file's name; may be "
        "repeated. (default: none)")  # fmt: skip
    add("--set", type=reader(tasks.read_setting), action="append", default=[], metavar="FIELD=VALUE",
        dest="settings", help="Set a field of every scenario, in SI units; the value is JSON or a "
        "name; may be repeated. (default: the scenarios' own values)")  # fmt: skip
    add("--sweep", type=reader(tasks.read_sweep), action="append", default=[],
        metavar="FIELD=VALUES", dest="sweeps",
        help="Fly every scenario once for each value of a field, in SI units, given as LOW:HIGH:COUNT or "
        "VALUE,VALUE,...; scores are shown by value. May be repeated: all values are combined, and the first "
        "field is shown against each combination of the others. (default: no sweep)")  # fmt: skip
    add("--episodes", type=whole(1, 1_000_000), default=EPISODES, metavar="N",
        help="Number of episodes of each policy on each scenario. (default: %(default)s)")  # fmt: skip
    add("--seed", type=whole(0, 2**32), default=0, metavar="N",
        help="Seed of a scenario's first episode; every further one has the next. "
        "(default: %(default)s)")  # fmt: skip
    add("--action", choices=tuple(LEVEL_NAMES), metavar="LEVEL",
        help=f"Action level of the scenarios that are named without one: {', '.join(LEVEL_NAMES)}. "
        "(default: the scenarios' own)")  # fmt: skip
    add("--duration", type=seconds, metavar="S",
        help="Length of an episode in seconds. (default: the scenarios' own)")  # fmt: skip


def _add_how(own: Parser) -> None:
    """Options that do not change a figure."""
    add, cores = own.add_argument, os.cpu_count() or 1
    add("--output", type=Path, default=Path("results"), metavar="DIR",
        help="Folder that the full report, results.md and results.json, is written to. "
        "(default: %(default)s)")  # fmt: skip
    add("--plot", type=Path, metavar="DIR",
        help="Folder that pictures are written to, as PNG and SVG: of each scenario the scores with their "
        "intervals, and the slot errors against time with their spread over episodes; of each sweep the "
        "scores by value. Needs Matplotlib (extra plot). (default: no pictures)")  # fmt: skip
    add("--matrix", type=Path, metavar="FILE",
        help="File that every episode's score, slot errors, failure and seconds to the start are written to, "
        "by method, training run, scenario and seed: compressed NumPy arrays, FILE.npz, read by "
        "baselines.scoring.suite. (default: not written)")  # fmt: skip
    add("--threads", type=whole(1, 1024), default=cores, metavar="N",
        help="Number of threads that fly episodes, or of cores of the cluster that --ray starts. "
        "(default: %(default)s, one for each core of this machine)")  # fmt: skip
    add("--ray", action="store_true",
        help="Share the episodes out over a Ray cluster, one of this machine's cores unless --address "
        "names another. (default: off)")  # fmt: skip
    add("--address", metavar="HOST:PORT",
        help="Address of a Ray cluster that runs already, HOST:PORT or auto; only with --ray. "
        "(default: a cluster of this machine's cores is started)")  # fmt: skip
    add("--leaderboard", type=Path, nargs="?", const=Path(), metavar="DIR",
        help="Also write LEADERBOARD.md, the README's extract of it and the pages in docs/board in the "
        "checkout DIR, or in the current folder where no DIR is given. (default: none)")  # fmt: skip
