"""The floor's bound: where it says that a vehicle stays up it does, and little more is asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from numba import config as numba_config
from states import PARTS, begun, line, still, tile, unchecked, vehicles

from formation_env import Vehicle, configure
from formation_env.core import flight, kernels
from formation_env.core.arrays import rows
from formation_env.core.simulation import Simulation
from formation_env.laws.world import Clock
from formation_env.memory.records import LANES
from formation_env.physics.quadrotor import GRAVITY, MOMENT, RATES, Airframe, Wrench
from formation_env.physics.sensors import Measured
from formation_env.physics.turning import turning

Floats = npt.NDArray[np.float64]
Named = dict[str, Floats]
PERIOD = 0.02


# -- an oracle: Runge and Kutta on arrays, which notes the fastest turn and the largest r3z of its stages ---


def product(q: Floats, w: Floats) -> Floats:
    """`q (0, w) / 2`."""
    a, (x, y, z) = q[0], q[1:]
    return 0.5 * np.array(
        [
            -x * w[0] - y * w[1] - z * w[2],
            a * w[0] + y * w[2] - z * w[1],
            a * w[1] + z * w[0] - x * w[2],
            a * w[2] + x * w[1] - y * w[0],
        ]
    )


class Flight:
    """States and commands by name, gusts `(3, LANES)`: flown by substeps."""

    def __init__(self, x: Named, command: Named, push: Floats, frame: Any, actuation: int) -> None:
        self.x, self.command, self.push = copied(x), command, push
        self.frame, self.actuation = frame, actuation
        self.fastest, self.tilt = np.zeros(LANES), np.zeros(LANES)

    def rates(self, y: tuple[Floats, ...]) -> tuple[Floats, ...]:
        _, v, q, w = y
        J = np.array(self.frame.inertia)[:, None]
        r3 = np.array(
            [
                2 * (q[1] * q[3] + q[0] * q[2]),
                2 * (q[2] * q[3] - q[0] * q[1]),
                1 - 2 * (q[1] ** 2 + q[2] ** 2),
            ]
        )
        a = self.push - self.command["thrust"] / self.frame.mass * r3
        a[2] += GRAVITY
        self.turned = np.linalg.norm(w, axis=0)
        self.tilt = np.maximum(self.tilt, np.abs(r3[2]))
        if self.actuation == MOMENT:
            turn = (self.command["turn"] - np.cross(w, J * w, axis=0)) / J
        else:
            turn = (self.command["turn"] - w) / self.frame.rate_lag
        return v, a, product(q, w), turn

    def substep(self, h: float) -> Floats:
        """Fly one; the heights after it."""
        y = tuple(self.x[part].copy() for part in PARTS)

        def ahead(step: float, k: tuple[Floats, ...]) -> tuple[Floats, ...]:
            return tuple(a + step * b for a, b in zip(y, k, strict=True))

        a = self.rates(y)
        self.fastest = np.maximum(self.fastest, self.turned)
        b = self.rates(ahead(h / 2, a))
        self.fastest = np.maximum(self.fastest, self.turned)
        c = self.rates(ahead(h / 2, b))
        self.fastest = np.maximum(self.fastest, self.turned)  # the last stage's turns nothing
        d = self.rates(ahead(h, c))
        for part, old, *k in zip(PARTS, y, a, b, c, d, strict=True):
            self.x[part] = old + h / 6 * (k[0] + 2 * k[1] + 2 * k[2] + k[3])
        self.x["q"] /= np.linalg.norm(self.x["q"], axis=0)
        return np.array(self.x["p"][2])


def grounded() -> tuple[Named, Named, Floats]:
    """At rest, level and in the origin; no command; no gust."""
    x = rows(tile(Measured), Measured)
    x["q"][0] = 1.0
    return x, rows(tile(Wrench), Wrench), np.zeros((3, LANES))


def copied(named: Named) -> Named:
    return {name: part.copy() for name, part in named.items()}


def flat(named: Named) -> Floats:
    """The rows of a tile from those of each name, in order."""
    return np.concatenate([part.ravel() for part in named.values()])


def certain(
    x: Named, command: Named, push: Floats, frame: Any, substeps: int, actuation: int
) -> Any:
    """Of which lanes the bound says that they stay up."""
    found = []
    clock = Clock(PERIOD, substeps, substeps, 0, 0)
    constants = line(clock), line(frame), line(turning(frame, PERIOD, substeps))
    for lane in range(LANES):
        active = np.zeros(LANES)
        active[lane] = 1.0
        given = flat(x), flat(command), push.ravel(), active
        found.append(flight.count_landing(*given, *constants, actuation) == 0)
    return np.array(found)


def largest(good: Any, low: Floats, high: Floats, steps: int = 14) -> Floats:
    """The largest factors between two, by bisection, for which `good` holds, which it does for `low`."""
    for _ in range(steps):
        middle = np.sqrt(low * high)
        yes = good(middle)
        low, high = np.where(yes, middle, low), np.where(yes, high, middle)
    return low


def body(draw: np.random.Generator, spread: float) -> Any:
    """A rigid body's inertia: none above the sum of the others."""
    masses = 10.0 ** draw.uniform(-spread, 0.0, 3)
    return tuple(10.0 ** draw.uniform(-7, -2) * (masses.sum() - masses))


def scene(seed: int) -> tuple[Named, Named, Floats, Airframe, int, int]:
    """A random vehicle, clock and 16 states, most of them turning about as fast as the bound allows."""
    draw = np.random.default_rng(seed)
    actuation, substeps = int(draw.integers(0, 2)), int(draw.choice([1, 1, 2, 3, 4, 8, 20]))
    h = PERIOD / substeps
    frame = Airframe(
        mass=10.0 ** draw.uniform(-3, 1),
        inertia=body(draw, draw.choice([0.1, 1.0, 3.0])),
        thrust_min=0.0,
        thrust_max=1.0,
        moment_max=(1.0,) * 3,
        rate_max=(1.0,) * 3,
        rate_lag=h * 10.0 ** draw.uniform(-0.4, 1.5),
    )
    x, command, _ = grounded()
    push = draw.normal(size=(3, LANES)) * draw.choice([0.0, 1.0, 30.0])
    x["q"][:] = draw.normal(size=(4, LANES))
    x["q"][:, ::3] = np.array([0.0, 1.0, 0.0, 0.0])[:, None]  # upside down
    x["q"] /= np.linalg.norm(x["q"], axis=0)
    x["v"][:] = draw.normal(size=(3, LANES)) * 10.0 ** draw.uniform(-2, 1, LANES)
    x["p"][2] = -1e6
    weight = frame.mass * GRAVITY
    command["thrust"][0] = weight * 10.0 ** draw.uniform(-1, 2, LANES) * draw.choice([-1, 1], LANES)
    x["w"][:] = draw.normal(size=(3, LANES)) * draw.integers(0, 2, (3, 1))
    command["turn"][:] = draw.normal(size=(3, LANES)) * 10.0 ** draw.uniform(-6, 0, LANES)
    if actuation == MOMENT:
        command["turn"] *= np.array(frame.inertia)[:, None] / h
    else:
        command["turn"][:, ::2] = -x["w"][:, ::2]

    def turned(factor: Floats) -> tuple[Named, Named]:
        y, u = copied(x), copied(command)
        y["w"] *= factor
        u["turn"] *= factor
        return y, u

    def slow(factor: Floats) -> Any:
        y, u = turned(factor)
        return certain(y, u, push, frame, substeps, actuation)

    share = largest(slow, np.full(LANES, 1e-12), np.full(LANES, 1e12 * h))
    share[5::6] *= draw.uniform(1.0, 30.0)  # beyond what is certain
    return *turned(share), push, frame, substeps, actuation


def test_the_constants_are_those_of_the_proof() -> None:
    """The norm in which Euler's equation does no work, the bound of its gyroscopic part, and of a moment."""
    draw, h = np.random.default_rng(0), PERIOD / 4
    for _ in range(200):
        frame = Vehicle().airframe()._replace(inertia=body(draw, draw.choice([0.1, 1.0, 3.0])))
        J = np.array(frame.inertia)[:, None]
        found = turning(frame, PERIOD, 4)
        weights, effects = (
            np.array(found.weights)[:, None] / h**2,
            np.array(found.effects)[:, None] / h**2,
        )
        z = found.room / (1.0 - 1e-9) + found.gain
        c = found.gain / z**2
        w = draw.normal(size=(3, 500)) / np.sqrt(J)
        turn = -np.cross(w, J * w, axis=0) / J
        square, gyroscopic = (weights * w**2).sum(axis=0), np.sqrt((weights * turn**2).sum(axis=0))
        work = (weights * w * turn).sum(axis=0)
        assert (np.abs(work) <= 1e-9 * np.sqrt(square) * (gyroscopic + square)).all()
        assert (w**2).sum(axis=0).max() <= square.max() * (1.0 + 1e-12)
        assert (gyroscopic <= c * square * (1.0 + 1e-9)).all()
        assert (gyroscopic / square).max() > 0.5 * c
        moment = draw.normal(size=(3, 500))
        moment[1:, ::2] = 0.0
        size = np.sqrt((weights * (moment / J) ** 2).sum(axis=0))
        bound = (effects * np.abs(moment)).sum(axis=0)
        assert (size <= bound * (1.0 + 1e-9)).all()
        np.testing.assert_allclose(size[::2], bound[::2])


@pytest.mark.parametrize("substeps", [1, 2, 8, 50])
def test_the_verdict_is_that_of_the_proof(substeps: int) -> None:
    """`sqrt(s + n g (2 g + e)) + n e + e + g <= z`: what is looser in any term is not proved."""
    draw, h = np.random.default_rng(substeps), PERIOD / substeps
    verdicts = []
    for _ in range(40):
        frame = Vehicle().airframe()._replace(inertia=body(draw, draw.choice([0.1, 1.0, 3.0])))
        J = np.array(frame.inertia)[:, None]
        found = turning(frame, PERIOD, substeps)
        z, g = found.room / (1.0 - 1e-9) + found.gain, found.gain
        x, command, push = grounded()
        x["q"][0], x["p"][2] = 1.0, -1e6
        x["w"][:] = draw.normal(size=(3, LANES)) * draw.choice([0.0, 1.0], LANES)
        x["w"] *= z / (h * np.sqrt((J / J.min() * x["w"] ** 2).sum(axis=0)) + 1e-300)
        x["w"] *= draw.uniform(0.0, 1.0, LANES)
        command["turn"][:] = draw.normal(size=(3, LANES))
        effect = h**2 * (np.abs(command["turn"]) / np.sqrt(J * J.min())).sum(axis=0)
        command["turn"] *= z * draw.uniform(0.0, 1.2 / (substeps + 1), LANES) / effect
        s = h**2 * (J / J.min() * x["w"] ** 2).sum(axis=0)
        e = h**2 * (np.abs(command["turn"]) / np.sqrt(J * J.min())).sum(axis=0)
        most = np.sqrt(s + substeps * g * (2.0 * g + e)) + substeps * e + e + g
        clear = np.abs(most - z) > 1e-6 * z
        proved = certain(x, command, push, frame, substeps, MOMENT)
        np.testing.assert_array_equal(proved[clear], (most <= z)[clear])
        verdicts.extend(proved)
    assert 0.1 < np.mean(verdicts) < 0.9


@pytest.mark.parametrize("first", range(0, 30, 10))
def test_what_is_certain_to_stay_up_does(first: int) -> None:
    """At the lowest height that is certain, and turning as fast as is certain."""
    seen = {MOMENT: 0, RATES: 0}
    for seed in range(first, first + 10):
        x, command, push, frame, substeps, actuation = scene(seed)
        h = PERIOD / substeps

        def high(factor: Floats) -> Any:
            x["p"][2] = -1.0 / factor  # noqa: B023
            return certain(x, command, push, frame, substeps, actuation)  # noqa: B023

        factor = largest(high, np.full(LANES, 1e-6), np.full(LANES, 1e9), 30)
        sure = high(factor)
        seen[actuation] += int(sure.sum())
        with np.errstate(all="ignore"):
            flown = Flight(x, command, push, frame, actuation)
            lowest = np.max([flown.substep(h) for _ in range(substeps)], axis=0)
        assert (lowest[sure] < 0.0).all(), (seed, lowest[sure].max())
        assert (h * flown.fastest[sure] <= 1.0 + 1e-9).all(), seed
        assert (flown.tilt[sure] <= 2.25).all(), seed
    assert min(seen.values()) > 20


def test_the_bound_is_nearly_reached() -> None:
    """Upside down, spun back and forth as fast as is certain: a stage pushes down 2.1 times the thrust."""
    h = PERIOD
    frame = Vehicle(rate_lag=h / 2).airframe()
    x, command, push = grounded()
    x["q"][:] = np.array([0.0, 1.0, 0.0, 0.0])[:, None]
    x["w"][2], command["turn"][2], command["thrust"][0] = 0.999 / h, -0.999 / h, 1000.0
    x["p"][2] = -0.5
    flown = Flight(x, command, push, frame, RATES)
    drop = flown.substep(h) - x["p"][2]
    assert 2.05 < flown.tilt.max() < 2.25
    assert (drop > 0.57 * h * h * 1000.0 / frame.mass).all()
    for height, sure in ((drop * 0.99, False), (drop * 2.0, True)):
        x["p"][2] = -height
        assert (certain(x, command, push, frame, 1, RATES) == sure).all()


def test_a_fall_is_foreseen_exactly() -> None:
    """Without thrust, at rest and thrown up or down: to a millionth of a metre."""
    frame = Vehicle().airframe()
    x, command, push = grounded()
    x["q"][0] = 1.0
    x["v"][2] = np.linspace(-3.0, 3.0, LANES)
    fall = np.maximum(PERIOD * x["v"][2] + 0.5 * GRAVITY * PERIOD**2, 0.0)
    for actuation in (MOMENT, RATES):
        x["p"][2] = -fall - 1e-6
        assert certain(x, command, push, frame, 4, actuation).all()
        x["p"][2] = -fall + 1e-6
        assert not certain(x, command, push, frame, 4, actuation).any()
        x["p"][2] = -fall
        assert not certain(x, command, push, frame, 4, actuation).any()
        push[2] = 20.0  # a gust, that may turn
        x["p"][2] = -fall - 0.5 * 19.9 * PERIOD**2
        assert not certain(x, command, push, frame, 4, actuation)[x["v"][2] >= 0.0].any()
        push[2] = 0.0


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("actuation", [MOMENT, RATES])
def test_what_is_no_number_is_never_certain(part: str, actuation: int) -> None:
    frame = Vehicle().airframe()
    for value in (np.nan, np.inf):
        x, command, push = grounded()
        x["q"][0], x["p"][2] = 1.0, -100.0
        assert certain(x, command, push, frame, 4, actuation).all()
        if part != "q":  # an attitude has no part in it
            x[part][:, ::2] = value
        for one in command.values():
            one[:, 1::2] = value
        found = certain(x, command, push, frame, 4, actuation)
        assert not found[1::2].any()
        assert found[::2].all() if part == "q" else not found[::2].any()


def test_in_ordinary_flight_it_is_certain() -> None:
    """A metre up, turning as fast as a vehicle does that is not tumbling."""
    for actuation in (MOMENT, RATES):
        frame = Vehicle().airframe()
        x, command, push = grounded()
        x["q"][0], x["p"][2], x["v"][2], command["thrust"][0] = 1.0, -1.0, 5.0, frame.thrust_max
        x["w"][0] = np.linspace(-30.0, 30.0, LANES)
        command["turn"][:] = np.array(frame.moment_max if actuation == MOMENT else frame.rate_max)[
            :, None
        ]
        assert certain(x, command, push, frame, 4, actuation).all()
        x["w"][0] = 250.0
        assert not certain(x, command, push, frame, 4, actuation).any()


# -- through the kernel ---------------------------------------------------------------------------------


def test_a_world_does_not_depend_on_what_its_neighbours_do_at_the_floor() -> None:
    """Light vehicles, a substep in each tick: one world of a tile near the floor, or all high up."""
    tiles = 4 if numba_config.DISABLE_JIT else 600
    config = unchecked(vehicle={"inertia": (1e-6,) * 3, "moment_max": (0.05,) * 3}, substeps=1)
    flights = [Simulation(config, tiles * LANES) for _ in range(2)]
    for one in flights:
        for world in range(one.num_worlds):
            one.seed(world, world)
        one.reset()
    draw = np.random.default_rng(2)
    state, actions = vehicles(flights[0]), still(flights[0])
    state["p"][:, :, 2] -= 50.0
    low = {name: part[:, 1:, :, 0] for name, part in state.items()}  # first worlds of the tiles
    shape = low["p"].shape[:2]
    low["p"][..., 2] = -(10.0 ** draw.uniform(-3, -0.5, shape))
    low["v"][..., 2] = draw.normal(size=shape)
    q = draw.normal(size=(*shape, 4))
    low["q"][:] = q / np.linalg.norm(q, axis=-1, keepdims=True)
    low["w"][:] = draw.normal(size=(*shape, 3)) * 30.0
    actions[::LANES] = np.sign(draw.normal(size=actions[::LANES].shape))
    flights[1]._state.vehicles[:] = flights[0]._state.vehicles
    vehicles(flights[1])["p"][:, 1:, 2, 1] = -1e-9  # the second world meets the floor
    for one in flights:
        one.step(actions, kernels.STEP)
    alone, beside = (vehicles(one) for one in flights)
    for name in PARTS:
        np.testing.assert_array_equal(alone[name][:, 1:, :, 0], beside[name][:, 1:, :, 0])


def test_few_ticks_look_out_for_the_floor() -> None:
    """On `nominal`, hovering: none at all, though vehicles are at 1.2 m and may fall with 2 g more."""
    simulation = begun(32)
    frame, clock = simulation.config.vehicle.airframe(), simulation.config.world.clock
    constants = line(clock), line(frame), line(turning(frame, clock.period, clock.substeps))
    _, command, push = grounded()
    command["thrust"][:] = frame.thrust_max
    given = flat(command), push.ravel(), np.ones(LANES)
    for _ in range(50):
        simulation.step(still(simulation))
        for tile_of_worlds in simulation._state.vehicles:
            for x in tile_of_worlds:
                assert flight.count_landing(x, *given, *constants, MOMENT) == 0


def test_the_configured_vehicles_are_covered() -> None:
    for scenario in ("nominal", "paper", "experiment", "agile", "swarm"):
        config = configure(scenario)
        found = turning(config.vehicle.airframe(), config.control_period, config.substeps)
        assert found.room > 0.1
        assert 0.0 <= found.gain < found.room
