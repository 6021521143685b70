"""Runs the command: `python -m baselines.play`."""

from __future__ import annotations

import sys

from baselines.play.command import main

sys.exit(main())
