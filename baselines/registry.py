"""The policies by name."""

from __future__ import annotations

from baselines.expert import Expert
from baselines.policy import Policy
from baselines.simple import Hover, Pd, Random
from baselines.tuned import ExpertTuned
from formation_env import FormationConfig

POLICIES: dict[str, type[Policy]] = {
    policy.name: policy for policy in (Expert, ExpertTuned, Pd, Hover, Random)
}


def make_policy(name: str, config: FormationConfig) -> Policy:
    """The policy of that name for a configuration; `ValueError` listing the names if unknown."""
    if not isinstance(name, str) or name not in POLICIES:
        raise ValueError(f"policy = {name!r}: expected one of {', '.join(map(repr, POLICIES))}")
    return POLICIES[name](config)
