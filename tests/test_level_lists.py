"""Whatever lists the action levels derives from the one table, in all packages."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

from baselines import files
from baselines.policies import tuned
from baselines.scoring import options as scoring
from formation_env import config as configuration
from formation_env import configure
from formation_env.laws.levels import LEVELS, NAMES
from train import options as training


def test_what_lists_the_levels_has_those_of_the_table() -> None:
    assert tuple(configuration._CHOICES["action"]) == NAMES
    assert (
        tuple(files.LEVEL_NAMES) == tuple(tuned.LEVEL_NAMES) == tuple(scoring.LEVEL_NAMES) == NAMES
    )
    assert {level.name: level.exploration for level in LEVELS} == training.STD
    (option,) = (
        one for one in get_args(get_type_hints(training.RunOptions)["action"]) if get_args(one)
    )
    assert get_args(option) == NAMES
    with pytest.raises(ValueError, match=r"action = 'flap': expected .*" + ".*".join(NAMES)):
        configure(action="flap")


@pytest.mark.parametrize("package", ["formation_env", "baselines", "train"])
def test_no_list_of_the_levels_is_written_by_hand(package: str, root: Path) -> None:
    """A tuple, list, set or dictionary that names all of them stands in the table alone.

    But for the type of an option, which type checkers do not compute.
    """
    listed = r"(?<!Literal)[(\[{][^()\[\]{}]*" + r"[^()\[\]{}]*".join(
        f"[\"']{name}[\"']" for name in NAMES
    )
    found = []
    for path in sorted((root / package).rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        for hit in re.finditer(listed, text):
            found.append(f"{path.relative_to(root)}:{text.count(chr(10), 0, hit.start()) + 1}")
    assert not found
