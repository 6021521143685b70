"""`python tests/fingerprint.py` runs, its lines repeat, and its pilots end and begin episodes."""

from __future__ import annotations

import hashlib
import subprocess
import sys

import fingerprint
import numpy as np
import pytest
from fingerprint import LEVELS, MODES, SCENARIOS, WORLDS, fly_many, lines, pilot
from numba import config

from formation_env import configure
from formation_env.core import simulation

pytestmark = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="takes minutes in plain Python")


@pytest.fixture(autouse=True)
def _two_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """As the script has it."""
    monkeypatch.setattr(simulation, "_VEHICLES_PER_THREAD", 1)


def test_lines_repeat_and_threads_change_none() -> None:
    """In another process as well: no line depends on where an object lies or on what ran before."""
    first = list(lines(["nominal"]))
    command = [sys.executable, fingerprint.__file__, "nominal"]
    second = subprocess.run(command, check=True, capture_output=True, text=True)
    assert second.stdout.splitlines() == first
    hashes = dict(line.rsplit(" ", 1) for line in first)
    assert len(hashes) == len(first) == len(LEVELS) * (2 + len(MODES) * len(WORLDS) * 2)
    assert all(len(digest) == 64 for digest in hashes.values())
    for name, digest in hashes.items():
        if name.endswith(" 2"):
            assert digest == hashes[name[:-1] + "1"], name
    # What is not meant to be the same differs: each level, face and number of worlds.
    assert len(set(hashes.values())) == len(LEVELS) * (2 + len(MODES) * len(WORLDS))


def test_one_bit_changes_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fingerprint, "LEVELS", ("wrench",))
    monkeypatch.setattr(fingerprint, "WORLDS", (17,))
    before = list(lines(["nominal"]))

    def other(worlds: int, size: int) -> fingerprint.Rows:
        rows = pilot(worlds, size)
        rows[-1, -1, -1] = np.nextafter(rows[-1, -1, -1], np.float32(1.0))
        return rows

    monkeypatch.setattr(fingerprint, "pilot", other)
    after = list(lines(["nominal"]))
    assert not set(before) & set(after)


def test_an_entry_that_is_left_out_changes_no_line() -> None:
    def told(**more: float) -> list[dict[str, object]]:
        """One step's `info` of a single environment, and of many with masks and last ones nested."""
        many = {name: np.array([x, x]) for name, x in (("slots", 1.0), *more.items())}
        masks = {f"_{name}": np.array([True, True]) for name in many}
        return [{"slots": 1.0, **more}, {**many, **masks, "final_info": {**many, **masks}}]

    def line(infos: object, without: tuple[str, ...]) -> str:
        digest = hashlib.sha256()
        fingerprint._feed(digest, infos, without)
        return digest.hexdigest()

    assert line(told(reward_new=2.0), ()) != line(told(), ())
    assert line(told(reward_new=2.0), ("reward_new",)) == line(told(), ())
    assert line(told(), ("slots",)) != line(told(), ())


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_some_crash_and_some_are_truncated(scenario: str) -> None:
    _, *steps = fly_many(configure(**SCENARIOS[scenario]), "same_step", 17, 1)
    assert any(terminated.any() for (_, _, terminated, _, _), _ in steps)
    assert any(truncated.any() for (_, _, _, truncated, _), _ in steps)
