"""First seeds of the episodes that training flies; the leaderboard's are 0 to 99, and no two ranges meet."""

from __future__ import annotations

# Tuning flies at most `MOST_TUNING_EPISODES` of either kind, which keeps its three ranges apart.
TUNING_SEEDS, TUNING_VALIDATION_SEEDS, MOST_TUNING_EPISODES = 100_000, 200_000, 100_000
EVALUATION_SEEDS = 1_000_000
TRAINING_SEEDS = 10_000_000


def first_training_seed(seed: int, worlds: int) -> int:
    """Seed of the first of the `worlds` worlds of a run with this `--seed`; world w has that plus w."""
    return TRAINING_SEEDS + seed * worlds
