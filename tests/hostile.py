"""Arguments that no function may take for numbers, rows of three numbers, or names."""

from __future__ import annotations

from decimal import Decimal
from math import inf, nan
from typing import Any

import numpy as np

NOT_NUMBERS: tuple[Any, ...] = (
    *(True, np.True_, "1", b"1", None, 1j, np.complex128(1.0), Decimal(1), [1.0], np.zeros(()), {}),
    *(nan, inf, -inf, np.float32(nan), np.longdouble("1e4000"), 10**400, -(10**400)),
)
NOT_COUNTS: tuple[Any, ...] = (
    *(True, np.True_, "1", None, 1.0, np.float64(1), 1j, [1], np.ones(1, int), nan),
    *(0, -1, 10**9, 2**64, 10**400),
)
ROW = [0.5, 0.0, -1.0]
NOT_ROWS: tuple[Any, ...] = (
    *(
        None,
        True,
        "abc",
        b"abc",
        1.0,
        {},
        object,
        [],
        [[]],
        [[1.0, 2.0]],
        [ROW, [1.0]],
        np.zeros((0, 3)),
    ),
    *([ROW, [0.5, nan, 0.0]], [ROW, [inf, 0.0, 0.0]], [ROW, [0.5, 10**400, 0.0]], [ROW, None]),
    *([ROW, [True, False, True]], [ROW, ["1", "2", "3"]], [ROW, [1j, 0.0, 0.0]]),
    *(np.ones((2, 3), bool), np.ones((2, 3), complex), np.full((2, 3), "1"), np.ones((2, 3, 3))),
    np.ma.masked_array([ROW, ROW], mask=[[False] * 3, [False, True, False]]),
    np.full((2, 3), np.longdouble("1e4000")),
    [[nan, 0.0, 0.0]] * 6000,
)
