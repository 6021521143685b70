"""The metrics of an episode.

A `Tally` gathers one episode per world tick by tick; `episodes` turns it into the columns of `EPISODE`.

Slot error, separation and distances are those of the true positions, in 3-D.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation_env import FormationConfig
from formation_env._jit import device, kernel
from formation_env.maths.so3 import Vector, dot, sub
from formation_env.memory.shuffles import clipped
from formation_env.task import COLUMNS, FAILED, FAILURES, SEPARATION, distance

Floats = NDArray[np.float64]

SLOT, ERROR = COLUMNS["slot"].start, COLUMNS["slot_error"].start

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
        "s", "lower", "when the trigger (40) fires after reset; 0 in scenarios that begin after it"
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

    reward_sum: Floats  # sum of rewards
    reward_since_trigger: (
        Floats  # sum of rewards since the trigger, or since the reset if it has not fired
    )
    ticks: NDArray[np.int64]  # flown
    trigger_tick: NDArray[np.int64]  # tick at which the trigger fired, or -1
    last_unsettled: NDArray[np.int64]  # last tick since then with a follower not within SETTLED
    failure: NDArray[np.int64]  # index into KINDS
    squared_errors: Floats  # m^2, sum over ticks of the followers' mean squared slot error
    error_ticks: NDArray[np.int64]  # ticks in that sum
    largest_error: Floats  # m
    steady_squared_errors: Floats  # m^2, the same sum over the second half of the time limit
    steady_ticks: NDArray[np.int64]  # ticks in that sum
    leader_deviation: Floats  # m, largest of a leader-follower distance from |d|
    follower_deviation: Floats  # m, largest of a follower-follower distance from that of the slots
    min_separation: Floats  # m, between two vehicles
    squared_actions: Floats  # sum over ticks of their mean square
    squared_changes: Floats  # sum over ticks of the mean squared change from the tick before


def begin(config: FormationConfig, started: NDArray[np.bool_]) -> Tally:
    """An empty tally; `started` `(worlds,)` says in which worlds the trigger has fired at reset."""
    worlds = len(started)
    floats = {name: np.zeros(worlds) for name in Tally._fields}
    counts = ("ticks", "last_unsettled", "failure", "error_ticks", "steady_ticks")
    whole = {name: np.zeros(worlds, dtype=np.int64) for name in counts}
    trigger = np.where(started, 0, -1).astype(np.int64)
    return Tally(
        **{**floats, **whole, "trigger_tick": trigger, "min_separation": np.full(worlds, np.inf)}
    )


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
    t.squared_errors[w] += mean
    t.error_ticks[w] += 1
    t.largest_error[w] = max(t.largest_error[w], largest)
    if largest > SETTLED:
        t.last_unsettled[w] = tick
    if steady:
        t.steady_squared_errors[w] += mean
        t.steady_ticks[w] += 1


@device
def _score_distances(t: Tally, w: int, leader: Vector, outputs: Any, offsets: Any) -> None:
    """Compare one world's distances with the nominal ones."""
    n = len(outputs)
    for i in range(n):
        d, slot = _at(offsets[i], 0), _at(outputs[i], SLOT)
        p = sub(slot, _at(outputs[i], ERROR))
        off = abs(distance(leader, p) - np.sqrt(dot(d, d)))
        t.leader_deviation[w] = max(t.leader_deviation[w], off)
        for j in range(i + 1, n):
            other = _at(outputs[j], SLOT)
            off = distance(p, sub(other, _at(outputs[j], ERROR))) - distance(slot, other)
            t.follower_deviation[w] = max(t.follower_deviation[w], abs(off))


@device
def _score_actions(t: Tally, w: int, actions: Any, before: Any) -> None:
    """Add effort and change of one world's actions, as executed."""
    n, size = actions.shape
    effort, change = 0.0, 0.0
    for i in range(n):
        for k in range(size):
            a = clipped(np.float64(actions[i, k]))
            b = clipped(np.float64(before[i, k]))
            effort += a * a
            change += (a - b) * (a - b)
    t.squared_actions[w] += effort / (n * size)
    t.squared_changes[w] += change / (n * size)


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
    rewards: Floats,
    terminated: NDArray[np.bool_],
    truncated: NDArray[np.bool_],
    actions: NDArray[np.float32],
    before: NDArray[np.float32],
    offsets: Floats,
) -> int:
    """Add tick number `tick` (from 1) of the worlds that are `live`; returns how many still are.

    `leaders` `(W, 3)` are the leaders' true positions in the second half of the time limit, empty
    before; the followers' are in `outputs`, `(W, n, len(OUTPUTS))`. `rewards`, `terminated` and `truncated`
    are `(W,)`. `actions` and those `before` are `(W, n, k)`, `offsets` the `d_i`, `(n, 3)`, m. `live` is
    changed: False where a world has ended.
    """
    living = 0
    for w in range(len(live)):
        if not live[w]:
            continue
        if t.trigger_tick[w] < 0 and started[w]:
            t.trigger_tick[w], t.last_unsettled[w] = tick, tick
            t.squared_errors[w], t.error_ticks[w], t.largest_error[w] = 0.0, 0, 0.0
            t.reward_since_trigger[w] = 0.0
        t.reward_sum[w] += rewards[w]
        t.reward_since_trigger[w] += rewards[w]
        t.ticks[w] += 1
        late = len(leaders) > 0
        _score_errors(t, w, tick, late, outputs[w])
        if late:
            _score_distances(t, w, _at(leaders[w], 0), outputs[w], offsets)
        for i in range(len(offsets)):
            t.min_separation[w] = min(t.min_separation[w], outputs[w, i, SEPARATION])
        _score_actions(t, w, actions[w], before[w])
        t.failure[w] = _failure(terminated[w], outputs[w])
        live[w] = not (terminated[w] or truncated[w])
        living += live[w]
    return living


def episodes(t: Tally, config: FormationConfig) -> dict[str, Floats]:
    """The columns of `EPISODE`, and `failure` (index into `KINDS`), `(worlds,)` each.

    NaN where an episode has no such value: it did not settle, it ended in the first half, there is one
    follower only.
    """
    failed = t.failure > 0
    period = config.control_period
    settled = (
        (t.trigger_tick >= 0) & ~failed & ((t.ticks - t.last_unsettled) * period >= HELD - 1e-9)
    )
    late = t.steady_ticks > 0
    pairs = late & (config.followers > 1)
    return {
        "return": t.reward_sum / config.max_steps,
        "reward_since_trigger": _where(
            t.trigger_tick >= 0, t.reward_since_trigger / np.maximum(t.error_ticks, 1)
        ),
        "slot_error_rms": np.sqrt(t.squared_errors / np.maximum(t.error_ticks, 1)),
        "slot_error_steady": _where(
            late, np.sqrt(t.steady_squared_errors / np.maximum(t.steady_ticks, 1))
        ),
        "slot_error_max": t.largest_error.copy(),
        "trigger_time": _where(t.trigger_tick >= 0, t.trigger_tick * period),
        "settled": settled.astype(np.float64),
        "settling_time": _where(settled, (t.last_unsettled - t.trigger_tick) * period),
        "leader_deviation": _where(late, t.leader_deviation),
        "follower_deviation": _where(pairs, t.follower_deviation),
        "min_separation": t.min_separation.copy(),
        "failed": failed.astype(np.float64),
        "effort": t.squared_actions / t.ticks,
        "smoothness": t.squared_changes / t.ticks,
        "failure": t.failure.astype(np.float64),
    }


def _where(measured: NDArray[np.bool_], values: NDArray[Any]) -> Floats:
    return np.where(measured, values, np.nan)
