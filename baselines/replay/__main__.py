"""`python -m baselines.replay`."""

import sys

from baselines.replay.command import main

if __name__ == "__main__":
    sys.exit(main())
