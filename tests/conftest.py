"""What every test shares: repeatable Hypothesis, no windows, no global random state."""

from __future__ import annotations

import os
from pathlib import Path

# Before pygame or Matplotlib are imported: draw into memory, on machines without a display too.
os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("SDL_AUDIODRIVER", "dummy")
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

import pytest
from hypothesis import HealthCheck, settings

# No deadline: the first example of a test compiles what it calls. No database: the examples depend
# on the test alone, so that processes and machines run the same ones.
settings.register_profile(
    "repeatable",
    derandomize=True,
    deadline=None,
    database=None,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def root() -> Path:
    """The checkout."""
    return Path(__file__).resolve().parent.parent
