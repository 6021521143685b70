"""Write `docs/trained.md`: `python -m train.cards`. Needs a checkout, and the `plot` extra for the pictures.

Its text is `train/trained.template.md`; its tables and pictures come from what is checked in: the
learning curves in `train/curves/` and the policies in `baselines/policies/`. With the same versions the same
files give the same bytes. What is checked in comes from

    python -m train.cards --ship runs/x-*        of some training runs the policy whose score on seeds 0-99
                                                 is the median, and all curves
    python -m train.cards --curve runs/y runs/z  the curves alone, of other seeds or of what failed
    python -m train.cards --generalise           the policies of `nominal` on tasks they have not seen

after which `python -m train.cards` writes the page anew.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NoReturn, final

from baselines.reporting.cells import scored, signed
from baselines.scoring.evaluation import EPISODES
from baselines.system import console
from baselines.system.writing import write_text
from train.cards import guide, shipping

PROGRAM = "train.cards"
_CHECKOUT = Path(__file__).resolve().parents[2]


@final
class _Parser(argparse.ArgumentParser):
    """Prints a wrong option as one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message}\n")


def _threads(text: str) -> int:
    if not (text.isascii() and text.isdigit() and 1 <= int(text) <= 1024):
        raise argparse.ArgumentTypeError(f"{text!r}: expected a whole number from 1 to 1024")
    return int(text)


def _method(text: str) -> str:
    if not (text.isascii() and text.replace("-", "").isalnum() and text[0].isalnum()):
        raise argparse.ArgumentTypeError(f"{text!r}: expected letters, digits and hyphens")
    return text


def parser() -> _Parser:
    """The options of the command."""
    options = _Parser(
        prog=PROGRAM,
        description="Write docs/trained.md and its pictures from what is checked in, or check in a "
        "run. Needs a checkout, and the plot extra for the pictures.",
        allow_abbrev=False,
    )
    what = options.add_mutually_exclusive_group()
    what.add_argument(
        "--ship",
        type=Path,
        nargs="+",
        metavar="RUN",
        help="Folders of the training runs of one method and task: the policy with the median score on "
        "seeds 0 to 99 is checked in, and the learning curves of all. (default: none)",
    )
    what.add_argument(
        "--curve",
        type=Path,
        nargs="+",
        metavar="RUN",
        help="Folders of runs whose learning curves are checked in. (default: none)",
    )
    what.add_argument(
        "--generalise",
        action="store_true",
        help="Score the policies of nominal on tasks that they were not trained on, which takes "
        "minutes. (default: off)",
    )
    add = options.add_argument
    add(
        "--method",
        type=_method,
        help="Name of the method, with --ship or --curve. (default: the one in the policy's card)",
    )
    add("--threads", type=_threads, default=os.cpu_count() or 1, metavar="N",
        help="Number of threads that fly episodes. "
        "(default: %(default)s, one for each core)")  # fmt: skip
    add("--checkout", type=Path, default=argparse.SUPPRESS, metavar="DIR",
        help="Folder of the checkout that is changed. "
        "(default: the one this command comes from)")  # fmt: skip
    return options


@console.command
def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit status, or raises `SystemExit(2)` for a wrong option."""
    reader = parser()
    options = reader.parse_args(arguments, argparse.Namespace(checkout=_CHECKOUT))
    try:
        if options.method and not (options.ship or options.curve):
            raise ValueError("argument --method: only with --ship or --curve")
        _require_checkout(options.checkout)
        return _do(options)
    except ValueError as problem:
        reader.error(str(problem))
    except OSError as problem:
        where = f"{problem.filename}: " if problem.filename else ""
        reason = problem.strerror or problem
        print(f"{PROGRAM}: error: {where}{reason}; earlier files are intact", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted: earlier files are intact", file=sys.stderr)
        return 130


def _require_checkout(folder: Path) -> None:
    if not (folder / guide.TEMPLATE).is_file():
        raise ValueError(f"{folder}: no {guide.TEMPLATE}: expected a checkout; see --checkout")


def _do(options: argparse.Namespace) -> int:
    """Carry out one of --ship, --curve, --generalise, or write the page; the exit status."""
    checkout: Path = options.checkout
    if options.ship:
        return _ship(options.ship, options.method, checkout, options.threads)
    if options.curve:
        runs = [shipping.open_run(folder, options.method) for folder in options.curve]
        return _written(shipping.keep_curve(run.curve, checkout) for run in runs)
    if options.generalise:
        rows = shipping.transfers(checkout, options.threads)
        path = checkout / shipping.GENERALISATION
        path.parent.mkdir(exist_ok=True)
        write_text(path, shipping.transfers_text(rows))
        return _written([path])
    return _page(checkout)


def _ship(
    folders: Sequence[Path],
    method: str | None,
    checkout: Path,
    threads: int,
    episodes: int = EPISODES,
) -> int:
    """Score the policies of runs and check in the median one, with all curves."""
    runs = [shipping.open_run(folder, method) for folder in folders]
    shipping.require_shippable(runs)
    median, result = shipping.scored(runs, episodes, threads)
    print(f"score {scored(result.score)} of {folders[runs.index(median)]}, minus the expert's "
          f"{signed(result.differences['expert']['score'])}, failures {result.failures}")  # fmt: skip
    paths = shipping.ship(median, result.score, checkout)
    others = [shipping.keep_curve(run.curve, checkout) for run in runs if run is not median]
    return _written([*paths, *others])


def _page(checkout: Path) -> int:
    """Write the page and its pictures."""
    if importlib.util.find_spec("matplotlib") is None:
        raise ValueError('matplotlib is not installed: pip install "formation-env[plot]"')
    from train.cards.pictures import draw

    facts = guide.gather(checkout)
    text = guide.page(facts)
    paths = []
    for name, curves in guide.pictures(facts.curves).items():
        paths.append(checkout / shipping.CURVES / name)
        key = curves[0].key
        draw(curves, facts.board.get((key.scenario, key.action), {}), paths[-1])
    (checkout / guide.PAGE).parent.mkdir(exist_ok=True)
    write_text(checkout / guide.PAGE, text)
    for name in facts.stale:
        print(f"{name}: not in the table of generalisation; run --generalise", file=sys.stderr)
    return _written([*paths, checkout / guide.PAGE])


def _written(paths: Iterable[Path]) -> int:
    for path in paths:
        print(f"written: {path}")
    return 0
