"""Makes `docs/formation.png`: the expert flies five followers behind a leader.

    python docs/make_picture.py

Needs the extra `render`, no display.
"""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import numpy as np
import pygame

import formation_env  # noqa: F401 (registers the environment)
from baselines.registry import make_policy
from formation_env import configure

PICTURE = Path(__file__).parent / "formation.png"
SECONDS = 28.8


def main() -> None:
    # Wide enough a figure eight for this wedge: nobody has to fly backwards.
    config = configure("swarm", followers=5, duration=30.0)
    env = gym.make("Formation-v0", scenario=config, render_mode="rgb_array")
    policy = make_policy("expert", config)
    observation, _ = env.reset(seed=7)
    policy.reset(7)
    frame = env.render()
    for _ in range(round(SECONDS / config.control_period)):
        observation, *_ = env.step(policy.act(observation))
        frame = env.render()
    env.close()
    surface = pygame.surfarray.make_surface(np.swapaxes(frame, 0, 1))
    pygame.image.save(surface, str(PICTURE))
    print(f"{PICTURE.name}: {frame.shape[1]} x {frame.shape[0]}, {PICTURE.stat().st_size} bytes")


if __name__ == "__main__":
    main()
