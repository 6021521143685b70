"""What a baseline is: a function from observations to actions, batched over worlds and followers.

A policy of your own needs no base class. It is made with the configuration and has two methods:

    class MyPolicy:
        def __init__(self, config): ...
        def reset(self, seed): ...
        def act(self, observation): ...

- `config` is the task, a `FormationConfig`: `config.followers`, `config.action` (the level) and
  `config.action_size`, `config.layout` (names of a row's entries), `config.control_period` (s), ...
- `reset(seed)` is called before the first observation of an episode. What the policy draws at random
  should depend on `seed`, a whole number of at least 0, alone.
- `act(observation)` is called once in every tick of `config.control_period`. It gets float32
  `(followers, entries)`, a row for each follower, and returns `(followers, config.action_size)` finite
  numbers, which are clipped to [-1, 1]. `config.layout.unpack(observation)` gives views by name. Units and
  frames of all entries are in `formation_env.task.ENTRIES` and in the manual, `help(FormationEnv)`: SI, z
  points down, most of them in the follower's formation frame {F}; what an action means is there as well.

To fly many worlds in one call take `reset(seed, worlds)`: world i has the seed `seed + i`, and both arrays
of `act` have the worlds in front, `(worlds, followers, ...)`. If such a policy remembers anything it also
has `restart(mask)`, with `mask` a bool array `(worlds,)`: new episodes begin in those worlds, their next
observations still to come, and the others go on.

`Policy` is the base class of the baselines and implements all of that on top of `begin` and `decide`, and
`begin_again` for those that remember: it takes observations in the form that every face gives them,
refuses observations that are not finite numbers, and notices new episodes without `reset`. One
implementation serves one world and ten thousand.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.policies.new_episodes import DOUBTFUL, NEW, Watch
from baselines.policies.observations import Rows, observed
from formation_env import FormationConfig
from formation_env.validation.checks import integer, refuse, require
from formation_env.validation.warning import warn_user

__all__ = ["EpisodeWarning", "Policy", "Rows"]

_MOST = 2**24  # rows of one policy: of 1.2 GB in the expert, and far more in a simulation


class EpisodeWarning(UserWarning):
    """A policy that remembers cannot tell whether an episode began, or has forgotten one in flight."""


class Policy(ABC):
    """A policy for one configuration.

    Subclasses implement `begin` and `decide` on rows `(worlds, followers, entries)`, and those that
    remember also `begin_again`. They are final. Raises `ValueError` for what is no configuration.
    """

    name: str

    def __init__(self, config: FormationConfig) -> None:
        require(isinstance(config, FormationConfig), "config", config, "a FormationConfig")
        self.config = config
        self.layout = config.layout
        self._worlds = -1
        self._seed: int | None = None
        self._watch: Watch | None = None
        self._warned = False

    @property
    def remembers(self) -> bool:
        """Whether an action depends on more than the observation it is for, so that a new episode
        matters."""
        return type(self).begin_again is not Policy.begin_again

    def reset(self, seed: int | None = None, worlds: int = 1) -> None:
        """Forget everything: episodes begin in `worlds` worlds. World i draws from `seed + i`, with
        None from `i`.

        `act` calls it by itself, with the last seed, when it sees another number of worlds. Raises
        `ValueError` for a seed or a number of worlds that is none, or beyond its bounds.
        """
        worlds = integer("worlds", worlds, 1, _MOST // self.config.followers)
        first = 0 if seed is None else integer("seed", seed, 0, 2**64 - worlds)
        self._worlds, self._watch = -1, None
        self.begin(np.uint64(first) + np.arange(worlds, dtype=np.uint64))
        self._worlds, self._seed = worlds, seed
        self._watch = Watch(self.config, worlds) if self.remembers else None

    def restart(self, mask: NDArray[np.bool_]) -> None:
        """Episodes begin in the worlds of `mask`, shape `(worlds,)`; in the others they go on.

        For worlds that are reset one by one: call it with the next observations still to come. Raises
        `ValueError` for any other shape or type.
        """
        try:
            mask = np.asarray(mask)
        except ValueError:  # rows of unequal length
            refuse("mask", mask, "a bool array, an entry for each world of the last reset")
        if mask.shape != (self._worlds,) or mask.dtype != np.bool_:
            raise ValueError(
                f"mask is {mask.dtype} {mask.shape}: expected bool ({max(self._worlds, 0)},), an entry "
                "for each world of the last reset"
            )
        if mask.any():
            self.begin_again(mask)
            if self._watch is not None:
                self._watch.forget(mask)

    def look_away(self) -> None:
        """The next observations are compared with none before: memory has been replaced."""
        if self._watch is not None:
            self._watch.forget(np.ones(self._worlds, dtype=np.bool_))

    def act(self, observation: NDArray[Any]) -> Rows:
        """Actions for observations of shape `(entries,)`, `(followers, entries)`, `(worlds,
        followers, entries)` or with the followers' entries side by side, as the Gymnasium faces
        give them: `(followers * action_size,)` and so on, float32 in [-1, 1].

        A policy that remembers notices by itself that episodes began in some worlds or in all; where it
        cannot be certain it warns with `EpisodeWarning`. Raises `ValueError` for any other shape, for
        what is not an array of real numbers, and for NaN and infinity, naming world, follower and entry.
        """
        rows, shape = observed(observation, self.config)
        if len(rows) != self._worlds and self._begin_unasked(rows):
            self._warn_once(
                f"{len(rows)} worlds in flight after another number of them: what it remembered is lost; "
                "have a policy for each set of worlds, or call reset(worlds=...)"
            )
        found = 0 if self._watch is None else self._watch.look(rows)
        if self._watch is not None and found & NEW:
            self.begin_again(self._watch.began)
        if found & DOUBTFUL:
            self._warn_once(
                "the last actions were zero, and nothing else says whether an episode began: call "
                "reset() or restart(mask) when one does"
            )
        return self.decide(rows).reshape(shape)

    def _begin_unasked(self, rows: Rows) -> bool:
        """Reset for another number of worlds; whether that loses the memory of flights."""
        had, previous = self._worlds > 0, rows[..., self.layout.slices["previous_action"]]
        self.reset(self._seed, len(rows))
        return had and self.remembers and bool(previous.any())

    def _warn_once(self, what: str) -> None:
        if not self._warned:
            self._warned = True
            warn_user(f"{self.name}: {what}", EpisodeWarning)

    @abstractmethod
    def begin(self, seeds: NDArray[np.uint64]) -> None:
        """Start episodes, one world per seed."""

    def begin_again(self, mask: NDArray[np.bool_]) -> None:  # noqa: B027
        """Start new episodes in the worlds of `mask`. Nothing to do for a policy without memory."""

    @abstractmethod
    def decide(self, rows: Rows) -> Rows:
        """Actions `(worlds, followers, action_size)` for rows `(worlds, followers, entries)`."""
