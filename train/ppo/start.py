"""Starts a run of PPO from options, from a policy file or from a checkpoint."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np

from baselines import files
from baselines.files import Card, Network
from baselines.policies.learned import require_fit
from baselines.system.writing import claim
from formation_env._compiling import untold
from formation_env.validation.checks import require
from train import checkpoint
from train.checkpoint_contents import Arrays, fact, resumed_options
from train.ppo.options import Options
from train.ppo.policy_files import hidden_sizes
from train.ppo.run import Run


def prepare(options: Options) -> Run:
    """A run that is ready to train, in a folder that no other run writes into until `train` has ended.

    Raises `ValueError` for options that cannot be, `OSError` for the folder.
    """
    path = options.output / checkpoint.NAME
    source = None
    if options.resume:
        checkpoint.require_there(path)
    elif options.init is not None:
        source = files.load(options.init)
        options = _options_for(options, *source)
    folder = claim(options.output)
    try:
        if options.resume:
            with (
                untold()
            ):  # making the worlds compiles a little; `train` announces it with the rest
                run = _resumed(options)
        elif path.exists():
            raise ValueError(f"{path} exists: go on with --resume, or choose another folder")
        else:
            with untold():
                run = Run(options, _method(options, source), source)
    except BaseException:
        folder.release()
        raise
    run.claim = folder
    return run


# -- from a policy file ---------------------------------------------------------------------------


def _options_for(options: Options, card: Card, network: Network) -> Options:
    """The options with history, residual and network of the policy file that training starts from.

    Raises `ValueError` where the file is not for the task, or an option is given that differs from it.
    """
    try:
        require_fit(card, options.config())
    except ValueError as problem:
        raise ValueError(f"--init {options.init}: {problem}") from None
    for name, usual in (("history", 1), ("residual", 0.0)):
        in_file, given = getattr(card, name), getattr(options, name)
        if given not in (usual, in_file):
            raise ValueError(f"--{name} {given}: the policy in {options.init} has {in_file}")
    return replace(
        options,
        history=card.history,
        residual=card.residual,
        hidden=tuple(hidden_sizes(network)),
        activation="relu" if card.activation == "relu" else "tanh",
    )


def _method(options: Options, source: tuple[Card, Network] | None) -> str:
    """The name of the way of training, for the policy's card."""
    if source is None:
        return "ppo" if options.residual == 0.0 else "residual"
    method = source[0].method
    return method if method == "residual" or method.endswith("ppo") else f"{method}-ppo"


# -- from a checkpoint ----------------------------------------------------------------------------

# What may come of building a run for options and numbers that do not fit one another.
_MISFITS = (ValueError, TypeError, KeyError, IndexError, RuntimeError, OverflowError, MemoryError)


def _resumed(given: Options) -> Run:
    """The run of the checkpoint in the output folder."""
    path = given.output / checkpoint.NAME
    facts, arrays = checkpoint.load(path)
    try:
        options = resumed_options(fact(facts, "options"), given)
        _require_sizes(options, arrays)
        run = Run(options, _checked_method(fact(facts, "method")))
        run.restore(facts, arrays)
    except _MISFITS as problem:
        text = " ".join(str(problem).split())[:400]
        what = "" if isinstance(problem, ValueError) else "does not fit its own options: "
        raise ValueError(f"{path}: {what}{text or type(problem).__name__}") from None
    return run


def _require_sizes(options: Options, arrays: Arrays) -> None:
    """Refuse options that ask for more than the arrays hold, before memory of that size is taken."""
    rows = options.worlds * options.training_config().followers
    observations = arrays.get("last/obs", np.zeros(0))
    fits = observations.shape[:1] == (rows,)
    require(fits, "options.worlds", options.worlds, "as many as were saved")
    entries = options.history * options.config().layout.size
    fits = observations.ndim == 2 and observations.shape[1] >= entries
    require(fits, "options.history", options.history, "as many as were saved")
    for i, width in enumerate(options.hidden):
        layer = arrays.get(f"policy/mlp_extractor.policy_net.{2 * i}.weight", np.zeros(0))
        require(layer.shape[:1] == (width,), "options.hidden", options.hidden, "those saved")


def _checked_method(name: Any) -> str:
    """A method's name that a policy's card takes. Raises `ValueError`."""
    good = isinstance(name, str) and re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", name) is not None
    require(good and len(name) <= 100, "method", name, "words of letters and digits with hyphens")
    return str(name)
