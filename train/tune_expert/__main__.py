"""Runs the command: `python -m train.tune_expert`."""

from __future__ import annotations

import sys

from train.tune_expert import main

sys.exit(main())
