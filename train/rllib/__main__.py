"""Runs the command: `python -m train.rllib`."""

from __future__ import annotations

import sys

from train.rllib import main

sys.exit(main())
