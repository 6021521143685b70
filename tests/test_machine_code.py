"""Every loop over the lanes of a tile is vector code: packed operations in its machine code."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from numba import config

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled"),
]

# In a process of its own, which compiles the kernels anew: kernels from the cache have compiled no loops.
# What types the kernels call each loop with is then known, and with these the machine code is made again,
# of the loop alone: of what is linked (`formation_env._linking`) none is made.
LISTING = """
import importlib, json, pkgutil, sys
import formation_env
from formation_env.core import kernels
from formation_env.memory import tiles

loops = {id(one.run): (f"{one.law.__module__}.{one.name}", one.run) for one in tiles.LOOPS}
for found in pkgutil.walk_packages(formation_env.__path__, "formation_env."):
    for name, one in vars(importlib.import_module(found.name)).items():
        if hasattr(one, "linked") and one.targetoptions.get("nogil"):
            loops.setdefault(id(one), (f"{one.__module__}.{name}", one))

from formation_env.core.simulation import Simulation
Simulation(formation_env.configure("nominal")).reset()
for name, run in loops.values():
    for signature in list(run.linked().overloads):
        run.compile(signature)
        print(json.dumps([name, str(signature), run.inspect_asm(signature)]), flush=True)
    if not run.linked().overloads:
        print(json.dumps([name, "", ""]), flush=True)
"""

# What moves and selects numbers but does not compute.
MOVES = {
    "formation_env.memory.shuffles.copy": "copies",
    "formation_env.memory.shuffles.copy_numbers": "copies",
    "formation_env.memory.shuffles.clear": "writes zeros",
    "formation_env.core.nearest._begin": "copies",
    "formation_env.core.flight.in_the_air": "writes constants",
    "formation_env.core.judging.no_candidate": "writes constants",
}
# What may be scalar code, and why.
SCALAR = {
    "formation_env.memory.shuffles.take_clipped": "reads numbers that do not lie side by side",
    # Unrolled, they are so short that the compiler does so before it would make vector code of them.
    "formation_env.core.flight.line_of_reference": "a product and a comparison, once for each tile",
    "formation_env.core.flight.number_of_sample": "a sum, once for each tile",
    "formation_env.core.judging.distance_of": "a root, where a trigger has fired or an episode has ended",
    "formation_env.core.flight.note_start": "a comparison, twice for each tile",
}
# Operations of processors: packed ones on floating-point or whole numbers, scalar ones on the former.
_PACKED = re.compile(
    r"\bv?(?:fn?m(?:add|sub)\w*|add|sub|mul|div|sqrt|max|min|cmp\w*|and|andn|or|xor|blendv?|cvt\w*)p[ds]\b"
    r"|\bv?p(?:add|sub|mul\w*|cmp\w+|and|andn|or|xor|sll|srl|sra|blend\w*|min\w*|max\w*|ternlog)[bwdq]?\b"
    r"|\bv?cvt\w+2p[ds]\b|\.(?:2d|4s|2s)\b"
)
_ARITHMETIC = re.compile(
    r"\bv?(?:fn?m(?:add|sub)\w*|add|sub|mul|div|sqrt|max|min)p[ds]\b|\.(?:2d|4s)\b"
)
_SCALAR = re.compile(
    r"\bv?(?:fn?m(?:add|sub)\w*|add|sub|mul|div|sqrt)s[ds]\b"
    r"|\b(?:fadd|fsub|fmul|fdiv|fsqrt|fmadd|fmsub)\s+[ds]\d"
)
_MOVED = re.compile(
    r"\bv?mov(?:[au]p[ds]|dq[au]\w*)\b|\b(?:ld|st)[pr]\s+q\d|\bmem(?:cpy|set|move)\b"
)


class Listing(NamedTuple):
    """Machine code of a loop for one signature, and how many operations of each kind stand in it."""

    loop: str
    signature: str
    code: str

    def count(self, kind: re.Pattern[str]) -> int:
        return sum(bool(kind.search(line)) for line in self.code.splitlines())


def own_code(text: str) -> str:
    """Of the listing of a module, the code of the loop itself: not of what Python or C call it by."""
    found, on = [], False
    for line in text.splitlines():
        label = re.match(r"[\"_A-Za-z][^\s]*:", line)
        if label and not line.startswith((".", '".')):
            name = label.group().strip('":')
            on = name.startswith("_ZN") and "cpython" not in name and not name.startswith("cfunc")
        if on:
            found.append(line)
    return "\n".join(found)


@pytest.fixture(scope="module")
def listings(tmp_path_factory: pytest.TempPathFactory) -> list[Listing]:
    """Of every loop of the package that tiles, shuffles, the search and whatever else has."""
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path_factory.mktemp("cache"))}
    command = [sys.executable, "-c", LISTING]
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    rows = [json.loads(row) for row in done.stdout.splitlines() if row.startswith("[")]
    return [Listing(loop, signature, own_code(code)) for loop, signature, code in rows]


def names(listings: list[Listing]) -> set[str]:
    return {one.loop for one in listings}


def _sources(root: Path) -> Iterator[tuple[str, str]]:
    for path in (root / "formation_env").rglob("*.py"):
        module = ".".join(path.relative_to(root).with_suffix("").parts)
        yield module, path.read_text(encoding="utf-8")


def test_all_loops_are_found(listings: list[Listing], root: Path) -> None:
    """As many as the sources mark, and those of each statement that makes some of a law."""
    for module, text in _sources(root):
        for name in re.findall(r"^@loop\ndef (\w+)", text, re.MULTILINE):
            assert f"{module}.{name}" in names(listings)
        for law in re.findall(r"= over_lanes\(\s*(\w+)", text):
            pattern = rf"formation_env(\.\w+)+\.{law}(_\d+)*"
            assert any(re.fullmatch(pattern, name) for name in names(listings)), law
    assert MOVES.keys() | SCALAR.keys() <= names(listings), "an exception that is no loop"


def test_every_loop_is_used_by_the_kernels(listings: list[Listing]) -> None:
    assert not [one.loop for one in listings if not one.signature]


def test_every_loop_is_vector_code(listings: list[Listing]) -> None:
    """More packed operations than scalar ones: none at all where the compiler gave up."""
    bad = []
    for one in listings:
        if one.loop in SCALAR or not one.signature:
            continue
        packed, scalar = one.count(_PACKED), one.count(_SCALAR)
        moved = one.loop in MOVES and one.count(_MOVED) > 0
        if not moved and packed <= scalar:
            bad.append(f"{one.loop}: {packed} packed, {scalar} scalar, {one.count(_MOVED)} moves")
    assert not bad, "\n".join(bad)


def test_the_loops_that_fly_compute_packed(listings: list[Listing]) -> None:
    """The longest ones: dozens of packed sums and products each, nearly no scalar ones."""
    for law, least in (("move", 100), ("follow", 100), ("noisy", 40), ("observed", 20)):
        runs = [
            one
            for one in listings
            if re.fullmatch(rf"formation_env(\.\w+)+\.{law}(_\d)*", one.loop)
        ]
        assert runs, law
        for one in runs:
            assert one.count(_ARITHMETIC) > least, (one.loop, one.count(_ARITHMETIC))
            assert one.count(_SCALAR) < 0.2 * one.count(_ARITHMETIC), one.loop


def test_scalar_code_would_be_noticed() -> None:
    code = "_ZN1f:\n vaddsd %xmm0, %xmm1\n vmulsd %xmm0, %xmm1\n"
    code += "_ZN7cpythonf:\n vmovups %ymm0\n vaddpd %ymm0\n"
    one = Listing("f", "()", own_code(code))
    assert (one.count(_PACKED), one.count(_SCALAR), one.count(_MOVED)) == (0, 2, 0)
    arm = Listing("f", "()", own_code("_ZN1f:\n fmla v0.2d, v1.2d, v2.2d\n fadd d0, d1, d2\n"))
    assert (arm.count(_PACKED), arm.count(_SCALAR)) == (1, 1)
