"""Episodes as one HTML page that needs nothing else: no server, no address, no further file.

The page holds the flights as `packing` makes them small, three.js, the modules of `web/` and a style sheet. A
content security policy in it forbids every request. Numbers are rounded to `_STEPS`, for the eye; of
flights longer than `_INSTANTS` ticks every second, third, ... instant is taken.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from string import Template
from typing import Any

import numpy as np

from baselines.replay.episode import Episode
from baselines.replay.linking import linked, text_of
from baselines.replay.lyapunov import NAMES, logarithms
from baselines.replay.packing import deflated, pack
from formation_env import FormationConfig
from formation_env.validation.checks import require

_INSTANTS = 4000
# What half a step is below: a tenth of a millimetre, a hundredth of a degree, a thousandth of an action.
_STEPS = {
    "positions": 2e-4,
    "slots": 2e-4,
    "path": 2e-3,
    "attitudes": 2e-4,
    "actions": 2e-3,
    "lyapunov": 2e-3,
}


def render(episodes: Sequence[Episode], title: str = "Formation replay") -> str:
    """The page of one or more episodes, which play side by side. Raises `ValueError` for none."""
    require(bool(episodes), "episodes", list(episodes), "at least one")
    arrays: dict[str, Any] = {}
    cards = []
    for number, episode in enumerate(episodes):
        chosen = _chosen(episode)
        arrays |= {f"{number}.{k}": (x, _STEPS.get(k, 1.0)) for k, x in _tracks(episode, chosen)}
        cards.append(_card(episode))
    packed = pack(arrays)
    content = {"title": title, "laws": NAMES, "episodes": cards, "blocks": packed.blocks}
    return Template(text_of("page.html")).substitute(
        title=escape(title),
        style=text_of("style.css"),
        licence=text_of("three/LICENSE").strip(),
        content=_in_script(content),
        data=packed.text,
        three=deflated(text_of("three/three.js")),
        script=linked("replay.js"),
    )


def _chosen(episode: Episode) -> Any:
    """The instants that are shown, the last among them."""
    every = -(-len(episode.time) // _INSTANTS)
    return np.unique(np.append(np.arange(0, len(episode.time), every), len(episode.time) - 1))


def _tracks(episode: Episode, chosen: Any) -> list[tuple[str, Any]]:
    """Arrays by name, a row for each instant that is shown."""
    ticks = np.minimum(chosen, len(episode.actions) - 1)
    tracks = [
        ("ticks", np.rint(episode.time[chosen] / episode.config.control_period)),
        ("started", episode.started[chosen]),
        ("positions", episode.positions[chosen]),
        ("attitudes", _continuous(episode.attitudes)[chosen]),
        ("slots", episode.slots[chosen]),
        ("actions", episode.actions[ticks]),
    ]
    if len(episode.lyapunov):
        tracks.append(("lyapunov", logarithms(episode.lyapunov[ticks])))
    path = episode.path[:: -(-len(episode.path) // _INSTANTS)]
    return [*tracks, ("path", path)]


def _continuous(attitudes: Any) -> Any:
    """Quaternions whose signs do not jump: q and -q are the same attitude."""
    turned = np.sign((attitudes[1:] * attitudes[:-1]).sum(axis=-1, keepdims=True))
    signs = np.cumprod(np.where(turned < 0.0, -1.0, 1.0), axis=0)
    return np.concatenate([attitudes[:1], attitudes[1:] * signs])


def _card(episode: Episode) -> dict[str, Any]:
    """What a page says of an episode in words and single numbers."""
    return {
        **card(episode.policy, episode.config, episode.seed),
        "end": episode.end() if episode.failure.any() else None,
        "failure": episode.failure.tolist(),
        "metrics": {k: x if np.isfinite(x) else None for k, x in episode.metrics.items()},
    }


def card(policy: str, config: FormationConfig, seed: int | None) -> dict[str, Any]:
    """What a page says of a flight before it is flown."""
    offsets = np.linalg.norm(np.array(config.offsets), axis=1)
    return {
        "policy": policy,
        "scenario": config.scenario,
        "action": config.action,
        "seed": seed,
        "followers": config.followers,
        "duration": config.duration,
        "period": config.control_period,
        "collision": config.limits.collision,
        "offsets": [round(float(x), 4) for x in offsets],
        "entries": config.level.names,
    }


def _in_script(content: Any) -> str:
    """JSON that may stand within a script element, whatever text is in it."""
    text = json.dumps(content, allow_nan=False, separators=(",", ":"), ensure_ascii=True)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
