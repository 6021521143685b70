"""Runs the command: `python -m train.imitate`."""

from __future__ import annotations

import sys

from train.imitate import main

sys.exit(main())
