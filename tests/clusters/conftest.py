"""Tests that need Ray: `bash .ci/run ray` makes their environment and runs them.

The folder is not called `ray`: `tests` is on the path of the other tests, and where Ray is not
installed `import ray` would find the folder.
"""

from __future__ import annotations

import faulthandler
import os
import signal
import uuid
from collections.abc import Iterator
from typing import Any

import pytest

os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")

# Nodes that `Cluster` starts ask for no token while drivers that join them may: then the second driver
# in a process is cut off. So everybody has the one of this session.
os.environ["RAY_AUTH_MODE"] = "token"
os.environ["RAY_AUTH_TOKEN"] = uuid.uuid4().hex

LIMIT = 400  # s for each test, of which the first compile is most


def pytest_configure(config: pytest.Config) -> None:
    """Ray leaves sockets and processes to the garbage collector."""
    config.addinivalue_line("filterwarnings", "default")


@pytest.fixture(autouse=True)
def _time_limit() -> Iterator[None]:
    """Whatever hangs is interrupted, and what cannot be interrupted ends the process."""

    def late(*_: object) -> None:
        raise TimeoutError(f"more than {LIMIT} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(LIMIT)
    faulthandler.dump_traceback_later(LIMIT + 60, exit=True)
    yield
    faulthandler.cancel_dump_traceback_later()
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture(scope="session")
def cluster_address() -> Iterator[str]:
    """Of two nodes on this machine with a core each."""
    from ray.cluster_utils import Cluster

    node: dict[str, Any] = {"num_cpus": 1, "object_store_memory": 100 * 2**20}
    cluster = Cluster(initialize_head=True, head_node_args={**node, "include_dashboard": False})
    try:
        cluster.add_node(**node)
        cluster.wait_for_nodes()
        yield cluster.address
    finally:
        cluster.shutdown()
