"""Action levels: what a policy commands. A table, from which everything that lists levels derives.

At a direct level the entries of an action are asked of the actuators. At a guided level they move a virtual
vehicle, whose path the tracker of section III-B flies; it begins at the follower's slot, and the policy
sees it.
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

from formation_env._jit import device, step
from formation_env.laws.slots import Slot, in_frame, out_of_frame
from formation_env.laws.world import NEAR, RATE_BOUND, Action, Reach, World, follow
from formation_env.maths.so3 import Vector, add_scaled, pick_vector, sub
from formation_env.memory.records import Quantity, bounds, define, fields, loader, storer
from formation_env.memory.tiles import over_lanes
from formation_env.physics.quadrotor import MOMENT, RATES, Wrench, saturate
from formation_env.physics.sensors import Measured
from formation_env.trajectories import TrajectoryPoint

# -- direct levels ----------------------------------------------------------------------------------------


@device
def driven(action: Action, world: World) -> Wrench:
    """What an action in [-1, 1] asks of the actuators: a thrust and a moment, or an angular velocity."""
    r = world.reach
    turn = (r.turn[0] * action[1], r.turn[1] * action[2], r.turn[2] * action[3])
    return Wrench(0.5 * r.thrust * (action[0] + 1.0), turn)


@device
def wrench_action(wanted: Wrench, reach: Reach) -> Action:
    """The action of a direct level that asks for a thrust (N) and a turn (N m or rad/s, body).

    The inverse of `driven`; beyond [-1, 1] where the vehicle cannot do it.
    """
    turn, most = wanted.turn, reach.turn
    return (
        2.0 * wanted.thrust / reach.thrust - 1.0,
        turn[0] / most[0],
        turn[1] / most[1],
        turn[2] / most[2],
    )


@device
def drive(action: Action, world: World, actuation: int) -> Wrench:
    """What the actuators do of an action of a direct level."""
    return saturate(driven(action, world), actuation, world.airframe)


# -- guided levels ----------------------------------------------------------------------------------------


class Guide(NamedTuple):
    """The virtual follower of level `reference`: a point that the action accelerates."""

    p: Vector  # m, inertial
    v: Vector  # m/s, inertial


@device
def guide_at(slot: Slot) -> Guide:
    """A virtual follower at the start of an episode: at its slot, and as fast."""
    return Guide(slot.p, slot.v)


class Guided(NamedTuple):
    """A virtual follower and the frame that actions are in."""

    p: Vector
    v: Vector
    estimate: complex


class Estimate(NamedTuple):
    """A part of a follower's rows: the frame of what it observes."""

    estimate: complex


class GuideView(NamedTuple):
    """What a policy sees of a `Guide`."""

    guide_position: Annotated[
        Vector, Quantity("m", "{F}", "virtual follower's position minus own", NEAR, 0.3)
    ]
    guide_velocity: Annotated[
        Vector, Quantity("m/s", "{F}", "virtual follower's velocity minus own", RATE_BOUND, 0.3)
    ]


@device
def guided(action: Action, guide: Guide, R: complex, world: World) -> TrajectoryPoint:
    """The trajectory of a virtual follower that the action accelerates; no jerk, no snap.

    `R` is the heading that the follower estimates: the action is in its formation frame.
    """
    s = world.reach.acceleration
    a = out_of_frame(R, (s[0] * action[0], s[1] * action[1], s[2] * action[2]))
    return TrajectoryPoint(guide.p, guide.v, a, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


@device
def acceleration_action(wanted: Vector, reach: Reach) -> Vector:
    """The action of level `reference` that asks for an acceleration, m/s^2 in the formation frame.

    The inverse of what `guided` does; beyond [-1, 1] where it is more than can be asked for.
    """
    most = reach.acceleration
    return (wanted[0] / most[0], wanted[1] / most[1], wanted[2] / most[2])


@device
def guide_on(guide: Guide, a: Vector, h: float) -> Guide:
    """A virtual follower `h` seconds later at constant acceleration `a`, exactly."""
    p = add_scaled(add_scaled(guide.p, h, guide.v), 0.5 * h * h, a)
    return Guide(p, add_scaled(guide.v, h, a))


_load_measured = loader(Measured)


@device
def follow_own(lane: Any, ref: TrajectoryPoint, own: Any, world: World, actuation: int) -> Wrench:
    """`follow`, of a measurement in one lane of a tile."""
    return follow(ref, _load_measured(own, lane), world, actuation)


@device
def move_guide(
    lane: Any,
    x: Guided,
    moving: bool,
    action: Action,
    active: bool,
    own: Any,
    world: World,
    actuation: int,
) -> tuple[Guide, Wrench]:
    """A virtual follower a tick later, and the actuators of the vehicle that is flown along it.

    It moves on in worlds that are `active`; before the trigger (40), while not `moving`, the action does
    not accelerate it.
    """
    guide = Guide(x.p, x.v)
    m = 1.0 if moving else 0.0
    ref = guided((m * action[0], m * action[1], m * action[2], 0.0), guide, x.estimate, world)
    after = guide_on(guide, ref.a, world.clock.period)
    kept = Guide(pick_vector(active, after.p, x.p), pick_vector(active, after.v, x.v))
    return kept, follow_own(lane, ref, own, world, actuation)


@device
def view_guide(frame: Estimate, guide: Guide, own: Measured) -> GuideView:
    """The virtual follower relative to the vehicle that flies it, in the frame of the estimated heading."""
    R = frame.estimate
    return GuideView(in_frame(R, sub(guide.p, own.p)), in_frame(R, sub(guide.v, own.v)))


# -- the table --------------------------------------------------------------------------------------------


class Follower(NamedTuple):
    """What is kept of a follower's flight, beside its vehicle; after it the state of the level, if any."""

    heading: complex  # exp(j theta) of the slot, by the leader's true motion (23)
    estimate: complex  # the same by the measured motion: what the follower knows
    previous: Action  # the last action, as executed


class Level(NamedTuple):
    """A row of the table."""

    name: str
    size: int  # entries of an action
    entries: str  # what they are, and what they range over, for the manual
    range: str
    names: tuple[str, ...]  # of the entries, for plots
    actuation: int | None  # what turns a follower; None: `reference_actuation` of the configuration
    state: Any  # a record of the virtual vehicle, or None
    begin: Any  # (slot): that record at the start of an episode, or None
    view: Any  # a record of what a policy sees of it, or None
    decode: Any  # an action as a wrench; at a guided level as the trajectory's point
    encode: Any  # its inverse
    # Standard deviation of actions at the start of learning: about as far apart as differences matter.
    exploration: float
    # (follower, measurement, action, moving, active, world, actuation, command) of a tile
    command: Any
    show: Any  # (follower, measurement, rows of an observation) of a tile


def follower_layout(state: Any) -> Any:
    """The rows of a follower whose level keeps a record of type `state`."""
    own = {} if state is None else fields(state)
    return NamedTuple("FollowerRows", [*fields(Follower).items(), *own.items()])


_ROWS = follower_layout(Guide)
_drive = over_lanes(
    drive, into=("command",), uniform=("world",), static={"actuation": (MOMENT, RATES)}
)
_guide = over_lanes(
    move_guide,
    into=("x", "command"),
    uniform=("world",),
    static={"actuation": (MOMENT, RATES)},
    x=_ROWS,
)
_view_guide = over_lanes(
    view_guide, into=("rows",), bounds=bounds(GuideView), frame=_ROWS, guide=_ROWS
)


@step
def _command_wrench(
    x: Any, own: Any, action: Any, moving: Any, active: Any, world: Any, by: int, command: Any
) -> None:
    _drive(action, world, MOMENT, command)


@step
def _command_rates(
    x: Any, own: Any, action: Any, moving: Any, active: Any, world: Any, by: int, command: Any
) -> None:
    _drive(action, world, RATES, command)


@step
def _command_reference(
    x: Any, own: Any, action: Any, moving: Any, active: Any, world: Any, by: int, command: Any
) -> None:
    _guide(x, moving, action, active, own, world, by, command)


@step
def _show_guide(x: Any, own: Any, rows: Any) -> None:
    _view_guide(x, x, own, rows)


@step
def _show_nothing(x: Any, own: Any, rows: Any) -> None:
    pass


LEVELS = (
    Level(
        "wrench",
        4,
        "thrust along -r3 (N); moment about the body axes x, y, z (N m)",
        "thrust 0 ... `m g` ... `2 m g`; moment -+(0.05, 0.05, 0.02)",
        ("thrust", "moment about x", "moment about y", "moment about z"),
        MOMENT,
        None,
        None,
        None,
        driven,
        wrench_action,
        0.05,
        _command_wrench,
        _show_nothing,
    ),
    Level(
        "rates",
        4,
        "thrust (N); angular velocity about the body axes (rad/s) through a first-order lag of 0.05 s",
        "thrust as above; rates -+(10, 10, 5)",
        ("thrust", "rate about x", "rate about y", "rate about z"),
        RATES,
        None,
        None,
        None,
        driven,
        wrench_action,
        0.05,
        _command_rates,
        _show_nothing,
    ),
    Level(
        "reference",
        3,
        "acceleration of a virtual follower, formation frame {F} (m/s^2), that the paper's tracker flies",
        "-+(4, 4, 4)",
        ("acceleration forwards", "acceleration to the right", "acceleration downwards"),
        None,
        Guide,
        guide_at,
        GuideView,
        guided,
        acceleration_action,
        0.3,
        _command_reference,
        _show_guide,
    ),
)
NAMES = tuple(level.name for level in LEVELS)


def numbered(name: str) -> int:
    """The index of a level in the table."""
    return NAMES.index(name)


REFERENCE = numbered("reference")


def _by_level(name: str, arguments: str, functions: list[Any]) -> Any:
    """The compiled function that calls the one of a level."""
    lines = [f"def {name}(level, {arguments}):"]
    for k in range(len(functions) - 1):
        lines += [f"    if level == {k}:", f"        return function_{k}({arguments})"]
    lines.append(f"    return function_{len(functions) - 1}({arguments})")
    space = {f"function_{k}": one for k, one in enumerate(functions)}
    return step(define(name, "\n".join(lines) + "\n", space))


command_follower = _by_level(
    "command_follower",
    "x, own, action, moving, active, world, by, command",
    [level.command for level in LEVELS],
)
show_level = _by_level("show_level", "x, own, rows", [level.show for level in LEVELS])


def _begin(level: Level) -> Any:
    """`begin(x, lane, slot)`: the level's virtual vehicle at the start of an episode, in one lane."""
    if level.state is None:
        return _begin_nothing
    store = storer(level.state, follower_layout(level.state))
    at_slot = level.begin

    @step
    def begin(x: Any, lane: Any, slot: Slot) -> None:
        store(x, lane, at_slot(slot))

    return begin


@step
def _begin_nothing(x: Any, lane: Any, slot: Slot) -> None:
    pass


begin_level = _by_level("begin_level", "x, lane, slot", [_begin(level) for level in LEVELS])
