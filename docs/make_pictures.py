"""Makes the pictures of the manual and of the README.

    python docs/make_pictures.py           all
    python docs/make_pictures.py swarm     those with these names

Needs the extras `render` and `plot` (for Pillow), no display. The same versions make the same files.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

FOLDER = Path(__file__).resolve().parent / "pictures"
PICTURE, ANIMATION = FOLDER.with_name("formation.png"), FOLDER.with_name("formation.gif")
SIZE = (640, 360)  # of the manual's pictures, which are drawn larger and made smaller
COLOURS = 64


class Shot(NamedTuple):
    """A picture of a flight."""

    name: str
    caption: str
    options: dict[str, Any]
    seconds: float
    policy: str = "expert-tuned"
    seed: int = 7

    def keywords(self) -> str:
        """What is set, as it is typed."""
        return ", ".join(f"{name}={value!r}" for name, value in self.options.items())


SCENARIOS = (
    Shot("nominal", "nominal", {"scenario": "nominal"}, 14.0),
    Shot("paper", "paper", {"scenario": "paper"}, 30.0),
    Shot("experiment", "experiment", {"scenario": "experiment"}, 25.0),
    Shot("agile", "agile", {"scenario": "agile"}, 9.0),
    Shot("swarm", "swarm", {"scenario": "swarm"}, 16.0),
)
# Each with one effect, on `nominal` unless it says otherwise.
EFFECTS = (
    Shot("gust", "gusts push every vehicle, each its own way", {"gust": 0.5, "gust_time": 1.0}, 14.0, "ff"),
    Shot("noise", "0.2 m of white noise on measured positions", {"noise": {"position": 0.2}}, 14.0, "ff"),
    Shot("measurement_delay", "what is measured is 0.3 s old", {"measurement_delay": 15}, 14.0, "ff"),
    Shot("estimator", "velocities and accelerations are differenced, the latter a second late",
         {"estimator": "differenced"}, 14.0, "expert"),
    Shot("floor", "take-off from the floor, before the trigger (40)",
         {"scenario": "paper", "followers": 7}, 1.2),
)  # fmt: skip


def frames(shot: Shot, every: int = 0) -> Iterator[Any]:
    """The last picture of a flight, or one of every so many ticks; `(height, width, 3)` of uint8."""
    import gymnasium as gym

    import formation_env  # noqa: F401 (registers the environment)
    from baselines import make_policy
    from formation_env import configure

    config = configure(**shot.options)
    env = gym.make("Formation-v0", scenario=config, render_mode="rgb_array")
    policy = make_policy(shot.policy, config)
    observation, _ = env.reset(seed=shot.seed)
    policy.reset(shot.seed)
    ticks = round(shot.seconds / config.control_period)
    # A picture at least every 0.1 s: trails are made of the scenes that were drawn.
    step = every or max(1, round(0.1 / config.control_period))
    for tick in range(1, ticks + 1):
        observation, _, terminated, truncated, _ = env.step(policy.act(observation))
        if terminated or truncated:
            raise ValueError(f"{shot.name}: the flight ends after {tick} of {ticks} ticks")
        if tick % step == 0 or tick == ticks:
            frame = env.render()
            if every or tick == ticks:
                yield frame
    env.close()


def still(shot: Shot) -> None:
    """Write a picture of the manual."""
    from PIL import Image

    (frame,) = frames(shot)
    small = Image.fromarray(frame).resize(SIZE, Image.Resampling.LANCZOS)
    FOLDER.mkdir(exist_ok=True)
    path = FOLDER / f"{shot.name}.png"
    small.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"{path.name}: {path.stat().st_size} bytes")


def main(names: list[str]) -> None:
    for shot in (*SCENARIOS, *EFFECTS):
        if not names or shot.name in names:
            still(shot)


if __name__ == "__main__":
    main(sys.argv[1:])
