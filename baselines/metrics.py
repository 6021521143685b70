"""What an episode is judged by.

A `Tally` gathers one episode per world tick by tick; `episodes` turns it into the columns of `EPISODE`.

Slot error, separation and distances are those of the true positions, in 3-D.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation_env import FormationConfig
from formation_env._jit import device, kernel
from formation_env.memory import ERROR, FAILED, SEPARATION, SLOT
from formation_env.so3 import Vector, dot, sub
from formation_env.task import FAILURES, distance

Floats = NDArray[np.float64]

SETTLED = 0.15  # m, slot error below which a follower counts as settled: half the reward's scale
HELD = 1.0  # s, for at least so long before the end

KINDS = FAILURES  # the leader's own crash, which is no follower's, is one of them
LEADER = KINDS.index("leader")


class Metric(NamedTuple):
    """One column of the results."""

    unit: str
    better: str  # "higher" or "lower"
    meaning: str


EPISODE = {
    "return": Metric(
        "1",
        "higher",
        "sum of rewards over the episode's time limit in ticks; ticks after a failure count zero",
    ),
    "reward_since_trigger": Metric(
        "1",
        "higher",
        "mean reward per tick flown since the trigger (40), if it fires",
    ),
    "slot_error_rms": Metric(
        "m",
        "lower",
        "root mean square slot error over followers and ticks since the trigger (40), or over the "
        "whole episode if it never fires",
    ),
    "slot_error_steady": Metric("m", "lower", "the same over the second half of the time limit"),
    "slot_error_max": Metric("m", "lower", "largest slot error in the time of slot_error_rms"),
    "trigger_time": Metric(
        "s", "lower", "when the trigger (40) fires after reset; 0 where nobody waits for it"
    ),
    "settled": Metric(
        "1",
        "higher",
        f"1 if every follower stays within {SETTLED} m of its slot from some time after the trigger "
        f"to the end, for at least {HELD:g} s, without a failure; else 0",
    ),
    "settling_time": Metric("s", "lower", "how long after the trigger that time is; if settled"),
    "leader_deviation": Metric(
        "m",
        "lower",
        "largest deviation of a leader-follower distance from |d|, second half of the time limit",
    ),
    "follower_deviation": Metric(
        "m",
        "lower",
        "largest deviation of a follower-follower distance from that of their slots at the time, "
        "second half of the time limit; needs two followers",
    ),
    "min_separation": Metric("m", "higher", "least distance between two vehicles, any time"),
    "failed": Metric("1", "lower", "1 if the episode ended in a failure, else 0"),
    "effort": Metric("1", "lower", "mean squared action, over followers, entries and ticks flown"),
    "smoothness": Metric("1", "lower", "mean squared change of the action from tick to tick"),
}


class Tally(NamedTuple):
    """What has been gathered, `(worlds,)` each."""

    total: Floats  # sum of rewards
    earned: Floats  # sum of rewards since the trigger, or since the reset if it has not fired
    ticks: NDArray[np.int64]  # flown
    trigger: NDArray[np.int64]  # tick at which the trigger fired, or -1
    outside: NDArray[np.int64]  # last tick since then with a follower not within SETTLED
    failure: NDArray[np.int64]  # index into KINDS
    squares: Floats  # m^2, sum over ticks of the followers' mean squared slot error
    counted: NDArray[np.int64]  # ticks in it
    largest: Floats  # m
    steady: Floats  # m^2, as squares, second half
    steadied: NDArray[np.int64]  # ticks in it
    from_leader: Floats  # m, largest deviation
    between: Floats  # m, largest deviation
    separation: Floats  # m, least
    effort: Floats  # sum over ticks
    roughness: Floats  # sum over ticks


def begin(config: FormationConfig, started: NDArray[np.bool_]) -> Tally:
    """An empty tally of as many worlds as `started` says whether their trigger has fired at reset."""
    worlds = len(started)
    floats = {name: np.zeros(worlds) for name in Tally._fields}
    counts = ("ticks", "outside", "failure", "counted", "steadied")
    whole = {name: np.zeros(worlds, dtype=np.int64) for name in counts}
    trigger = np.where(started, 0, -1).astype(np.int64)
    return Tally(**{**floats, **whole, "trigger": trigger, "separation": np.full(worlds, np.inf)})


# -- one tick -------------------------------------------------------------------------------------


@device
def _at(x: Any, i: int) -> Vector:
    return (x[i], x[i + 1], x[i + 2])


@device
def _score_errors(t: Tally, w: int, tick: int, steady: bool, outputs: Any) -> None:
    """Add the slot errors of one world."""
    n = len(outputs)
    mean, largest = 0.0, 0.0
    for i in range(n):
        e = _at(outputs[i], ERROR)
        square = dot(e, e)
        mean += square / n
        largest = max(largest, square)
    largest = np.sqrt(largest)
    t.squares[w] += mean
    t.counted[w] += 1
    t.largest[w] = max(t.largest[w], largest)
    if largest > SETTLED:
        t.outside[w] = tick
    if steady:
        t.steady[w] += mean
        t.steadied[w] += 1


@device
def _score_distances(t: Tally, w: int, leader: Vector, outputs: Any, offsets: Any) -> None:
    """Compare one world's distances with the nominal ones."""
    n = len(outputs)
    for i in range(n):
        d, slot = _at(offsets[i], 0), _at(outputs[i], SLOT)
        p = sub(slot, _at(outputs[i], ERROR))
        off = abs(distance(leader, p) - np.sqrt(dot(d, d)))
        t.from_leader[w] = max(t.from_leader[w], off)
        for j in range(i + 1, n):
            other = _at(outputs[j], SLOT)
            off = distance(p, sub(other, _at(outputs[j], ERROR))) - distance(slot, other)
            t.between[w] = max(t.between[w], abs(off))


@device
def _score_actions(t: Tally, w: int, actions: Any, before: Any) -> None:
    """Add effort and change of one world's actions, as executed."""
    n, size = actions.shape
    effort, change = 0.0, 0.0
    for i in range(n):
        for k in range(size):
            a = min(max(np.float64(actions[i, k]), -1.0), 1.0)
            b = min(max(np.float64(before[i, k]), -1.0), 1.0)
            effort += a * a
            change += (a - b) * (a - b)
    t.effort[w] += effort / (n * size)
    t.roughness[w] += change / (n * size)


@device
def _failure(ended: bool, outputs: Any) -> int:
    """Index into KINDS: the first failed follower's, or the leader's."""
    for i in range(len(outputs)):
        if outputs[i, FAILED] > 0.0:
            return int(outputs[i, FAILED])
    return LEADER if ended else 0


@kernel
def add_tick(
    t: Tally,
    tick: int,
    live: NDArray[np.bool_],
    started: NDArray[np.bool_],
    leaders: Floats,
    outputs: Floats,
    ends: Floats,
    actions: NDArray[np.float32],
    before: NDArray[np.float32],
    offsets: Floats,
) -> int:
    """Add tick number `tick` (from 1) of the worlds that are `live`; returns how many still are.

    `leaders` `(W, 3)` are the leaders' true positions in the second half of the time limit, empty
    before; the followers' are in `outputs`, which with `ends` is as in `Results`. `actions` and those
    `before` `(W, n, k)`, `offsets` the `d_i`, `(n, 3)`. `live` is changed: ended worlds are out of it.
    """
    living = 0
    for w in range(len(live)):
        if not live[w]:
            continue
        reward, terminated, truncated = ends[0, w], ends[1, w] > 0.0, ends[2, w] > 0.0
        if t.trigger[w] < 0 and started[w]:
            t.trigger[w], t.outside[w] = tick, tick
            t.squares[w], t.counted[w], t.largest[w] = 0.0, 0, 0.0
            t.earned[w] = 0.0
        t.total[w] += reward
        t.earned[w] += reward
        t.ticks[w] += 1
        late = len(leaders) > 0
        _score_errors(t, w, tick, late, outputs[w])
        if late:
            _score_distances(t, w, _at(leaders[w], 0), outputs[w], offsets)
        for i in range(len(offsets)):
            t.separation[w] = min(t.separation[w], outputs[w, i, SEPARATION])
        _score_actions(t, w, actions[w], before[w])
        t.failure[w] = _failure(terminated, outputs[w])
        live[w] = not (terminated or truncated)
        living += live[w]
    return living


def episodes(t: Tally, config: FormationConfig) -> dict[str, Floats]:
    """The columns of `EPISODE`, and `failure` (index into `KINDS`), `(worlds,)` each.

    NaN where an episode has no such value: it did not settle, it ended in the first half, there is one
    follower only.
    """
    failed = t.failure > 0
    period = config.control_period
    settled = (t.trigger >= 0) & ~failed & ((t.ticks - t.outside) * period >= HELD - 1e-9)
    late = t.steadied > 0
    pairs = late & (config.followers > 1)
    return {
        "return": t.total / config.max_steps,
        "reward_since_trigger": _where(t.trigger >= 0, t.earned / np.maximum(t.counted, 1)),
        "slot_error_rms": np.sqrt(t.squares / np.maximum(t.counted, 1)),
        "slot_error_steady": _where(late, np.sqrt(t.steady / np.maximum(t.steadied, 1))),
        "slot_error_max": t.largest.copy(),
        "trigger_time": _where(t.trigger >= 0, t.trigger * period),
        "settled": settled.astype(np.float64),
        "settling_time": _where(settled, (t.outside - t.trigger) * period),
        "leader_deviation": _where(late, t.from_leader),
        "follower_deviation": _where(pairs, t.between),
        "min_separation": t.separation.copy(),
        "failed": failed.astype(np.float64),
        "effort": t.effort / t.ticks,
        "smoothness": t.roughness / t.ticks,
        "failure": t.failure.astype(np.float64),
    }


def _where(known: NDArray[np.bool_], values: NDArray[Any]) -> Floats:
    return np.where(known, values, np.nan)
