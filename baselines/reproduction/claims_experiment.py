"""What section IV says of figures 11 to 14, measured over several seeds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from baselines.reproduction.claims import SILENT, SOUND, Claim
from baselines.reproduction.sampled import Run
from baselines.reproduction.statistics import per_world, rms, spread
from formation_env.paths.references import Floats

SLOW, FAST = 0.1, 0.5  # Hz: below the first is slow, above the second is fast
_SIZE = 0.353  # m, length of section IV's vehicles
_HEIGHT = _SIZE / 3.0  # m, assumed: it is not printed


def _oscillation(run: Run, prompt: Run) -> Claim:
    def crossings(w: int, m: NDArray[np.bool_]) -> float:
        e = run.planner_true["e1"][m, w, 0]
        signs = np.signbit(e - e.mean(axis=0))
        minutes = m.sum() * run.config.control_period / 60.0
        return float((signs[1:] != signs[:-1]).sum(axis=0).max() / minutes)

    def size(of: Run) -> Floats:
        return per_world(of, lambda w, m: rms(of.planner_true["e1"][m, w]))

    count, e1, without = per_world(run, crossings), size(run), size(prompt)
    return Claim(
        "virtual-errors-oscillate",
        (14,),
        "IV-A",
        "an oscillatory behaviour of the virtual errors is noticeable",
        "oscillates",
        f"|e1| {np.median(e1):.2f} m RMS, through its mean {np.median(count):.0f} times a minute; "
        f"{np.median(without):.2f} m without the moving average",
        bool(np.median(count) >= 6.0 and np.median(e1) > 0.05),
        "above 0.05 m RMS and at least 6 times a minute through its mean, in the steady state",
        SOUND,
        {**spread(e1), "crossings": float(np.median(count)), "prompt": float(np.median(without))},
    )


def _band(x: Floats, rate: float, low: float, high: float) -> float:
    """Power of `x` between two frequencies, Hz."""
    f, power = welch(x, rate, nperseg=min(1024, len(x)), detrend="linear")
    return float(power[(f >= low) & (f <= high)].sum())


def _gain(run: Run, low: float, high: float) -> Floats:
    """RMS of a virtual follower's height over the leader's, within a band of frequencies."""
    rate = 1.0 / run.config.control_period

    def one(w: int, m: NDArray[np.bool_]) -> float:
        leader, virtual = run.p[m, w, 0, 2], run.virtual_p[m, w, 0, 2]
        return float(np.sqrt(_band(virtual, rate, low, high) / _band(leader, rate, low, high)))

    return per_world(run, one)


def _filtering(run: Run) -> list[Claim]:
    slow, fast = _gain(run, 0.0, SLOW), _gain(run, FAST, np.inf)
    z = run.virtual_p[:, 0, :, 2]
    apart = float(np.abs(z[:, 0] - z[:, 1]).max())
    return [
        Claim(
            "slow-variations-kept",
            (11,),
            "IV-A",
            "the longer and slower variations of the leader's height are found in the virtual "
            "followers'",
            "kept",
            f"height below {SLOW:g} Hz passed on with a gain of {np.median(slow):.2f} (from "
            f"{slow.min():.2f} to {slow.max():.2f})",
            bool(0.5 < np.median(slow) < 2.0),
            "gain between 0.5 and 2",
            SOUND,
            {"median": float(np.median(slow)), "least": float(slow.min())},
        ),
        Claim(
            "fast-variations-filtered",
            (11,),
            "IV-A",
            "the more instantaneous changes in the leader's height are filtered",
            "filtered",
            f"height above {FAST:g} Hz passed on with a gain of {np.median(fast):.2f}, worst "
            f"{fast.max():.2f}",
            bool(np.median(fast) < 0.5 and np.median(fast) < 0.5 * np.median(slow)),
            "gain below a half, and below half of that of the slow variations",
            SOUND,
            spread(fast),
        ),
        Claim(
            "heights-of-virtual-followers-coincide",
            (11,),
            "IV-A",
            "the green line cannot be seen for being shadowed by the light blue one: the virtual "
            "followers are at the same height",
            "same height",
            f"difference of at most {apart:.0e} m",
            apart < 1e-3,
            "below 1 mm",
            SILENT,
            {"difference": apart},
        ),
    ]


def _delay(run: Run) -> Claim:
    """By how much the estimated acceleration is late: the lag of largest correlation."""
    h = run.config.control_period
    lags = np.arange(round(3.0 / h))

    def one(w: int, m: NDArray[np.bool_]) -> float:
        true = np.gradient(run.v[:, w, 0, :2], h, axis=0)
        at = np.flatnonzero(m)
        estimated = run.estimate[at, w, :2]
        match = [float((estimated * true[at - k]).sum()) for k in lags]
        return float(h * lags[int(np.argmax(match))])

    late = per_world(run, one)
    return Claim(
        "estimate-is-late",
        (10,),
        "IV",
        "a moving average with 100 coefficients introduces a delay of approximately 1 s",
        "1 s",
        f"{np.median(late):.2f} s (at most {late.max():.2f} s), by correlation with the true "
        "acceleration",
        bool(0.8 < np.median(late) < 1.2),
        "from 0.8 to 1.2 s",
        SOUND,
        spread(late),
    )


def _followed(run: Run) -> Claim:
    error = per_world(run, lambda w, m: rms(run.tracking[m, w]))
    virtual = per_world(run, lambda w, m: rms(run.planner_true["e1"][m, w]))
    return Claim(
        "smooth-trajectories-tracked",
        (12, 13),
        "IV-A",
        "smooth trajectories that can easily be tracked by the controller",
        "small errors",
        f"|p - p_d| {np.median(error):.3f} m RMS, worst run {error.max():.3f} m",
        bool(np.median(error) < _SIZE and np.median(error) < 0.5 * np.median(virtual)),
        f"below the vehicle's {_SIZE:g} m and below half of the virtual error",
        SILENT,
        spread(error),
    )


def _closest(run: Run) -> Claim:
    def least(w: int, m: NDArray[np.bool_]) -> float:
        return float(run.distances[run.window(w, 0.0), w, 2].min())

    def height(w: int, m: NDArray[np.bool_]) -> float:
        z = run.p[run.window(w, 0.0), w, :, 2]
        return float((z[:, 1:] - z[:, :1]).min())

    between, above = per_world(run, least), per_world(run, height)
    return Claim(
        "vehicles-stay-apart",
        (11,),
        "IV-A",
        "three real vehicles flew this without a collision",
        "no collision",
        f"followers, at one height: least {between.min():.2f} m; the leader above them: least "
        f"{above.min():.2f} m",
        bool(between.min() > _SIZE and above.min() > _HEIGHT),
        f"followers apart by more than the vehicle's length of {_SIZE:g} m, the leader above them by more "
        f"than a third of it, {_HEIGHT:.2f} m",
        SILENT,
        {"between": float(between.min()), "above": float(above.min())},
    )


def experiment_claims(run: Run, prompt: Run) -> list[Claim]:
    """IV; `prompt` is the same flight without the moving average."""
    return [_oscillation(run, prompt), *_filtering(run), _delay(run), _followed(run), _closest(run)]
