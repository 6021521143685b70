"""What disturbs the vehicles: the rows of `disturbances.DISTURBANCES`, each a loop over the worlds of a tile.

A row costs nothing in worlds in which it does not act, and numbers are drawn for those alone that want some.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from formation_env._jit import cold, device, step
from formation_env.core import arrays, flight
from formation_env.core.arrays import Counters
from formation_env.laws.world import World
from formation_env.maths.rng import Four
from formation_env.maths.so3 import Vector, add
from formation_env.memory.records import LANES, at, define, line_loader, size
from formation_env.memory.shuffles import carve, clear
from formation_env.memory.tiles import over_lanes
from formation_env.physics.disturbances import DISTURBANCES, Disturbance, Draws, States
from formation_env.physics.quadrotor import Body
from formation_env.physics.sensors import Measured

_TICK, _MEASURED = at(Counters, "tick") * LANES, size(Measured)
_PAIR, _WORDS = size(flight.Pair), size(flight.Pair) * LANES


@device
def _not_drawn(first: flight.Pair, second: flight.Pair) -> Four:
    return 0.0, 0.0, 0.0, 0.0


def _loop(one: Disturbance) -> Any:
    """The loop of a row: the state of a vehicle in this tick, and the row's push added to that of the others.

    Both stay what they are in worlds that are not active.
    """
    advance, push_of = one.advance, one.push
    normals = _not_drawn if one.draws is None else flight.in_order

    def disturb(
        push: Any, state: Any, body: Any, active: Any, tick: Any, first: Any, second: Any, own: Any
    ) -> Any:
        now = advance(state, body, own, tick, normals(first, second))
        return now, add(push, push_of(now, body, own))

    disturb.__name__ = f"disturb_by_{one.name}"
    disturb.__annotations__ = {
        "push": Vector,
        "state": one.state,
        "body": Body,
        "active": bool,
        "tick": int,
        "first": flight.Pair,
        "second": flight.Pair,
        "own": one.parameters,
        "return": tuple[one.state, Vector],  # type: ignore[name-defined]
    }
    return over_lanes(disturb, ("state", "push"), ("own",), keep="active", body=Measured)


def _row(one: Disturbance, world: Any, states: Any) -> Any:
    """What a row does to one vehicle; for the arguments see `over_table`."""
    acts, run, drawn = one.acts, _loop(one), one.draws is not None
    purpose, common = one.draws or Draws(0)
    given, numbers = at(world, "disturbances", one.name), size(one.parameters)
    begin, count = (_MEASURED + at(states, one.name)) * LANES, size(one.state) * LANES
    read = line_loader(one.parameters, given)

    @step
    def disturb(
        x: Any, push: Any, active: Any, ticks: Any, keys: Any, who: int, line: Any, draws: Any
    ) -> None:
        if acts(read(line)):
            first, second = carve(draws, 0, (_WORDS,)), carve(draws, _WORDS, (_WORDS,))
            if drawn:
                flight.draw_words(keys, ticks, purpose, 0 if common else who, 0, first, second)
                flight.make_normal(first, second, _PAIR)
            state, own = carve(x, begin, (count,)), carve(line, given, (numbers,))
            run(push, state, x, active, ticks, first, second, own)

    return disturb


def over_table(table: Sequence[Disturbance], world: Any, states: Any) -> Any:
    """The compiled function of all rows of a table in order, for one vehicle in all worlds of a tile.

    Its arguments are the rows of the vehicle, its push, which worlds are active, their ticks and the keys of
    their episodes, the vehicle's number, the line of a record of type `world` and room for random numbers.
    """
    arguments = "x, push, active, ticks, keys, who, line, draws"
    rows = {f"by_{one.name}": _row(one, world, states) for one in table}
    calls = "".join(f"    {row}({arguments})\n" for row in rows)
    source = f"def disturb_vehicle({arguments}):\n{calls}"
    return step(define("disturb_vehicle", source, rows))


disturb_vehicle = over_table(DISTURBANCES, World, States)


@cold
def disturb(memory: Any, room: Any, t: int) -> None:
    """What pushes the vehicles of the worlds that step from outside, held during this tick."""
    if arrays.vehicle_rows(memory) == _MEASURED:  # nothing acts
        return
    active, keys = arrays.active(room), arrays.episode_key(memory, t)
    ticks = carve(arrays.counters(memory, t), _TICK, (LANES,))
    line, draws = arrays.world(memory), arrays.draws(room)
    for i in range(arrays.vehicles(memory)):
        x, push = arrays.vehicle(memory, t, i), arrays.push(room, i)
        clear(push)
        disturb_vehicle(x, push, active, ticks, keys, i, line, draws)
