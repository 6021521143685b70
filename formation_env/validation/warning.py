"""Warnings that name the line of the user's code, however deep in the packages the reason is found.

Python shows a warning once for each such line, so one that is found twice on the way is shown once.
"""

from __future__ import annotations

import sys
import warnings

# What stands between the user's line and the reason: this project, and what makes environments and
# configurations.
_BETWEEN = ("formation_env", "baselines", "train", "gymnasium", "dataclasses", "contextlib")


def warn_user(message: str, category: type[Warning] = UserWarning) -> None:
    """Warn as if from the innermost caller outside the packages."""
    frame, depth = sys._getframe(1), 2
    while frame.f_back is not None and _between(frame.f_globals.get("__name__", "")):
        frame, depth = frame.f_back, depth + 1
    warnings.warn(message, category, stacklevel=depth)


def _between(module: str) -> bool:
    return module.partition(".")[0] in _BETWEEN
