"""Places on the floor: in rows behind the leader, so that the ways to the slots do not cross."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baselines import make_policy
from baselines.scoring.rollout import fly
from formation_env import configure, formations
from formation_env.configuration import placement
from formation_env.configuration.placement import ground_rows


def ways(starts: np.ndarray, slots: np.ndarray) -> np.ndarray:
    """`a . b` of every two vehicles: between their places times between their slots."""
    a, b = starts[:, None] - starts, slots[:, None] - slots
    return np.asarray((a * b).sum(axis=-1))


def bends(n: int) -> list[np.ndarray]:
    some = np.random.default_rng(n).uniform((0.1, -3.0, -1.0), (3.0, 3.0, 1.0), (n, 3))
    named = formations.stack, formations.line, formations.wedge, formations.column
    return [some, *(np.asarray(make(n)) for make in named)]


@given(st.integers(1, 40))
@settings(max_examples=25)
def test_no_way_crosses_another(n: int) -> None:
    """The condition of CAPT, to the size of what parts alike ones; the places are the rows', each once."""
    for offsets in bends(n):
        places = ground_rows([tuple(d) for d in offsets])
        assert ways(places, offsets[:, :2]).min() >= -1e-6
        rows = formations.grid(n, int(np.ceil(np.sqrt(n))), ahead=0.7)[:, :2]
        assert sorted(places.tolist()) == sorted(rows.tolist())


@pytest.mark.parametrize("n", range(1, 5))
def test_of_alike_slots_the_first_stands_in_front(n: int) -> None:
    rows = formations.grid(n, int(np.ceil(np.sqrt(n))), ahead=0.7)[:, :2]
    places = ground_rows([tuple(d) for d in formations.stack(n)])
    assert np.array_equal(places, rows)


def test_many_are_placed_by_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Within a block no way crosses another; from block to block the order from side to side is kept."""
    offsets = bends(60)[0]
    monkeypatch.setattr(placement, "_ASSIGNED", 20)
    places = ground_rows([tuple(d) for d in offsets])
    blocks = np.array_split(np.lexsort(offsets[:, :2].T), 3)
    for block in blocks:
        assert ways(places[block], offsets[block, :2]).min() >= -1e-6
    sides = [places[block, 1] for block in blocks]
    assert sides[0].max() <= sides[1].min() and sides[1].max() <= sides[2].min()


@pytest.mark.parametrize("name", ["expert", "ff"])
def test_larger_formations_get_off_the_floor(name: str) -> None:
    """Without the assignment every episode of five and more ended in a collision."""
    for n in (5, 6, 8):
        columns = fly(make_policy(name, configure("paper", followers=n, duration=20.0)), range(3))
        assert not columns["failed"].any(), n
