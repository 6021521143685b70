"""The generator against its published vectors, and its numbers against their distributions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from formation_env.maths import rng

# Known-answer vectors of Philox4x32-10, distributed with Random123 (kat_vectors).
KNOWN = [
    ("00000000 00000000 00000000 00000000", "00000000 00000000",
     "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
    ("ffffffff ffffffff ffffffff ffffffff", "ffffffff ffffffff",
     "408f276d 41c83b0e a20bc7c6 6d5451fd"),
    ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0",
     "d16cfe09 94fdcceb 5001e420 24126ea1"),
]  # fmt: skip


def words(text: str) -> list[np.uint64]:
    return [np.uint64(int(word, 16)) for word in text.split()]


@pytest.mark.parametrize(("counter", "key", "answer"), KNOWN)
def test_known_answers(counter: str, key: str, answer: str) -> None:
    drawn = rng.philox(*words(counter), *words(key))
    assert [int(x) for x in drawn] == [int(x) for x in words(answer)]


def test_uniforms_are_the_words_of_philox() -> None:
    """When, who, purpose, block are the counter, in that order; the low half of the key first."""
    key = 0x299F31D0_A4093822
    drawn = rng.uniforms(key, 0x13198A2E, 0x85A308D3, 0x243F6A88, 0x03707344)
    expected = [(int(x) + 0.5) / 2.0**32 for x in words(KNOWN[2][2])]
    assert list(drawn) == expected


def sample(draw, vary: str, n: int = 5000) -> np.ndarray:  # type: ignore[no-untyped-def]
    """`n` draws that differ in one argument alone, as an (n, 4) array."""
    fixed = {"key": 2**61 + 17, "purpose": rng.GUST, "who": 3, "when": 40, "block": 1}
    order = ("key", "purpose", "who", "when", "block")
    rows = []
    for i in range(n):
        arguments = fixed | {vary: fixed[vary] + i}
        rows.append(draw(*(arguments[name] for name in order)))
    return np.array(rows)


@pytest.mark.parametrize("vary", ["key", "purpose", "who", "when", "block"])
def test_uniforms_are_uniform_and_independent(vary: str) -> None:
    """Along each argument: distribution, successive draws and the four numbers of one draw."""
    u = sample(rng.uniforms, vary)
    assert 0.0 < u.min() and u.max() < 1.0
    for k in range(4):
        assert stats.kstest(u[:, k], "uniform").pvalue > 1e-3
        assert abs(np.corrcoef(u[:-1, k], u[1:, k])[0, 1]) < 0.06
    assert np.abs(np.corrcoef(u.T) - np.eye(4)).max() < 0.06


def test_normals_are_normal_and_independent() -> None:
    x = sample(rng.normals, "when", 20000)
    for k in range(4):
        assert stats.kstest(x[:, k], "norm").pvalue > 1e-3
    assert np.abs(np.corrcoef(x.T) - np.eye(4)).max() < 0.03
    assert np.abs(np.corrcoef((x**2).T) - np.eye(4)).max() < 0.03


def pair(a: int, b: int) -> tuple[float, float]:
    x, y = rng.normal_pair(rng.as_single(np.uint64(a)), rng.as_single(np.uint64(b)))
    return float(x), float(y)


def test_pairs_are_at_a_radius_and_an_angle() -> None:
    """The radius is that of the first word alone, the angle goes once around with the second."""
    last = 2**32 - 1
    turns = np.arange(1000) * (2**32 // 1000) + 2**31 // 1000
    for a in (0, 2**20, 2**31 - 2**7, 2**32 - 2**12):
        x, y = np.array([pair(a, int(b)) for b in turns]).T
        radius = np.sqrt(-2.0 * np.log(np.float32(a + 0.5) / 2.0**32))
        np.testing.assert_allclose(np.hypot(x, y), radius, rtol=3e-7)
        angles = np.sort(np.arctan2(y, x))
        np.testing.assert_allclose(np.diff(angles), 2.0 * np.pi / 1000, rtol=1e-3)
    assert np.hypot(*pair(0, 2**30)) > 6.7
    assert pair(last, 2**30) == (0.0, 0.0)  # never the root of a negative number


@pytest.mark.parametrize("vary", ["key", "purpose", "who", "when", "block"])
def test_no_two_uses_share_a_number(vary: str) -> None:
    """Every argument matters: changing any of them changes all four numbers, without repeats."""
    u = sample(rng.uniforms, vary, 500)
    assert np.unique(u).size == u.size


def test_high_word_of_the_key_counts() -> None:
    assert rng.uniforms(5, 0, 0, 0, 0) != rng.uniforms(5 + 2**40, 0, 0, 0, 0)


def test_ticks_and_blocks_beyond_32_bits_share_no_number() -> None:
    """`when` counts up to 2^56 and `block` up to 2^8, side by side: each pair draws its own words."""
    pairs = [(low + (high << 32), block) for low in (0, 5) for high in (0, 1, 2, 2**24 - 1)
             for block in (0, 1, 2, 255)]  # fmt: skip
    drawn = {tuple(int(x) for x in rng.words(7, rng.GUST, 3, *pair)) for pair in pairs}
    assert len(drawn) == len(pairs)
