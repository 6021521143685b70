"""Tests with other libraries: `bash .ci/run ecosystem` makes their environments and runs them.

The environments are used as those libraries' users would, without adapters. One module per library,
named after what it uses; none is called like the library itself, because this folder is on the path.
"""

from __future__ import annotations

import pytest


def pytest_configure(config: pytest.Config) -> None:
    """These libraries warn about each other's versions."""
    config.addinivalue_line("filterwarnings", "default")
