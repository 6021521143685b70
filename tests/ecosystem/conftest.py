"""Tests with other libraries: `bash .ci/run ecosystem` makes their environments and runs them.

The environments are used as those libraries' users would, without adapters. One module per library,
named after what it uses; none is called like the library itself, because this folder is on the path.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest


def pytest_configure(config: pytest.Config) -> None:
    """These libraries warn about each other's versions."""
    config.addinivalue_line("filterwarnings", "default")


@pytest.fixture(autouse=True)
def _collected() -> Iterator[None]:
    """Files and folders that they leave to the garbage collector are closed with their test: at the end
    of the session pytest would take the warnings for errors."""
    yield
    gc.collect()
