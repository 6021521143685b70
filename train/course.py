"""One run of behaviour cloning or DAgger: rounds of flying and learning, scored and kept."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Mapping
from dataclasses import replace
from math import cos, pi
from time import perf_counter
from typing import Any, final

import numpy as np
import torch

import formation_env
from baselines import Policy, files, make_policy
from baselines.system.console import Lenient
from baselines.system.progress import compiling
from baselines.system.writing import Claim, claim
from train.checkpoint import write
from train.cloning import Clone, Flight, Memory
from train.evaluation import Judge, Row, line, to_csv
from train.imitate import Options
from train.progress import BAR

BEST, LOG = "best.safetensors", "log.csv"

_HELD_OUT = 8  # one world of so many
_TAUGHT = 0.2  # part of the worlds that the teacher keeps, unless even less is asked for
_LAST_RATE = 0.005  # of the learning rate, at the end


def described(done: int, rounds: int, figures: Mapping[str, float]) -> str:
    """How many rounds are done, the error on held-out worlds and the latest score; it fits 80 columns."""
    score = f", score {figures['score']:.3f}" if "score" in figures else ""
    return f"{done} of {rounds} rounds, error {figures['held_out']:.3g}{score}"


@final
class Course:
    """A run that is ready; see `train.imitate`.

    Raises `ValueError` for options that cannot be or a folder that has a policy already, `OSError` for a
    folder that cannot be written.
    """

    def __init__(self, options: Options) -> None:
        config = options.check()
        teacher = make_policy(options.teacher, config)  # refused before the folder is made
        self.options, self.config = options, config
        self._claim = _claimed(options)
        try:
            with compiling(options.quiet):
                self._prepare(teacher)
        except BaseException:
            self._claim.release()
            raise

    def _prepare(self, teacher: Policy) -> None:
        """Everything that is made of the options; compiles what is not compiled yet."""
        options, config = self.options, self.config
        torch.set_num_threads(options.threads)
        torch.manual_seed(options.seed)
        self._rng = np.random.default_rng((options.seed, 1))
        self.flight = Flight(
            config, teacher, options.worlds, options.seed, options.threads, options.residual
        )
        self.flight.explore = options.explore
        rows = options.worlds * config.followers
        self.memory = Memory(
            options.buffer, rows, config.layout.size, config.action_size, options.history
        )
        self._learned = rows - options.worlds // _HELD_OUT * config.followers  # not held out
        self.clone = Clone(
            config, options.history, options.hidden, options.activation, options.magnify
        )
        self._optimiser = torch.optim.Adam(self.clone.parameters(), lr=options.learning_rate)
        total = options.rounds * options.updates
        self._schedule = torch.optim.lr_scheduler.LambdaLR(
            self._optimiser,
            lambda i: _LAST_RATE + (1.0 - _LAST_RATE) * 0.5 * (1.0 + cos(pi * i / total)),
        )
        self.rows: list[Row] = []
        self._judge = Judge(config, options.episodes)  # flies, and so compiles what it needs
        self._begun = perf_counter()

    # -- rounds -----------------------------------------------------------------------------------

    def take(self) -> None:
        """All rounds; then others may write into the folder."""
        with self._claim:
            self._rounds()

    def _rounds(self) -> None:
        from tqdm import tqdm

        o = self.options
        self._begun = perf_counter()
        with (
            _board(o) as board,
            tqdm(
                total=o.rounds,
                bar_format=BAR,
                disable=o.quiet,
                miniters=0,
                file=Lenient(),
                dynamic_ncols=True,
            ) as bar,
        ):
            for number in range(o.rounds):
                self._fly(number)
                figures = {"loss": self._learn(), "held_out": self._held_out()}
                if (number + 1) % o.evaluate_every == 0 or number + 1 == o.rounds:
                    self._evaluate()
                if self.rows:
                    figures["score"] = self.rows[-1].score
                bar.set_description_str(described(number + 1, o.rounds, figures), refresh=False)
                bar.update()
                for name, x in figures.items():
                    board.add_scalar(f"imitation/{name}", x, self.samples)

    @property
    def samples(self) -> int:
        """Agent steps flown so far."""
        return self.memory.count * self.memory.seen.shape[1]

    def _fly(self, number: int) -> None:
        """The teacher alone in the first round, which also tells how large things are."""
        o, config = self.options, self.config
        if number == 0:
            self.flight.fly(config.max_steps + o.ticks, self.memory)
            self.clone.fit_to(*self.memory.everything(), config.layout)
            return
        clone = self.clone if o.method == "dagger" else None
        noise = o.noise * self.clone.size.numpy() if o.noise > 0.0 else None
        share = max(min(o.share, _TAUGHT), o.share**number)
        self.flight.fly(o.ticks, self.memory, clone, share, o.stray, noise)

    def _learn(self) -> float:
        """The optimiser's steps of a round; the mean loss."""
        o, size, total = self.options, self.clone.size, 0.0
        for _ in range(o.updates):
            inputs, labels = self.memory.draw(self._rng, o.batch, 0, self._learned)
            said = self.clone(torch.from_numpy(inputs))
            loss = torch.nn.functional.smooth_l1_loss(
                said, torch.from_numpy(labels) / size, beta=o.huber
            )
            self._optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            self._optimiser.step()
            self._schedule.step()
            total += loss.item()
        return total / o.updates

    def _held_out(self) -> float:
        """Root mean square error on worlds that are not learned from, in units of the labels' size."""
        o, rows = self.options, self.memory.seen.shape[1]
        inputs, labels = self.memory.draw(self._rng, o.batch, self._learned, rows)
        with torch.no_grad():
            error = (
                self.clone(torch.from_numpy(inputs)) - torch.from_numpy(labels) / self.clone.size
            )
        return float(error.square().mean().sqrt())

    # -- scoring and files ------------------------------------------------------------------------

    def _evaluate(self) -> None:
        """One line of the log, and the policy if it is the best so far."""
        o = self.options
        minutes = (perf_counter() - self._begun) / 60.0
        card = self.clone.card(
            self.config,
            o.method if o.residual == 0.0 else f"residual-{o.method}",
            residual=o.residual,
            command=o.command(),
            seed=o.seed,
            steps=self.samples,
            minutes=minutes,
            package=formation_env.__version__,
        )
        network = self.clone.network()
        score, columns = self._judge.judge(card, network)
        row = line(self.samples, minutes, score, columns, o.seed)
        best = all(row.score > other.score for other in self.rows)
        self.rows.append(row)
        if best:
            scores = {o.scenario: [row.score, row.low, row.high]}
            files.save(o.output / BEST, replace(card, score=scores), network)
        write(o.output / LOG, to_csv(self.rows).encode())

    def summary(self) -> str:
        """What has been reached, in words."""
        if not self.rows:
            return "nothing was written"
        best = max(self.rows, key=lambda row: row.score)
        return (
            f"best score {best.score:.3f} ({best.low:.3f} .. {best.high:.3f}) after {best.steps:,} samples "
            f"and {best.minutes:.1f} minutes: {self.options.output / BEST}"
        )


def _claimed(options: Options) -> Claim:
    """A folder of this run's own that has no policy yet."""
    path = options.output / BEST
    own = claim(options.output)
    if path.exists():
        own.release()
        raise ValueError(f"{path} exists: expected another --output")
    return own


@final
class _NoBoard:
    """Takes what TensorBoard would, and drops it."""

    def add_scalar(self, name: str, value: float, step: int) -> None:
        pass


def _board(options: Options) -> Any:
    """TensorBoard's writer if it is wanted, to be closed by leaving it."""
    if not options.tensorboard:
        return contextlib.nullcontext(_NoBoard())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its own, at import
        from torch.utils.tensorboard import SummaryWriter

    return SummaryWriter(str(options.output / "tensorboard"))
