"""Commands whose output may be cut short by whoever reads it: `| head` ends them without a traceback."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import wraps

Main = Callable[[Sequence[str] | None], int]

CUT_SHORT = 141  # exit status: 128 and SIGPIPE, as the shell has it


def until_closed(main: Main) -> Callable[..., int]:
    """Have a command end quietly once its standard output is a pipe that nobody reads any more.

    What it had still to print is dropped; its exit status is its own, or `CUT_SHORT` where printing is
    what ended it.
    """

    @wraps(main)
    def run(arguments: Sequence[str] | None = None) -> int:
        try:
            return main(arguments)
        except BrokenPipeError:
            if not _closed():
                raise  # of another pipe
            return CUT_SHORT
        finally:
            # Python would flush at exit, where nobody can catch what it raises.
            _closed()

    return run


def _closed() -> bool:
    """Whether nobody reads standard output any more; it leads nowhere then."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        with suppress(OSError, ValueError):  # not a file, as in a test
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, sys.stdout.fileno())
            os.close(nowhere)
        return True
    except (AttributeError, OSError, ValueError):  # none, full, closed: not for us to tell
        return False
    return False
