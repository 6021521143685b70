"""What is played: flights side by side, flown in real time by a thread, and what is done to them.

A `Session` has one or two policies on one configuration from one seed. `do(command)` changes something,
from any thread, and returns an answer or says what is wrong, in which case all is as it was. The thread flies
and makes a frame some thirty times a second; the last ones are kept, for pages that open or are slow.
"""

from __future__ import annotations

import json
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, final

from baselines.play.controls import OFFSETS, controls, groups
from baselines.play.flight import Flight
from baselines.play.settings import configuration, python, values, with_change
from baselines.registry import METHODS, POLICIES, available
from formation_env import SCENARIOS, FormationConfig
from formation_env.config import quietly
from formation_env.validation.checks import (
    boolean,
    choice,
    integer,
    number,
    refuse,
    require,
    vector,
)

FRAME = 1.0 / 30.0  # s between two frames
SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
_LATE = 0.1  # s that a slow machine may be late; what is more is not caught up
_REST = 3.0  # s that an episode that has ended is shown
_KEPT = 3_000_000  # characters of frames that are kept for pages that open, or are slow
_MOST = 300  # frames in one message
_STRONGEST = 20.0  # m/s of a push


@final
class Session:
    """Flights of `policies` (one or two) on a scenario; `known` are the policies to choose from.

    Raises `ValueError` naming what is impossible. `start()` begins to fly; `close()` ends it.
    """

    def __init__(
        self,
        policies: Sequence[str] = ("expert",),
        scenario: str = "nominal",
        changes: dict[str, Any] | None = None,
        seed: int = 0,
        known: Sequence[str] = (),
    ) -> None:
        self.known = tuple(dict.fromkeys((*POLICIES, *METHODS, *known, *policies)))
        self.controls = controls()
        self.scenario, self.changes, self.seed = scenario, dict(changes or {}), seed
        self.paused, self.speed, self.again = False, 1.0, True
        self.notes: list[str] = []
        self.epoch = self.version = (
            0  # of the episodes that are flown; of all that is not in frames
        )
        self._listeners: set[Callable[[], None]] = set()
        self._commands = threading.Lock()  # one at a time
        self._lock = threading.RLock()  # of the flights and the frames
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._rested = 0.0
        self._flights: list[Flight] = []
        self._base = _base(scenario)
        self._take(*self._made(policies, scenario, self.changes, seed))

    # -- flying -----------------------------------------------------------------------------------

    def start(self) -> None:
        """Fly, in a thread."""
        self._thread = threading.Thread(target=self._fly, name="flights", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop the thread."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(10.0)

    def _fly(self) -> None:
        before, owed = time.monotonic(), 0.0
        while not self._stop.is_set():
            now = time.monotonic()
            passed, before = min(now - before, _LATE), now
            with self._lock:
                if not self.paused:
                    owed = self._advance(owed + passed * self.speed, now + _LATE)
                    self._rest(passed)
            self._stop.wait(max(0.002, FRAME - (time.monotonic() - now)))

    def _advance(self, owed: float, end: float) -> float:
        """Fly `owed` seconds, not beyond the time `end`; returns what is left of them."""
        period = self.config.control_period
        ticks = int(owed / period)
        for _ in range(ticks):
            if all(flight.ended for flight in self._flights):
                break
            self.tick()
            if time.monotonic() > end:
                return 0.0
        if ticks:
            self._publish()
        return owed - ticks * period

    def tick(self) -> None:
        """Fly all flights by a tick."""
        with self._lock:
            for flight in self._flights:
                flight.tick()

    def _rest(self, passed: float) -> None:
        """Begin the next episode a while after all have ended."""
        over = all(flight.ended for flight in self._flights)
        self._rested = self._rested + passed if over else 0.0
        if over and self.again and self._rested > _REST:
            self._begin(self.seed + 1)

    def _begin(self, seed: int) -> None:
        with self._lock:
            self.seed, self._rested = seed, 0.0
            for flight in self._flights:
                flight.begin(seed)
            self._new_epoch()

    # -- what is shown ----------------------------------------------------------------------------

    @property
    def config(self) -> FormationConfig:
        """What is flown."""
        return self._flights[0].config

    def _new_epoch(self) -> None:
        self.epoch += 1
        self._frames: deque[str] = deque()
        self._count = self._length = (
            0  # frames that were made, and characters of those that are kept
        )
        self._changed()
        self._publish()

    def _publish(self) -> None:
        """Make a frame of what is true now."""
        with self._lock:
            shown = [flight.frame() for flight in self._flights]
            content = {"epoch": self.epoch, "flights": shown}
            frame = json.dumps(content, separators=(",", ":"), allow_nan=False)
            self._frames.append(frame)
            self._count += 1
            self._length += len(frame)
            while self._length > _KEPT and len(self._frames) > 1:
                self._length -= len(self._frames.popleft())
        self._wake()

    def _changed(self) -> None:
        with self._lock:
            self.version += 1
        self._wake()

    def _wake(self) -> None:
        for listener in tuple(self._listeners):
            listener()

    def listen(self, listener: Callable[[], None], on: bool = True) -> None:
        """Have a function called, from any thread, whenever there is something new; or no more."""
        (self._listeners.add if on else self._listeners.discard)(listener)

    def latest(self) -> tuple[int, int, int]:
        """The numbers of the state, of the episodes that are flown and of the latest frame of them."""
        with self._lock:
            return self.version, self.epoch, self._count

    def frames(self, after: int = 0) -> str:
        """The frames with a number above `after` that are kept, the last among them, as one message.

        Of more than some hundred only every second, third, ... is in it.
        """
        with self._lock:
            new = min(self._count - after, len(self._frames))
            every = -(-new // _MOST) or 1
            chosen = [self._frames[-1 - k] for k in range(0, new, every)]
        return f'{{"type":"frames","frames":[{",".join(reversed(chosen))}]}}'

    def hello(self) -> dict[str, Any]:
        """What does not change: controls, scenarios, policies."""
        return {
            "type": "hello",
            "controls": [control._asdict() for control in self.controls],
            "groups": groups(),
            "scenarios": list(SCENARIOS),
            "policies": [{"name": name, "text": _about(name)} for name in self.known],
            "speeds": list(SPEEDS),
        }

    def state(self) -> tuple[int, dict[str, Any]]:
        """Its number, and all that is not in frames."""
        with self._lock:
            config, base = self.config, self._base[1]
            return self.version, {
                "type": "state",
                "epoch": self.epoch,
                "cards": [flight.card() for flight in self._flights],
                "path": self._flights[0].path(),
                "scenario": self.scenario,
                "changes": self.changes,
                "values": values(config),
                "base": base,
                "available": [*available([config]), *self._given()],
                "seed": self.seed,
                "paused": self.paused,
                "speed": self.speed,
                "again": self.again,
                "python": python(self.scenario, self.changes),
                "notes": self.notes,
            }

    def _given(self) -> list[str]:
        return [name for name in self.known if name not in POLICIES and name not in METHODS]

    # -- commands ---------------------------------------------------------------------------------

    def do(self, command: Any) -> dict[str, Any]:
        """Carry out a command `{"do": name, ...}`; returns `{"ok": True, ...}` or `{"error": what is wrong}`.

        Takes as long as it takes to compile what a policy needs; the flights go on meanwhile.
        """
        try:
            require(isinstance(command, dict), "command", command, "an object")
            name = choice("do", command.get("do"), COMMANDS)
            given = {key: value for key, value in command.items() if key not in ("do", "id")}
            with self._commands:
                return {"ok": True, **(getattr(self, f"do_{name}")(**given) or {})}
        except (ValueError, TypeError) as problem:
            return {"error": str(problem)[:600]}

    def do_scenario(self, value: str) -> dict[str, Any]:
        """Another scenario, without changes."""
        return self._refit(scenario=choice("scenario", value, SCENARIOS), changes={})

    def do_policies(self, value: Sequence[str]) -> dict[str, Any]:
        """One policy, or two side by side."""
        good = isinstance(value, list) and 1 <= len(value) <= 2
        require(good, "policies", value, "one or two names")
        return self._refit(policies=[choice("policy", name, self.known) for name in value])

    def do_set(self, name: str, value: Any) -> dict[str, Any]:
        """Another value of a control."""
        choice("name", name, (control.name for control in self.controls))
        return self._refit(changes=with_change(self.changes, name, value))

    def do_unset(self, name: str) -> dict[str, Any]:
        """The scenario's own value of a control."""
        return self._refit(changes={k: x for k, x in self.changes.items() if k != name})

    def do_clear(self) -> dict[str, Any]:
        """The scenario's own values."""
        return self._refit(changes={})

    def do_lose(self, follower: int) -> dict[str, Any]:
        """Follower `follower`, from 1, drops out of the world at once; the others fly on where they are.

        The configuration is then one without it. The policies see one neighbour less and, but for the expert,
        forget what they remember.
        """
        n = self.config.followers
        lost = integer("follower", follower, 1, n) - 1
        if n == 1:
            refuse("follower", follower, "one of several: the last follower cannot be lost")
        kept = [i for i in range(n) if i != lost]
        offsets = [list(self.config.offsets[i]) for i in kept]
        return self._refit(changes=with_change(self.changes, OFFSETS, offsets), kept=kept)

    def do_push(self, vehicle: int, change: Sequence[float]) -> None:
        """Change the velocity of a vehicle, 0 for the leader, at once by so much, m/s, north-east-down."""
        i = integer("vehicle", vehicle, 0, self.config.followers)
        kick = vector("change", change, 3, -_STRONGEST, _STRONGEST, strict=False)
        with self._lock:
            for flight in self._flights:
                flight.push(i, kick.tolist())
            self._publish()

    def do_reset(self, seed: int) -> None:
        """A new episode."""
        self._begin(integer("seed", seed, 0, 2**32))

    def do_pause(self, value: bool) -> None:
        """Stand still, or go on."""
        self.paused = boolean("pause", value)
        self._changed()

    def do_speed(self, value: float) -> None:
        """So many seconds a second."""
        self.speed = number("speed", value, SPEEDS[0], SPEEDS[-1], strict=False)
        self._changed()

    def do_again(self, value: bool) -> None:
        """Whether the next episode begins by itself, with the next seed."""
        self.again = boolean("again", value)
        self._changed()

    # -- changing what is flown -------------------------------------------------------------------

    def _made(
        self, policies: Sequence[str], scenario: str, changes: dict[str, Any], seed: int
    ) -> tuple[list[Flight], list[str]]:
        """The flights, compiled, and what was warned of. Raises `ValueError`."""
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            config = configuration(scenario, changes)
            flights = [Flight(name, config, seed) for name in policies]
            for flight in flights:
                flight.warm()
        return flights, list(dict.fromkeys(str(one.message) for one in warned))

    def _take(self, flights: list[Flight], notes: list[str]) -> None:
        self._flights, self.notes, self._rested = flights, notes, 0.0
        self._new_epoch()

    def _refit(
        self,
        policies: Sequence[str] | None = None,
        scenario: str | None = None,
        changes: dict[str, Any] | None = None,
        kept: Sequence[int] | None = None,
    ) -> dict[str, Any]:
        """Fly something else from where the flights are or, where that is impossible, from the start on.

        Nothing has changed where a configuration or a policy is refused.
        """
        names = [flight.name for flight in self._flights] if policies is None else policies
        scenario = self.scenario if scenario is None else scenario
        changes = self.changes if changes is None else changes
        flights, notes = self._made(names, scenario, changes, self.seed)
        base = self._base if self._base[0] == scenario else _base(scenario)
        with self._lock:
            seed = self.seed
            if seed != flights[0].seed:  # an episode has begun meanwhile
                for flight in flights:
                    flight.begin(seed)
            alike = names == [flight.name for flight in self._flights] and self.scenario == scenario
            on = alike and all(
                a.go_on_from(b, kept) for a, b in zip(flights, self._flights, strict=True)
            )
            if alike and not on:
                for flight in flights:
                    flight.begin(seed)
            self.scenario, self.changes, self._base = scenario, dict(changes), base
            same = on and self.config.followers == flights[0].config.followers
            if same:
                self._flights, self.notes = flights, notes
                self._changed()
                self._publish()
            else:
                self._take(flights, notes)
        return {"began": not on}


COMMANDS = tuple(name.removeprefix("do_") for name in vars(Session) if name.startswith("do_"))


def _base(scenario: str) -> tuple[str, dict[str, Any]]:
    """A scenario and its own values."""
    return scenario, values(quietly(configuration, scenario, {}))


def _about(name: str) -> str:
    """The first sentence of a policy's description."""
    text = " ".join((getattr(POLICIES.get(name), "__doc__", "") or "").partition("\n\n")[0].split())
    return text or ("learned, shipped as a file" if name in METHODS else "your own")
