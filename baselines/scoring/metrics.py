"""The metrics of an episode.

A `Tally` gathers one episode per world tick by tick; `episodes` turns it into the columns of `EPISODE`.

What is scored is the last `window_ticks` ticks of a flight, which begins with the trigger (40) and is
`flight_ticks` long: how the formation is kept, not how it was reached. Ticks that are missing, because
the episode failed or did not start in time, count as the worst. Evaluated episodes end with the flight. All
flights are as long, however long they waited, so neither a later start nor a later crash raises the score.

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

WINDOW = 25.0  # s before the end of the flight that are scored
LONGEST = 5.0 / 6.0  # of a shorter flight: as of 30 s, the start's transient is left out
WAIT = 1.0 / 3.0  # of an episode, most that is for the wait
CAP = 1.0  # m, at which a slot error counts at most, and that of a tick that is missing
SETTLED = (
    0.1  # m, slot error below which a follower counts as settled; starts in the air are farther off
)
HELD = 1.0  # s, for at least so long before the end

KINDS = FAILURES  # the leader's own crash, which is no follower's, is one of them
LEADER = KINDS.index("leader")


def deadline(config: FormationConfig) -> float:
    """Time after reset by which the trigger (40) has to fire, s; 0 where it has fired at reset."""
    return min(config.limits.deadline, config.duration) if config.start == "ground" else 0.0


def flight_ticks(config: FormationConfig) -> int:
    """Ticks from the trigger to the end of what is flown: those left after the longest wait.

    In an episode shorter than three times the deadline, a third of it is for the wait; who starts later lacks
    the ticks.
    """
    wait = min(deadline(config), WAIT * config.duration)
    return max(1, round((config.duration - wait) / config.control_period))


def window_ticks(config: FormationConfig) -> int:
    """How many of a flight's ticks are scored, the last: those of `WINDOW`, at most `LONGEST` of all."""
    return max(1, round(min(WINDOW / config.control_period, LONGEST * flight_ticks(config))))


def skipped_ticks(config: FormationConfig) -> int:
    """How many of a flight's ticks come before those that are scored."""
    return flight_ticks(config) - window_ticks(config)


class Metric(NamedTuple):
    """One column of the results."""

    unit: str
    better: str  # "higher" or "lower"
    meaning: str


EPISODE = {
    "score": Metric(
        "1",
        "higher",
        "mean over the window's ticks of the followers' mean reward, clipped to 0 ... 1; a tick that is "
        "missing, or on which the episode fails, counts 0",
    ),
    "slot_error": Metric(
        "m",
        "lower",
        "root mean square slot error over followers and the window's ticks, each error at most "
        f"{CAP:g} m; a tick that is missing, or on which the episode fails, counts {CAP:g} m",
    ),
    "slot_error_late": Metric("m", "lower", "the same over the second half of the window"),
    "failed": Metric("1", "lower", "1 if the episode ended in a failure, else 0"),
    "trigger_time": Metric(
        "s",
        "lower",
        "when the trigger (40) fires after reset, the deadline where it does not; 0 in scenarios that "
        "begin after it",
    ),
    "return": Metric(
        "1",
        "higher",
        "sum of the rewards until the flight ends",
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
        "largest deviation of a leader-follower distance from |d| in the window's second half, if it "
        "is reached",
    ),
    "follower_deviation": Metric(
        "m",
        "lower",
        "largest deviation of a follower-follower distance from that of their slots at the time, in the "
        "window's second half, if it is reached; needs two followers",
    ),
    "min_separation": Metric("m", "higher", "least distance between two vehicles, any time"),
    "effort": Metric("1", "lower", "mean squared action, over followers, entries and ticks flown"),
    "smoothness": Metric("1", "lower", "mean squared change of the action from tick to tick"),
}


class Tally(NamedTuple):
    """What has been gathered, `(worlds,)` each."""

    reward_sum: Floats  # sum of rewards
    ticks: NDArray[np.int64]  # flown
    trigger_tick: NDArray[np.int64]  # tick at which the trigger fired, or -1
    last_unsettled: NDArray[np.int64]  # last tick since then with a follower not within SETTLED
    failure: NDArray[np.int64]  # index into KINDS
    score: Floats  # sum over the window's ticks of the clipped mean reward
    squared_errors: Floats  # m^2, over them, of the followers' mean squared slot error below CAP
    window_ticks: NDArray[np.int64]  # number of these ticks, without that of a failure
    late_squared_errors: Floats  # m^2, the same sum over the window's second half
    late_ticks: NDArray[np.int64]  # number of its ticks
    leader_deviation: Floats  # m, largest of a leader-follower distance from |d|
    follower_deviation: Floats  # m, largest of a follower-follower distance from that of the slots
    min_separation: Floats  # m, between two vehicles
    squared_actions: Floats  # sum over ticks of their mean square
    squared_changes: Floats  # sum over ticks of the mean squared change from the tick before


_COUNTS = ("ticks", "last_unsettled", "failure", "window_ticks", "late_ticks")


def begin(started: NDArray[np.bool_]) -> Tally:
    """An empty tally; `started` `(worlds,)` says in which worlds the trigger has fired at reset."""
    worlds = len(started)
    floats = {name: np.zeros(worlds) for name in Tally._fields}
    whole = {name: np.zeros(worlds, dtype=np.int64) for name in _COUNTS}
    trigger = np.where(started, 0, -1).astype(np.int64)
    return Tally(
        **{**floats, **whole, "trigger_tick": trigger, "min_separation": np.full(worlds, np.inf)}
    )


# -- one tick -------------------------------------------------------------------------------------


@device
def _at(x: Any, i: int) -> Vector:
    return (x[i], x[i + 1], x[i + 2])


@device
def _score_window(t: Tally, w: int, late: bool, reward: float, outputs: Any) -> None:
    """Add reward and slot errors of one of the window's ticks."""
    n = len(outputs)
    mean = 0.0
    for i in range(n):
        e = _at(outputs[i], ERROR)
        square = dot(e, e)
        mean += (square if square < CAP * CAP else CAP * CAP) / n  # in this order CAP for NaN
    t.score[w] += min(max(reward, 0.0), 1.0)
    t.squared_errors[w] += mean
    t.window_ticks[w] += 1
    if late:
        t.late_squared_errors[w] += mean
        t.late_ticks[w] += 1


@device
def _unsettled(outputs: Any) -> bool:
    """Whether a follower is not within `SETTLED` of its slot."""
    for i in range(len(outputs)):
        e = _at(outputs[i], ERROR)
        if not np.sqrt(dot(e, e)) <= SETTLED:
            return True
    return False


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
    skipped: int,
    window: int,
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

    The `window` ticks after those of the flight that are `skipped` are scored. `leaders` `(W, 3)` are the
    leaders' true positions, m; the followers' are in `outputs`, `(W, n, len(OUTPUTS))`. `rewards`,
    `terminated` and `truncated` are `(W,)`. `actions` and those `before` are `(W, n, k)`, `offsets` the
    `d_i`, `(n, 3)`, m. `live` is changed: False where a world or its flight has ended.
    """
    living = 0
    for w in range(len(live)):
        if not live[w]:
            continue
        begun = t.trigger_tick[w] >= 0  # before this tick
        if t.trigger_tick[w] < 0 and started[w]:
            t.trigger_tick[w] = tick
        t.failure[w] = _failure(terminated[w], outputs[w])
        t.reward_sum[w] += rewards[w]
        t.ticks[w] += 1
        if _unsettled(outputs[w]):
            t.last_unsettled[w] = tick
        number = tick - t.trigger_tick[w] - skipped  # among the window's ticks, from 1
        if 0 < number <= window and begun and t.failure[w] == 0:
            late = 2 * number > window
            _score_window(t, w, late, rewards[w], outputs[w])
            if late:
                _score_distances(t, w, _at(leaders[w], 0), outputs[w], offsets)
        for i in range(len(offsets)):
            t.min_separation[w] = min(t.min_separation[w], outputs[w, i, SEPARATION])
        _score_actions(t, w, actions[w], before[w])
        live[w] = not (terminated[w] or truncated[w] or (begun and number >= window))
        living += live[w]
    return living


def episodes(t: Tally, config: FormationConfig) -> dict[str, Floats]:
    """The columns of `EPISODE`, and `failure` (index into `KINDS`), `(worlds,)` each.

    NaN where an episode has no such value: it did not settle, it ended before the second half of the
    window, there is one follower only.
    """
    failed, started = t.failure > 0, t.trigger_tick >= 0
    period, window = config.control_period, window_ticks(config)
    unsettled = np.maximum(t.last_unsettled, t.trigger_tick)
    settled = started & ~failed & ((t.ticks - unsettled) * period >= HELD - 1e-9)
    late = t.late_ticks > 0
    pairs = late & (config.followers > 1)
    # Of W ticks those with number k, 2 k > W, are late.
    missing, late_window = window - t.window_ticks, window - window // 2
    late_missing = late_window - t.late_ticks
    return {
        "score": t.score / window,
        "slot_error": np.sqrt((t.squared_errors + missing * CAP**2) / window),
        "slot_error_late": np.sqrt((t.late_squared_errors + late_missing * CAP**2) / late_window),
        "failed": failed.astype(np.float64),
        "trigger_time": np.where(started, t.trigger_tick * period, deadline(config)),
        "return": t.reward_sum.copy(),
        "settled": settled.astype(np.float64),
        "settling_time": _where(settled, (unsettled - t.trigger_tick) * period),
        "leader_deviation": _where(late, t.leader_deviation),
        "follower_deviation": _where(pairs, t.follower_deviation),
        "min_separation": t.min_separation.copy(),
        "effort": t.squared_actions / t.ticks,
        "smoothness": t.squared_changes / t.ticks,
        "failure": t.failure.astype(np.float64),
    }


def _where(measured: NDArray[np.bool_], values: NDArray[Any]) -> Floats:
    return np.where(measured, values, np.nan)
