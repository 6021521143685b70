"""The Gymnasium face: one policy commands all followers. Id `Formation-v0`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, final

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from formation_env.config import FormationConfig
from formation_env.core.simulation import Simulation, Snapshot, stream_key
from formation_env.interface import faces, manual, specs
from formation_env.interface.arguments import Fixed, check_options, configured, whole_seed

Observation = NDArray[np.float32]


@final
class FormationEnv(Fixed, gym.Env[Observation, NDArray[np.float32]]):
    """Quadrotors that keep a formation behind a leader whose trajectory they do not know.

    ## Description

    A leader quadrotor, flown by the paper's backstepping tracker, follows a reference trajectory.
    Each follower has to keep the leader at its offset `d_i = (d_x, d_y, d_z)`, seen from a frame {F}
    that moves along the follower's own path. The target of follower i, its *slot*, is the paper's
    own definition taken exactly,

        p_i* = p_L - R(theta_i*) d_i,      theta_i*_dot = (R^T p_L_dot)_y / d_x        (6), (23)

    with the height of (32) at `e_z = 0`. It depends on the leader's true motion only, never on the
    policy. With equal `d_x` the slots are a rigid formation.

    Where the leader's path lies is drawn in every episode (`path="drawn"`): it is turned about the
    vertical, mirrored in every second episode where no virtual follower inverts on the mirror image, and
    begun at another of its points if it repeats itself; vehicles begin at any yaw angle.
    `path="as given"` flies it as it is given, from its first point, at yaw zero.

    The inertial frame is north-east-down: `z` points down, the floor is `p_z = 0`. One step is one
    control tick of 0.02 s, integrated by 4 Runge-Kutta steps.

    ## Action Space

    `Box(-1, 1, (followers * k,), float32)`: the followers' actions side by side. What they mean is
    chosen by `action=`; the limits are those of `config.vehicle`. Finite values out of range are
    clipped; a value that is not finite raises `ValueError` and changes nothing.

    {actions}

    ## Observation Space

    `Box` of float32, one row per follower, side by side; bounds are finite and observations are
    clipped to them. {F} is the formation frame of the heading that the follower estimates by
    integrating (23) on the leader's measured velocity; its z points down. All but `offset`,
    `previous_action` and `started` come from measurements, with their noise and delay. Use
    `env.unwrapped.config.layout.unpack(row)` for the names.

    {observations}

    Before the trigger (40) fires, `slot_error` refers to the place where the follower should start
    from: the leader counts as being at its first reference point.

    ## Rewards

    The mean over followers of the sum of these terms, each an entry of `info`; `w` is its weight:

    {rewards}

    A tick earns at most 1, so an episode's return is at most its number of ticks: 1500 in `nominal`
    (30 s at 0.02 s), and less in practice, since following the leader costs some effort. Nothing is
    earned before the trigger (40), and in every scenario the whole wait until its deadline costs less
    than a failure.

    ## Starting State

    `start="formation"`: the leader flies along its reference; each follower is level, moves with
    its slot's velocity, and is up to `start_offset` (0.15 m) away from it, uniformly in a ball.
    `start="ground"`: all vehicles rest on the floor; the leader climbs to its first reference point
    and waits until every vehicle is within `trigger` (0.25 m) of where it should start (40). At action
    level `reference` a virtual follower begins where its vehicle is, or on the ground at its slot.

    ## Episode End

    Terminates when a follower collides (the centres of two vehicles closer than 0.353 m), hits the floor
    faster than 1 m/s or more than 60 degrees from level, or is lost (more than 10 m from its slot), and
    when the trigger (40) has not fired within `limits.deadline` (15 s); `info["failure"]` says which. One
    failure costs every follower the same. A leader that crashes, on a path that it cannot fly, ends the
    episode as well; `failure` is then 4 for each follower that has not failed itself, and costs nothing.
    Truncates after `duration` (30 s in `nominal` and `agile`, 45 s in `paper` and `experiment`, a
    round of the path in `swarm`), or earlier where `gym.make` is given `max_episode_steps`;
    `spec.max_episode_steps` says what holds.

    ## Arguments

    `scenario`: `"nominal"`, `"paper"`, `"experiment"`, `"agile"`, `"swarm"` (see
    `formation_env.scenarios`), a `FormationConfig`, or a dictionary of one. `followers`: re-forms a
    named scenario with that many. `render_mode`: `"human"` (needs a display), `"rgb_array"` or None;
    both need the extra `render`. Every field of `FormationConfig` is a keyword, in its JSON form as well:
    `offsets`, `trajectory`, `path`, `action`, `start`, `noise`, `vehicle`, `planner`, `tracker`, `reward`,
    `limits`, `duration`, `control_period`, `substeps`, ...

        gym.make("Formation-v0", scenario="paper", action="rates", followers=3)

    Raises `ValueError` naming the field where a value is impossible, `TypeError` for an unknown keyword;
    warns with `FlightWarning` where the leader's vehicle cannot fly the trajectory, and with
    `FeasibilityWarning` where a follower may have to move backwards.
    `config` holds what came of it and is fixed, as `render_mode` is.

    `reset(seed=...)` takes a whole number from 0. `reset(options=...)` refuses options that do not exist: the
    vector environment has `reset_mask`, the other faces have none. Minari passes its own `minari_autoseed`
    on, which is let pass.

    ## Determinism

    The same seed and actions give the same numbers, bit for bit, on every face and with any number of
    worlds and threads. It is not promised that another processor gives the same last bits, nor plain Python
    (`NUMBA_DISABLE_JIT=1`), whose observations can differ from the compiled ones in the last bit.

    ## Info

    Arrays, none nested, of the true state after the step:

    | entry | shape | unit | meaning |
    |---|---|---|---|
    | `slots` | `(followers, 3)` | m, inertial | where each follower should be |
    | `slot_error` | `(followers, 3)` | m, inertial | slot minus position |
    | `separation` | `(followers,)` | m | distance to the nearest other vehicle |
    | `failure` | `(followers,)` | - | int64, an index into `task.FAILURES`: 0 none, 1 collision, 2 impact, 3 lost, 4 the leader crashed, 5 unstarted: the trigger has not fired in time |
    | `reward_...` | `(followers,)` | 1 | the terms of the reward, each by the name in the table of Rewards |

    Where a vehicle's state can no longer be computed, the episode ends as lost: observations and rewards
    are finite then, too, while `slots`, `slot_error` and `separation` can be NaN in that step.

    ## Version History

    * v0: initial version. Observation layout version 1.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": list(faces.RENDER_MODES),
        "render_fps": 50,
    }

    _fixed = frozenset({"config", "render_mode"})

    def __init__(
        self,
        scenario: str | FormationConfig | Mapping[str, Any] = "nominal",
        *,
        followers: int | None = None,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        self._screen = faces.Screen(render_mode)
        self.config = configured(
            type(self).__name__, ("render_mode",), scenario, followers, options
        )
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": faces.fps(self.config)}
        self.observation_space = faces.observation_space(self.config, self.config.followers)
        self.action_space = faces.action_space(self.config, self.config.followers)
        n, k = self.config.followers, self.config.action_size
        self._flat, self._rows = (n * k,), (1, n, k)  # shapes of an action here and in a world
        self._simulation = Simulation(self.config)
        self._keyed_by: np.random.Generator | None = None
        self._spec: EnvSpec | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode. A seed restarts the random stream; without one the next episode follows.

        There are no options but Minari's `minari_autoseed`, which changes nothing here. Raises
        `ValueError` for any other, and for a seed that is not a whole number.
        """
        check_options(options, passed="minari_autoseed")
        super().reset(seed=whole_seed(seed))
        if self._keyed_by is not self.np_random:
            self._keyed_by = self.np_random
            self._simulation.seed(0, stream_key(self.np_random))
        results = self._simulation.reset()
        info = faces.describe(results.outputs[0])
        self._screen.begin(self._simulation)
        return results.observations[0].reshape(-1), info

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One control tick. Raises `ResetNeeded` before the first reset and after the end."""
        if self._simulation.ended(0):
            raise ResetNeeded("the episode is over or has not begun: call reset() before step()")
        actions = faces.read_action(action, self._flat).reshape(self._rows)
        results = self._simulation.step(actions)
        if self._screen.mode is not None:
            self._screen.follow(self._simulation)
        (reward,), (terminated,), (truncated,) = results.ends.tolist()
        # `ravel` of fresh memory is a view.
        return (
            results.observations.ravel(),
            reward,
            terminated != 0.0,
            truncated != 0.0,
            faces.describe(results.outputs[0]),
        )

    def render(self) -> Any:
        """A frame `(height, width, 3)` of uint8 in mode `rgb_array`; a window in mode `human`."""
        return self._screen.draw(self._simulation)

    def close(self) -> None:
        """Close the window, if there is one."""
        self._screen.close()
        self._simulation.close()

    @property
    def spec(self) -> EnvSpec | None:
        """What `gym.make` made this of, in a form that goes round through JSON; see `EnvSpec`."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        specs.check_time_limit(self.config)
        self._spec = specs.recorded(spec, self.config.max_steps)

    @property
    def simulation(self) -> Simulation:
        """The world behind the environment: true positions, attitudes, times."""
        return self._simulation

    def get_state(self) -> Snapshot:
        """Everything needed to continue identically from here; see also pickle and deepcopy."""
        return self._simulation.get_state()

    def set_state(self, state: Snapshot) -> None:
        """Continue from a state that `get_state` of the same configuration returned."""
        self._simulation.set_state(state)
        if self._simulation.seeded[0]:
            self._keyed_by = self.np_random  # the state's own stream goes on at the next reset


FormationEnv.__doc__ = manual.filled(FormationEnv.__doc__)
