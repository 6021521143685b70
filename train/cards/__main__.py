"""Runs the command: `python -m train.cards`."""

from __future__ import annotations

import sys

from train.cards import main

sys.exit(main())
