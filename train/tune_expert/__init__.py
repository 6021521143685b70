"""Find gains for a law: `python -m train.tune_expert --scenario paper`, `... --policy lee`.

CMA-ES (pycma) searches the gains of the paper's planner and tracker, or of a textbook's law, for the
largest mean score over training seeds, the same ones for every candidate. It starts from the plain gains,
and every candidate satisfies the law's conditions (`train.tune_expert.gain_space`, `loop_space`). Whatever
the law, it has as many candidates. Those with the largest scores, and the plain gains, then fly validation
seeds, and the best of those is the result. The leaderboard's seeds are not used. All of this is flown on the
task with a margin (`train.margin`), unless `--no-margin`; the result is reported on the task as it is, too.

Results do not depend on the number of threads, and the same options give the same gains. The journal,
`OUTPUT/SCENARIO-ACTION.json`, has the scores so far; after an interruption `--resume` repeats the search
from it, without flying those candidates again.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from typing import NoReturn

from baselines.system import console
from train.command_line import SCRIPTS, read_options

SCRIPT = SCRIPTS[__name__]


def _refuse(message: object) -> NoReturn:
    print(f"{SCRIPT}: error: {message}", file=sys.stderr)
    raise SystemExit(2)


@console.command
def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit status, or raises `SystemExit(2)` for a wrong option."""
    try:
        import cma  # noqa: F401  # needed only after compiling, where its absence would be told late
        import tyro  # noqa: F401
    except ImportError as problem:
        _refuse(f'{problem.name} is missing: pip install "formation-env[train]"')
    from train.tune_expert.options import Options
    from train.tune_expert.tuning import tune

    options = read_options(Options, SCRIPT, arguments)
    try:
        best = tune(options)
    except ValueError as problem:
        _refuse(problem)
    except OSError as problem:
        print(f"{SCRIPT}: error: {problem}; earlier files are kept", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted: --resume goes on where the journal ends", file=sys.stderr)
        return 130
    score, gain = best.result.score, best.result.differences["expert"]["score"]
    console.say(
        f"score {score.value:.3f} ({score.low:.3f} .. {score.high:.3f}) on validation seeds, "
    )
    console.say(
        f"score {gain.value:+.4f} ({gain.low:+.4f} .. {gain.high:+.4f}) beside the expert's"
    )
    if best.flown is not best.result:
        with_margin = best.flown.score
        console.say(
            f"score {with_margin.value:.3f} ({with_margin.low:.3f} .. {with_margin.high:.3f}) with the margin"
        )
    console.say(json.dumps(options.tunable.document(best.gains), indent=1))
    return 0
