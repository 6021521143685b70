"""Leader-follower formation control of quadrotors, as a reinforcement-learning environment.

import gymnasium as gym
import formation_env

env = gym.make("Formation-v0")                      # one policy commands all followers
envs = gym.make_vec("Formation-v0", num_envs=1024)  # many worlds in one call

from formation_env import formation_v0
parallel = formation_v0.parallel_env()              # PettingZoo: one agent per follower
"""

from importlib.metadata import PackageNotFoundError, version

import gymnasium
import pettingzoo

from formation_env.config import FormationConfig
from formation_env.configuration.leader_path import FlightWarning
from formation_env.laws.feasibility import FeasibilityWarning
from formation_env.laws.gains import PlannerGains, TrackerGains
from formation_env.physics.sensors import Noise
from formation_env.physics.vehicle import Vehicle
from formation_env.scenarios import SCENARIOS, configure
from formation_env.task import Limits, Rewards
from formation_env.trajectories import Trajectory

try:
    __version__ = version("formation-env")
except PackageNotFoundError:  # run from a source tree that was not installed
    __version__ = "0+unknown"

__all__ = [
    "SCENARIOS",
    "FeasibilityWarning",
    "FlightWarning",
    "FormationConfig",
    "Limits",
    "Noise",
    "PlannerGains",
    "Rewards",
    "TrackerGains",
    "Trajectory",
    "Vehicle",
    "configure",
]

gymnasium.register(
    "Formation-v0",
    entry_point="formation_env.env:FormationEnv",
    vector_entry_point="formation_env.vector:FormationVectorEnv",
)

if hasattr(pettingzoo, "register"):  # PettingZoo 1.27 and later
    pettingzoo.register(
        "parallel",
        "formation/formation_v0",
        entry_point="formation_env.formation_v0:parallel_env",
    )
