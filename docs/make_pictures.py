"""Makes the pictures of the manual and of the README.

    python docs/make_pictures.py           all
    python docs/make_pictures.py swarm     those with these names

Needs the extras `render` and `plot` (for Pillow), no display. The same versions make the same files.
`replay` needs Playwright (extra `dev`) and Chromium as well, and is made only where it is named.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

FOLDER = Path(__file__).resolve().parent / "pictures"
PICTURE, ANIMATION = FOLDER.with_name("formation.png"), FOLDER.with_name("formation.gif")
SIZE = (640, 360)  # of the manual's pictures, which are drawn larger and made smaller
COLOURS = 160


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
    Shot("gust", "gusts push every vehicle its own way", {"gust": 0.3}, 14.0, "ff"),
    Shot("noise", "0.2 m of white noise on measured positions", {"noise": {"position": 0.2}}, 14.0, "ff"),
    Shot("measurement_delay", "what is measured is 0.1 s old, and `ff` rocks until it crashes",
         {"measurement_delay": 5}, 1.3, "ff"),
    Shot("estimator", "the leader's acceleration is known a second late",
         {"scenario": "agile", "estimator": "differenced"}, 9.0, "ff"),
    Shot("floor", "take-off from the floor, before the trigger (40)",
         {"scenario": "paper", "followers": 6}, 1.2),
)  # fmt: skip
# Wide enough a figure eight for this wedge: no virtual follower flies backwards.
LARGE = Shot(
    "formation", "", {"scenario": "swarm", "followers": 5, "duration": 30.0}, 28.8, "expert"
)


def moving() -> Shot:
    """Six followers start below their slots, and fly a wedge on a figure eight."""
    from formation_env import configure
    from formation_env.laws.slots import out_of_frame
    from formation_env.trajectories import figure_eight, path_start

    offsets = configure("swarm", followers=6).offsets
    path = figure_eight(amplitude=(8.0, 4.0), rate=0.2)
    R, (north, east, _) = path_start(path.kind, path.table)
    ahead = [out_of_frame(R, (d[0], d[1], 0.0)) for d in offsets]
    options = {
        "scenario": "swarm",
        "offsets": offsets,
        "trajectory": path,
        "path": "as given",
        "start": "ground",
        "leader_start": (north, east, 0.0),
        "follower_starts": [(north - x, east - y, 0.0) for x, y, _ in ahead],
        "duration": 20.0,
    }
    return Shot("formation", "", options, 19.0, "expert")


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
    _quantized(small).save(path, optimize=True)
    _told(path)


def animation(shot: Shot, size: tuple[int, int] = (448, 252), colours: int = 48) -> None:
    """Write the README's animation: six pictures for each second, shown twice as fast."""
    from PIL import Image

    small = [
        Image.fromarray(frame).resize(size, Image.Resampling.LANCZOS) for frame in frames(shot, 8)
    ]
    # One palette for all, so that a frame stores what has changed alone.
    palette = _quantized(small[len(small) * 2 // 3], colours)
    first, *rest = [x.quantize(palette=palette, dither=Image.Dither.NONE) for x in small]
    first.save(ANIMATION, save_all=True, append_images=rest, duration=80, loop=0, optimize=True)
    _told(ANIMATION)


def replay() -> None:
    """Write a picture of the page that `formation-replay` makes."""
    import io
    import shutil
    import tempfile

    from PIL import Image
    from playwright.sync_api import sync_playwright

    import baselines

    page = Path(tempfile.mkdtemp()) / "replay.html"
    baselines.replay(["expert", "lqr"], "paper", seed=0, followers=6).write(page)
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=shutil.which("chromium") or shutil.which("google-chrome"),
            args=["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
        )
        tab = browser.new_page(viewport={"width": 1280, "height": 800})
        tab.goto(f"{page.as_uri()}#t=30")
        tab.wait_for_timeout(4000)
        shot = tab.screenshot()
        browser.close()
    path = FOLDER / "replay.png"
    _quantized(Image.open(io.BytesIO(shot)).convert("RGB"), 96).save(path, optimize=True)
    _told(path)


def _quantized(picture: Any, colours: int = COLOURS) -> Any:
    """With few colours. Other ways than an octree lose the followers', of which there is little."""
    from PIL import Image

    return picture.quantize(colours, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)


def _told(path: Path) -> None:
    print(f"{path.name}: {path.stat().st_size} bytes")


def main(names: list[str]) -> None:
    from PIL import Image

    for shot in (*SCENARIOS, *EFFECTS):
        if not names or shot.name in names:
            still(shot)
    if not names or LARGE.name in names:
        (frame,) = frames(LARGE)
        Image.fromarray(frame).save(PICTURE, optimize=True)
        _told(PICTURE)
        animation(moving())
    if "replay" in names:
        replay()


if __name__ == "__main__":
    main(sys.argv[1:])
