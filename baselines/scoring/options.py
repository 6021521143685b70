"""The options of `baselines.evaluate`."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from baselines.files import SUFFIX
from baselines.registry import METHODS, POLICIES, is_policy, known_names
from baselines.scoring import tasks
from baselines.scoring.evaluation import EPISODES
from baselines.system.arguments import Parser, formatter, reader, seconds, whole
from formation_env import SCENARIOS
from formation_env.checks import shown
from formation_env.config import LEVELS


def _scenarios(text: str) -> list[str]:
    names = [name for name in text.replace(",", " ").split() if name]
    for name in names or [text]:
        tasks.check_scenario(name)
    return list(dict.fromkeys(names))


def _policies(text: str) -> list[str]:
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
a table for each value:
  --sweep gust=0:2:9                   nine values from 0 to 2
  --sweep noise.position=0,0.1,0.2     those; several sweeps are combined
fields and units: `python -c "help('formation_env.config.FormationConfig')"`
"""


def parser() -> Parser:
    """The options of `baselines.evaluate`."""
    own = Parser(
        prog="formation-evaluate",
        description="Score policies on scenarios, on the same seeds for every policy.",
        epilog=EXAMPLES,
        formatter_class=formatter,
        allow_abbrev=False,
    )
    _add_what(own)
    _add_how(own)
    return own


def _add_what(own: Parser) -> None:
    """Options that decide what is flown."""
    add = own.add_argument
    add("--policies", type=reader(_policies), default=argparse.SUPPRESS, metavar="NAMES",
        help=f"comma-separated, of {', '.join(POLICIES)}; learned ones that are shipped: "
        f"{', '.join(METHODS)}; paths of your own *{SUFFIX} files; your own code as module:Name or "
        "file.py:Name (default: all that are shipped)")  # fmt: skip
    add("--scenarios", type=reader(_scenarios), metavar="NAMES",
        help=f"comma-separated, of {', '.join(SCENARIOS)}; NAME:LEVEL at another action level, "
        f"of {', '.join(LEVELS)} (default: all, with --leaderboard also those levels that policies are "
        "shipped for; with --config none)")  # fmt: skip
    add("--config", type=Path, action="append", default=[], metavar="FILE",
        help="JSON file with fields of a configuration, flown under its name; may be repeated")  # fmt: skip
    add("--set", type=reader(tasks.read_setting), action="append", default=[], metavar="FIELD=VALUE",
        dest="settings", help="set a field in every scenario, in SI units; the value is JSON or a "
        "name; may be repeated")  # fmt: skip
    add("--sweep", type=reader(tasks.read_sweep), action="append", default=[],
        metavar="FIELD=VALUES", dest="sweeps",
        help="fly every scenario once for each value, LOW:HIGH:COUNT or VALUE,VALUE,...")  # fmt: skip
    add("--episodes", type=whole(1, 1_000_000), default=EPISODES, metavar="N",
        help=f"for each scenario and policy (default: {EPISODES})")  # fmt: skip
    add("--seed", type=whole(0, 2**32), default=0, metavar="N",
        help="of the first episode (default: 0)")  # fmt: skip
    add("--action", choices=tuple(LEVELS), metavar="LEVEL",
        help=f"action level instead of the scenarios' own, one of {', '.join(LEVELS)}")  # fmt: skip
    add("--duration", type=seconds, metavar="S",
        help="episode length in seconds instead of the scenario's")  # fmt: skip


def _add_how(own: Parser) -> None:
    """Options that do not change a figure."""
    add, cores = own.add_argument, os.cpu_count() or 1
    add("--output", type=Path, default=Path("results"), metavar="DIR",
        help="folder for the full report, results.md and results.json (default: results)")  # fmt: skip
    add("--threads", type=whole(1, 1024), default=cores, metavar="N",
        help="threads that fly episodes (default: one for each core)")  # fmt: skip
    add("--ray", action="store_true",
        help="share the episodes out over a Ray cluster, by default one of this machine's cores")  # fmt: skip
    add("--address", metavar="HOST:PORT", help="with --ray: of a cluster that runs already")
    add("--leaderboard", type=Path, nargs="?", const=Path(), metavar="DIR",
        help="also write LEADERBOARD.md and README.md's extract of it in this checkout "
        "(by default the current folder)")  # fmt: skip
