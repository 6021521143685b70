"""What a follower sees, what it is paid for, and when an episode has failed.

`Observation` is the layout: its fields, in order, are the entries of a follower's row, followed by those
that its action level adds and by `neighbours` times a `Neighbour`. `Layout` turns rows into names and back.
"""

from __future__ import annotations

from math import inf
from typing import Annotated, Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from formation_env._jit import device
from formation_env.laws.levels import LEVELS
from formation_env.laws.slots import in_frame
from formation_env.laws.world import ANYWHERE as ANYWHERE  # as `task.ANYWHERE` beside the entries
from formation_env.laws.world import NEAR as NEAR
from formation_env.laws.world import RATE_BOUND as RATE_BOUND
from formation_env.laws.world import UNIT as UNIT
from formation_env.laws.world import Action
from formation_env.maths.so3 import ZERO, Rotation, Vector, dot, pick, pick_vector, rotation, sub
from formation_env.memory.records import Quantity, fields, notes, size, slices
from formation_env.physics.sensors import Measured
from formation_env.validation.checks import Within, refuse

# How a follower's episode ended. LEADER: the leader crashed, for which no follower pays. UNSTARTED: the
# trigger (40) has not fired in time.
NO_FAILURE, COLLISION, IMPACT, LOST, LEADER, UNSTARTED = 0, 1, 2, 3, 4, 5
FAILURES = ("none", "collision", "impact", "lost", "leader", "unstarted")


class Observation(NamedTuple):
    """One follower's row, without what its level adds and its neighbours.

    {F} is the formation frame that it estimates.
    """

    slot_error: Annotated[
        Vector, Quantity("m", "{F}", "R^T(p_L - p) - d: (7) for the vehicle itself", NEAR, 0.3)
    ]
    relative_velocity: Annotated[
        Vector, Quantity("m/s", "{F}", "leader's velocity minus own", RATE_BOUND, 0.3)
    ]
    leader_velocity: Annotated[Vector, Quantity("m/s", "{F}", "leader's velocity", RATE_BOUND)]
    leader_acceleration: Annotated[
        Vector, Quantity("m/s^2", "{F}", "leader's acceleration", RATE_BOUND)
    ]
    body_x: Annotated[Vector, Quantity("1", "{F}", "first body axis r1", UNIT)]
    body_z: Annotated[
        Vector, Quantity("1", "{F}", "third body axis r3; thrust acts along -r3", UNIT, 0.2)
    ]
    angular_velocity: Annotated[Vector, Quantity("rad/s", "body", "omega", RATE_BOUND)]
    heading: Annotated[
        tuple[float, float],
        Quantity("1", "inertial", "cos and sin of the estimated theta (23)", UNIT),
    ]
    offset: Annotated[Vector, Quantity("m", "{F}", "d, where the leader should be seen", NEAR, 0.5)]
    previous_action: Annotated[
        Action, Quantity("1", "-", "last action as executed, padded with zeros", UNIT, 0.5)
    ]
    started: Annotated[float, Quantity("1", "-", "1 once the trigger (40) has fired", UNIT)]
    # So large that networks hardly see it: what to do does not depend on where in the world one flies.
    position: Annotated[
        Vector, Quantity("m", "inertial", "own measured position, north-east-down", ANYWHERE, 100.0)
    ]


class Neighbour(NamedTuple):
    """Another follower, nearest first; all zero where there is none."""

    neighbour_present: Annotated[float, Quantity("1", "-", "1 if there is such a neighbour", UNIT)]
    neighbour_position: Annotated[Vector, Quantity("m", "{F}", "its position minus own", NEAR)]
    neighbour_velocity: Annotated[
        Vector, Quantity("m/s", "{F}", "its velocity minus own", RATE_BOUND)
    ]


class Entry(NamedTuple):
    """One named part of an observation row."""

    name: str
    size: int
    bound: float
    unit: str
    frame: str
    meaning: str
    typical: float


def entries(kind: Any) -> tuple[Entry, ...]:
    """The entries that a record adds to an observation row; none of None."""
    if kind is None:
        return ()
    found = []
    for name, note in notes(kind).items():
        numbers = size(fields(kind)[name])
        found.append(
            Entry(name, numbers, note.bound, note.unit, note.frame, note.meaning, note.typical)
        )
    return tuple(found)


ENTRIES = entries(Observation)
NEIGHBOUR_ENTRIES = entries(Neighbour)


# A weight near the end of the floating-point range would make a reward that is not finite.
_WEIGHT, _LENGTH = Within(0.0, 1e6), Within(1e-6, 1e6, unit="m")


class Rewards(NamedTuple):
    """What things are worth, per control tick.

    Of a slot error `e` the closeness is `1/2 / (1 + (e / reach)^2) + 1/2 / (1 + (e / precision)^2)`, 1 where
    it is zero. `reach` is half the leader's distance in III-C and about what the start and the trigger (40)
    leave, so that a follower that has far to go learns which way; `precision` is what the paper's expert
    keeps where a flight is disturbed, so that centimetres count. Below a quarter of `precision` closeness
    exceeds 0.96, above three times `reach` it is below 0.06.
    """

    reach: Annotated[float, _LENGTH] = 0.3  # slot error at which the wide half is halved
    precision: Annotated[float, _LENGTH] = 0.05  # slot error at which the narrow half is
    waiting: Annotated[float, _WEIGHT] = (
        0.01  # of what closeness lacks of 1 before the trigger (40)
    )
    effort: Annotated[float, _WEIGHT] = 0.05  # weight of the mean squared action
    smoothness: Annotated[float, _WEIGHT] = 0.05  # weight of the mean squared change of action
    failure: Annotated[float, _WEIGHT] = 10.0  # paid once by every follower when one has failed


class Limits(NamedTuple):
    """Where an episode fails."""

    # Least distance between the centres of two vehicles: the paper's airframe measures so much.
    collision: Annotated[float, Within(0.0, NEAR, True, "m")] = 0.353
    impact: Annotated[float, Within(0.0, ANYWHERE, True, "m/s")] = 1.0  # fastest touch-down
    tilt: Annotated[float, Within(-1.0, 1.0)] = 0.5  # least r3 . k at touch-down
    lost: Annotated[float, Within(0.0, ANYWHERE, True, "m")] = 10.0  # largest slot error
    deadline: Annotated[float, Within(0.0, 1e9, True, "s")] = 15.0  # for the trigger (40) to fire


class Term(NamedTuple):
    """What annotates a term of the reward, for the manual."""

    meaning: str
    weights: str  # fields of `Rewards`, apart by spaces
    unit: str = ""  # of each


class Terms(NamedTuple):
    """The reward's parts, signed and weighted; their sum is the reward.

    A field added here, and to what `reward` returns, is summed, stored and reported on all faces.
    """

    formation: Annotated[
        float,
        Term(
            "after the trigger (40): `1/2 / (1 + (e / reach)^2) + 1/2 / (1 + (e / precision)^2)`, `e` "
            "the true distance to the slot",
            "reach precision",
            "m",
        ),
    ]
    waiting: Annotated[
        float, Term("before the trigger: `-w` times what that lacks of 1", "waiting")
    ]
    effort: Annotated[float, Term("`-w` times the mean squared action", "effort")]
    smoothness: Annotated[float, Term("`-w` times the mean squared change of action", "smoothness")]
    failure: Annotated[
        float,
        Term(
            "`-w` once, to every follower of a team of which one has failed; before the trigger also what "
            "waiting until the deadline can cost",
            "failure",
        ),
    ]


class Outcome(NamedTuple):
    """What a tick was for one follower: the columns of `results.Results.outputs`."""

    reward: float  # of this tick, the sum of its terms
    terms: Terms
    slot: Vector  # m, inertial
    slot_error: Vector  # m, inertial: slot minus true position
    separation: float  # m, distance to the nearest other vehicle
    failed: float  # an index into FAILURES


# Columns of `results.Results.outputs` by name.
COLUMNS = slices(Outcome)
REWARD, SEPARATION, FAILED = (COLUMNS[n].start for n in ("reward", "separation", "failed"))


@device
def observe(
    own: Measured,
    leader: Measured,
    anchor: Vector,
    R: complex,
    d: Vector,
    previous: Action,
    started: bool,
) -> Observation:
    """What a follower measures, in the frame of its estimated heading `R`.

    `anchor` is where the leader counts as being: its measured position, or the first reference point
    while it waits for the trigger (40).
    """
    attitude: Rotation = rotation(own.q)
    p_L = in_frame(R, sub(anchor, own.p))
    return Observation(
        sub(p_L, d),
        in_frame(R, sub(leader.v, own.v)),
        in_frame(R, leader.v),
        in_frame(R, leader.a),
        in_frame(R, attitude[0]),
        in_frame(R, attitude[2]),
        own.w,
        (R.real, R.imag),
        d,
        previous,
        1.0 if started else 0.0,
        own.p,
    )


class Passing(NamedTuple):
    """What one follower measures of another."""

    p: Vector  # m, inertial
    v: Vector  # m/s, inertial


@device
def observe_neighbour(own: Passing, other: Passing, R: complex, present: bool) -> Neighbour:
    """Another follower as this one measures it, in the frame of its estimated heading; zero without one."""
    return Neighbour(
        1.0 if present else 0.0,
        pick_vector(present, in_frame(R, sub(other.p, own.p)), ZERO),
        pick_vector(present, in_frame(R, sub(other.v, own.v)), ZERO),
    )


@device
def failure(
    separation: float,
    speed: float,
    uprightness: float,
    error: float,
    overdue: bool,
    limits: Limits,
) -> int:
    """How a follower failed in this tick, if it did; `overdue` where the trigger (40) is.

    Distances in m, `speed` of the hardest touch-down in m/s (0 in the air), its `uprightness` r3 . k.
    An error that is not a number counts as lost: the state has left what can be computed. An infinite `speed`
    is no crash: it says the same.
    """
    crashed = (speed > limits.impact) | ((speed > 0.0) & (uprightness < limits.tilt))
    crashed = crashed & (speed < inf)
    lost = not error <= limits.lost
    why = UNSTARTED if overdue else NO_FAILURE
    why = LOST if lost else why
    why = IMPACT if crashed else why
    return COLLISION if separation < limits.collision else why


@device
def closeness(error: float, weights: Rewards) -> float:
    """How near a slot error (m) is to none: `Rewards`; zero for one that is not a number."""
    x, y = error / weights.reach, error / weights.precision
    return max(0.0, 0.5 / (1.0 + x * x) + 0.5 / (1.0 + y * y))  # in this order 0 for NaN


@device
def reward(
    started: bool,
    left: float,
    error: float,
    action: Action,
    previous: Action,
    size: int,
    failed: bool,
    weights: Rewards,
) -> Terms:
    """The reward's terms for one follower and one tick.

        formation  = closeness                      once the trigger (40) has fired
        waiting    = -waiting (1 - closeness)       before, to the waiting place
        effort     = -effort |a|^2 / size           zero action is hovering flight
        smoothness = -smoothness |a - a_prev|^2 / size
        failure    = -failure - waiting left, once, where one of the team has failed

    So nothing is earned before the start, and in every scenario the whole wait until the deadline costs less
    than a failure.
    `left` are the ticks until the deadline, 0 after the start: who fails before it pays for them too, so that
    ending the wait by a crash gains nothing.
    `error` is the true slot error in m, `size` the number of entries an action has.
    """
    near = closeness(error, weights)
    b = (
        action[0] - previous[0],
        action[1] - previous[1],
        action[2] - previous[2],
        action[3] - previous[3],
    )
    return Terms(
        pick(started, near, 0.0),
        pick(started, 0.0, -weights.waiting * (1.0 - near)),
        -weights.effort * _square(action) / size,
        -weights.smoothness * _square(b) / size,
        -weights.failure - weights.waiting * left if failed else 0.0,
    )


@device
def _square(a: Action) -> float:
    return a[0] * a[0] + a[1] * a[1] + a[2] * a[2] + a[3] * a[3]


@device
def distance(a: Vector, b: Vector) -> float:
    """Distance between two points, m."""
    e = sub(a, b)
    return float(np.sqrt(dot(e, e)))


@final
class Layout:
    """Names for the entries of an observation row.

    `layout.slices["slot_error"]` is where an entry lies; `unpack` gives a dictionary of views on rows
    of any leading shape, `pack` the reverse. Neighbour entries are grouped: `neighbour_position` has
    shape `(..., neighbours, 3)`. `bound` and `typical` have what `Quantity` says of every number of a row.
    """

    version = 1

    def __init__(self, level: int, neighbours: int) -> None:
        self.neighbours = neighbours
        self.entries: tuple[Entry, ...] = (*ENTRIES, *entries(LEVELS[level].view))
        self.slices: dict[str, slice] = {}
        start = 0
        for entry in self.entries:
            self.slices[entry.name] = slice(start, start + entry.size)
            start += entry.size
        self.first_neighbour = start
        self.size = start + neighbours * size(Neighbour)
        each = (*self.entries, *NEIGHBOUR_ENTRIES * neighbours)
        sizes = [entry.size for entry in each]
        self.bound = np.repeat(np.array([entry.bound for entry in each], np.float32), sizes)
        self.typical = np.repeat(np.array([entry.typical for entry in each], np.float32), sizes)

    def unpack(self, rows: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Views on the named entries of `rows`, shape `(..., size)`; raises `ValueError` on another size."""
        if rows.shape[-1:] != (self.size,):
            raise ValueError(
                f"observation has shape {rows.shape}: expected (..., {self.size}) for this layout"
            )
        named = {name: rows[..., where] for name, where in self.slices.items()}
        tail = rows[..., self.first_neighbour :]
        tail = tail.reshape(*rows.shape[:-1], self.neighbours, size(Neighbour))
        start = 0
        for entry in NEIGHBOUR_ENTRIES:
            named[entry.name] = tail[..., start : start + entry.size]
            start += entry.size
        return named

    def pack(self, named: dict[str, NDArray[Any]]) -> NDArray[np.float32]:
        """Rows from named entries, the inverse of `unpack`; raises `ValueError` on wrong names."""
        wanted = {*self.slices, *(entry.name for entry in NEIGHBOUR_ENTRIES)}
        if set(named) != wanted:
            odd = sorted(map(str, set(named) ^ wanted))
            refuse("entries missing or unknown", odd, ", ".join(sorted(wanted)))
        leading = named["slot_error"].shape[:-1]
        parts = [np.asarray(named[entry.name]) for entry in self.entries]
        tail = [np.asarray(named[entry.name]) for entry in NEIGHBOUR_ENTRIES]
        neighbours = np.concatenate(tail, axis=-1).reshape(
            *leading, self.neighbours * size(Neighbour)
        )
        return np.concatenate([*parts, neighbours], axis=-1).astype(np.float32)
