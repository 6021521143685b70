"""BenchMARL trains MAPPO on the PettingZoo face: a task is defined as its guide says, nothing more."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from benchmarl.algorithms import MappoConfig
from benchmarl.environments.common import Task
from benchmarl.environments.pettingzoo.common import PettingZooClass
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from torchrl.envs import EnvBase, PettingZooWrapper

from formation_env import formation_v0

FRAMES = 60  # two worlds of 30 steps


class FormationClass(PettingZooClass):
    """How BenchMARL makes the environment."""

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        return lambda: PettingZooWrapper(
            formation_v0.parallel_env(**self.config), return_state=True, seed=seed, device=device
        )

    def supports_continuous_actions(self) -> bool:
        return True

    def has_state(self) -> bool:
        return True


class FormationTask(Task):
    """One member for each task, whose name is the enumeration's way to load a file of options."""

    NOMINAL = None

    @staticmethod
    def associated_class() -> type[FormationClass]:
        return FormationClass


@pytest.mark.parametrize("action", ["wrench", "reference"])
def test_mappo(action: str, tmp_path: Path) -> None:
    options = ExperimentConfig.get_from_yaml()
    options.max_n_iters = 1
    options.max_n_frames = None
    options.on_policy_collected_frames_per_batch = FRAMES
    options.on_policy_n_envs_per_worker = 2
    options.on_policy_n_minibatch_iters = 2
    options.on_policy_minibatch_size = FRAMES // 2
    options.evaluation_interval = FRAMES
    options.evaluation_episodes = 1
    options.render = False
    options.loggers = ["csv"]
    options.save_folder = str(tmp_path)
    model = MlpConfig(num_cells=[16], activation_class=torch.nn.Tanh, layer_class=torch.nn.Linear)
    experiment = Experiment(
        task=FormationTask.NOMINAL.get_task({"action": action, "max_cycles": 30}),
        algorithm_config=MappoConfig.get_from_yaml(),
        model_config=model,
        critic_model_config=model,
        seed=0,
        config=options,
    )
    own = formation_v0.parallel_env(action=action)
    assert experiment.group_map == {"follower": own.possible_agents}
    critic = experiment.losses["follower"].critic_network
    assert ("state",) in [key if isinstance(key, tuple) else (key,) for key in critic.in_keys]
    before = {name: p.detach().clone() for name, p in experiment.policy.named_parameters()}
    experiment.run()
    assert experiment.n_iters_performed == 1
    assert experiment.total_frames == FRAMES
    after = dict(experiment.policy.named_parameters())
    assert before
    assert all(torch.isfinite(p).all() for p in after.values())
    assert all(not torch.equal(before[name], after[name]) for name in before)
    assert experiment.mean_return != 0.0
