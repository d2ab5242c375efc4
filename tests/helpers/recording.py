"""Callbacks that write down what training does."""

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback


class Recorder(BaseCallback):
    """Keeps the table and μ as they stood before every update and at the end, and what was done at every step."""

    def _on_training_start(self) -> None:
        self.tables: list[np.ndarray] = []
        self.rates: list[float] = []
        self.actions: list[np.ndarray] = []
        self.rewards: list[np.ndarray] = []
        self.dones: list[np.ndarray] = []
        self.epsilons: list[float] = []

    def _on_step(self) -> bool:
        self._note()
        self.actions.append(self.locals["actions"].copy())
        self.rewards.append(self.locals["rewards"].copy())
        self.dones.append(self.locals["dones"].copy())
        self.epsilons.append(self.model.exploration_rate)
        return True

    def _on_training_end(self) -> None:
        self._note()

    def _note(self) -> None:
        self.tables.append(self.model.q_table.copy())
        self.rates.append(self.model.mu)
