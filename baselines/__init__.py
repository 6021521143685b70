"""Policies to compare with, their evaluation, and the paper's figures redone."""

from baselines.policy import Policy
from baselines.registry import METHODS, POLICIES, make_policy

__all__ = ["METHODS", "POLICIES", "Policy", "make_policy"]
