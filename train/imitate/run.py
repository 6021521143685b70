"""One run of behaviour cloning or DAgger: rounds of flying and fitting, evaluated and saved."""

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
from train.evaluation import Evaluator
from train.imitate.buffer import SampleBuffer
from train.imitate.clone import Clone
from train.imitate.collector import Collector, Mixture
from train.imitate.options import Options
from train.log import LogRow, is_best, log_row, to_csv
from train.margin import changes
from train.progress import BAR

BEST, LOG = "best.safetensors", "log.csv"

_HELD_OUT = 8  # one world of so many is held out
_LEAST_SHARE = 0.2  # part of the worlds that the teacher keeps, unless `share` is less
_LAST_RATE = 0.005  # learning rate at the end, as part of that at the start


def described(done: int, rounds: int, figures: Mapping[str, float]) -> str:
    """The text beside the bar: rounds done, error on held-out worlds, latest score; it fits 80 columns."""
    score = f", score {figures['score']:.3f}" if "score" in figures else ""
    return f"{done} of {rounds} rounds, error {figures['held_out']:.3g}{score}"


@final
class Run:
    """A run of `train.imitate` that is ready to train.

    Raises `ValueError` for options that cannot be or a folder that has a policy already, `OSError` for a
    folder that cannot be written.
    """

    def __init__(self, options: Options) -> None:
        self.options, self.config = options, options.config()
        self._flown = options.training_config()
        teacher = make_policy(options.teacher, self._flown)  # refused before the folder is made
        self._claim = _claimed(options)
        try:
            with compiling(options.quiet):
                self._prepare(teacher)
        except BaseException:
            self._claim.release()
            raise

    def _prepare(self, teacher: Policy) -> None:
        """Make worlds, buffer, clone and optimiser; compiles what is not compiled yet."""
        o, config = self.options, self.config
        torch.set_num_threads(o.threads)
        torch.manual_seed(o.seed)
        self._rng = np.random.default_rng((o.seed, 1))
        self.collector = Collector(self._flown, teacher, o.worlds, o.seed, o.threads, o.residual)
        self.collector.explore = o.explore
        rows = o.worlds * config.followers
        size = (rows, config.layout.size, config.action_size)
        self.buffer = SampleBuffer(o.buffer, *size, o.history)
        self._fitted_rows = rows - o.worlds // _HELD_OUT * config.followers  # the rest is held out
        self.clone = Clone(config, o.history, o.hidden, o.activation, o.magnify)
        self._optimiser = torch.optim.Adam(self.clone.parameters(), lr=o.learning_rate)
        total = o.rounds * o.updates
        self._schedule = torch.optim.lr_scheduler.LambdaLR(
            self._optimiser,
            lambda i: _LAST_RATE + (1.0 - _LAST_RATE) * 0.5 * (1.0 + cos(pi * i / total)),
        )
        self.rows: list[LogRow] = []
        self._evaluator = Evaluator(config, o.episodes)  # flies, and so compiles what it needs
        self._begun = perf_counter()

    # -- rounds -----------------------------------------------------------------------------------

    def train(self) -> None:
        """Fly and fit all rounds; then other runs may write into the folder."""
        with self._claim:
            self._rounds()

    def _rounds(self) -> None:
        from tqdm import tqdm

        o = self.options
        self._begun = perf_counter()
        with (
            _summary_writer(o) as writer,
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
                self._collect(number)
                figures = {"loss": self._fit(), "held_out": self._held_out_error()}
                if (number + 1) % o.evaluate_every == 0 or number + 1 == o.rounds:
                    self._evaluate()
                if self.rows:
                    figures["score"] = self.rows[-1].score
                bar.set_description_str(described(number + 1, o.rounds, figures), refresh=False)
                bar.update()
                for name, x in figures.items():
                    writer.add_scalar(f"imitation/{name}", x, self.samples)

    @property
    def samples(self) -> int:
        """Agent steps flown so far."""
        return self.buffer.count * self.buffer.observations.shape[1]

    def _collect(self, number: int) -> None:
        """Fly the worlds of a round; in the first the teacher alone, which gives the standardisation."""
        o, config = self.options, self.config
        if number == 0:
            self.collector.collect(config.max_steps + o.ticks, self.buffer)
            self.clone.standardise(*self.buffer.all_samples(), config.layout)
            return
        noise = o.noise * self.clone.size.numpy() if o.noise > 0.0 else None
        share = max(min(o.share, _LEAST_SHARE), o.share**number)
        mixture = Mixture(self.clone, share, o.stray) if o.method == "dagger" else None
        self.collector.collect(o.ticks, self.buffer, mixture, noise)

    def _fit(self) -> float:
        """The optimiser's steps of a round; the mean loss."""
        o, size, total = self.options, self.clone.size, 0.0
        for _ in range(o.updates):
            inputs, labels = self.buffer.draw(self._rng, o.batch, 0, self._fitted_rows)
            loss = torch.nn.functional.smooth_l1_loss(
                self.clone(torch.from_numpy(inputs)), torch.from_numpy(labels) / size, beta=o.huber
            )
            self._optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            self._optimiser.step()
            self._schedule.step()
            total += loss.item()
        return total / o.updates

    def _held_out_error(self) -> float:
        """Root mean square error on the worlds that are not fitted to, in units of the labels' size."""
        o, rows = self.options, self.buffer.observations.shape[1]
        inputs, labels = self.buffer.draw(self._rng, o.batch, self._fitted_rows, rows)
        with torch.no_grad():
            error = (
                self.clone(torch.from_numpy(inputs)) - torch.from_numpy(labels) / self.clone.size
            )
        return float(error.square().mean().sqrt())

    # -- evaluations and files --------------------------------------------------------------------

    def _evaluate(self) -> None:
        """Add a row to the log, and write the policy if it is the best one yet."""
        o = self.options
        minutes = (perf_counter() - self._begun) / 60.0
        card = self.clone.card(
            self.config,
            o.method if o.residual == 0.0 else f"residual-{o.method}",
            residual=o.residual,
            margin=bool(changes(self.config, self._flown)),
            command=o.command(),
            seed=o.seed,
            steps=self.samples,
            minutes=minutes,
            package=formation_env.__version__,
        )
        network = self.clone.network()
        score, columns = self._evaluator.score_network(card, network)
        row = log_row(self.samples, minutes, score, columns, o.seed)
        if is_best(row, self.rows):
            scores = {o.scenario: [row.score, row.low, row.high]}
            files.save(o.output / BEST, replace(card, score=scores), network)
        self.rows.append(row)
        write(o.output / LOG, to_csv(self.rows).encode())

    def summary(self) -> str:
        """The best evaluation in words."""
        if not self.rows:
            return "nothing was written"
        best = max(self.rows, key=lambda row: row.score)
        return (
            f"best score {best.score:.3f} ({best.low:.3f} .. {best.high:.3f}) after {best.steps:,} samples "
            f"and {best.minutes:.1f} minutes: {self.options.output / BEST}"
        )


def _claimed(options: Options) -> Claim:
    """The output folder, which no other run writes into and which has no policy yet."""
    path = options.output / BEST
    folder = claim(options.output)
    if path.exists():
        folder.release()
        raise ValueError(f"{path} exists: expected another --output")
    return folder


@final
class _NoWriter:
    """Has TensorBoard's method and writes nothing."""

    def add_scalar(self, name: str, value: float, step: int) -> None:
        pass


def _summary_writer(options: Options) -> Any:
    """TensorBoard's writer, or one that writes nothing, as a context."""
    if not options.tensorboard:
        return contextlib.nullcontext(_NoWriter())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # TensorBoard's own, at import
        from torch.utils.tensorboard import SummaryWriter

    return SummaryWriter(str(options.output / "tensorboard"))
