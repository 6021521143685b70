"""Flights that are shown together: `Replay`, and `replay(...)`, which flies them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, final

from baselines.own import label
from baselines.registry import recipe
from baselines.replay.episode import Episode
from baselines.replay.page import render
from baselines.replay.recording import fly
from baselines.system.progress import Bar, compiling
from baselines.system.reading import file_name
from baselines.system.writing import write_text
from formation_env import FormationConfig, configure
from formation_env.validation.checks import integer, require

_HEIGHT = 640  # pixels, in a notebook


@final
class Replay:
    """One or more episodes as a page: side by side, at the same time since their reset.

    `Replay(episodes).write("replay.html")` writes one file that opens in a browser from the disk; at the end
    of a notebook's cell the object shows itself. Raises `ValueError` where there is no episode.
    """

    def __init__(
        self, episodes: Episode | Sequence[Episode], title: str = "Formation replay"
    ) -> None:
        each = [episodes] if isinstance(episodes, Episode) else list(episodes)
        good = bool(each) and all(isinstance(episode, Episode) for episode in each)
        require(good, "episodes", episodes, "an Episode, or a list of them")
        require(isinstance(title, str), "title", title, "a text")
        self.episodes = tuple(each)
        self.title = title

    def html(self) -> str:
        """The page."""
        return render(self.episodes, self.title)

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write the page. Returns the file's path. Raises `OSError`."""
        file = Path(file_name(path))
        write_text(file, self.html())
        return file

    def _repr_html_(self) -> str:
        return (
            f'<iframe srcdoc="{escape(self.html())}" title="{escape(self.title)}" '
            f'style="width: 100%; height: {_HEIGHT}px; border: 0; border-radius: 8px"></iframe>'
        )

    def __repr__(self) -> str:
        return f"<Replay of {len(self.episodes)}: {', '.join(map(repr, self.episodes))}>"


def replay(
    policies: Any = "expert",
    scenario: str | FormationConfig | Mapping[str, Any] = "nominal",
    *,
    seed: int = 0,
    quiet: bool = False,
    **fields: Any,
) -> Replay:
    """Fly policies on one scenario, each from the same seed, and show them side by side.

    `policies`: one or a list of what `baselines.evaluate` takes, or a dictionary that gives them names.
    `scenario` and `fields` are what `configure` takes: `replay(["expert", "dagger"], "swarm", seed=3)`,
    `replay(Mine, action="rates", followers=6)`. Raises `ValueError` naming what is wrong, and `PolicyError`
    where your own policy fails in flight.
    """
    seed = integer("seed", seed, 0, 2**32)
    config = configure(scenario, **fields)
    return Replay(fly_all(_by_name(policies), config, seed, quiet))


def _by_name(policies: Any) -> dict[str, Any]:
    if isinstance(policies, Mapping):
        return {str(name): policy for name, policy in policies.items()}
    each = list(policies) if isinstance(policies, (list, tuple)) else [policies]
    return {label(policy): policy for policy in each}


def fly_all(
    policies: Mapping[str, Any], config: FormationConfig, seed: int, quiet: bool = False
) -> list[Episode]:
    """The same episode flown by each policy, with a progress bar.

    Raises `ValueError` naming a policy that is unknown or cannot fly it, before anything flies.
    """
    with compiling(quiet):
        recipes = {name: recipe(policy, config) for name, policy in policies.items()}
        flown = []
        for name, made in recipes.items():
            bar = Bar(config.max_steps, name, quiet)
            try:
                flown.append(fly(made, config, seed, name, bar.advance))
            finally:
                bar.close()
    return flown
