"""What pushes a vehicle from outside: a table of disturbances, and their sum.

A disturbance is an acceleration held during a tick. It has parameters, which follow from the configuration,
a state per vehicle that is zero at the start of an episode, a law that moves the state on at the begin of
each tick and one that says how hard it then pushes. As the push is held, the bound that the floor's test
asks for (`turning.stays_up`) is its own size: a new row of the table needs nothing more.
"""

from __future__ import annotations

from math import exp, sqrt
from typing import Any, NamedTuple

from formation_env._jit import device
from formation_env.maths.rng import GUST, Four
from formation_env.maths.so3 import Vector
from formation_env.physics.quadrotor import Body


class Gusts(NamedTuple):
    """A random acceleration: a first-order Gauss-Markov process per vehicle and axis."""

    keep: float  # share kept from one tick to the next, exp(-period / correlation time)
    kick: float  # m/s^2, standard deviation of what is added


class Gust(NamedTuple):
    """The gust on one vehicle, held during a tick."""

    a: Vector  # m/s^2, inertial


@device
def blows(gusts: Gusts) -> bool:
    """Whether there are gusts at all."""
    return gusts.kick != 0.0


@device
def next_gust(before: Gust, body: Body, gusts: Gusts, tick: int, n: Four) -> Gust:
    """The next sample of the gust on a vehicle, of standard normal numbers: stationary after its start."""
    a = before.a
    return Gust(
        (
            gusts.keep * a[0] + gusts.kick * n[0],
            gusts.keep * a[1] + gusts.kick * n[1],
            gusts.keep * a[2] + gusts.kick * n[2],
        )
    )


@device
def gust_push(gust: Gust, body: Body, gusts: Gusts) -> Vector:
    """The acceleration by a gust, m/s^2, inertial."""
    return gust.a


def gusts_of(config: Any) -> Gusts:
    """The gusts of a configuration: `gust` is the standard deviation, whatever the control period."""
    keep = exp(-config.control_period / config.gust_time)
    return Gusts(keep, config.gust * sqrt(1.0 - keep * keep))


class Draws(NamedTuple):
    """Four standard normal numbers that a disturbance gets for each tick."""

    purpose: int  # of `rng`, for no other draw
    common: bool = False  # whether all vehicles of a world get the same ones, or each its own


class Disturbance(NamedTuple):
    """A row of the table."""

    name: str
    parameters: Any  # a record
    of: Any  # (configuration): its parameters
    state: Any  # a record, all zero at the start of an episode
    acts: Any  # (parameters): whether it does anything in this world
    draws: Draws | None  # None: no numbers are drawn, and `advance` gets zeros
    # (state, body, parameters, tick, normal numbers): the state in this tick, the first being 0.
    advance: Any
    push: Any  # (state, body, parameters): acceleration during this tick, m/s^2, inertial


DISTURBANCES = (
    # In the order in which their pushes are added.
    Disturbance("gusts", Gusts, gusts_of, Gust, blows, Draws(GUST), next_gust, gust_push),
)

# The parameters of all of them, a field of `world.World`, and their states on one vehicle.
Parameters: Any = NamedTuple("Parameters", [(one.name, one.parameters) for one in DISTURBANCES])  # type: ignore[misc]
States: Any = NamedTuple("States", [(one.name, one.state) for one in DISTURBANCES])  # type: ignore[misc]


def parameters(config: Any) -> Any:
    """The `Parameters` of a configuration."""
    return Parameters(*(one.of(config) for one in DISTURBANCES))
