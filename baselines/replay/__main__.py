"""Runs the command: `python -m baselines.replay`."""

from __future__ import annotations

import sys

from baselines.replay.command import main

sys.exit(main())
