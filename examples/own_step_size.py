"""A step size of your own: it grows while the errors of a pair agree in sign, and shrinks when they alternate."""

import matplotlib.pyplot as plt
from stable_baselines3.common.env_util import make_vec_env

from sb3_adaptive_q import CompiledVecEnv, EpisodeSeriesCallback, LearningRateCallback, TabularQ, method
from sb3_adaptive_q.plots import plot_learning_curves


class SignAgreement(LearningRateCallback):
    """Two numbers for every state and action: its step size, and its last temporal-difference error."""

    memory = {"size": 0.1, "last_error": 0.0}  # noqa: RUF012

    @staticmethod
    def step_size(mu, step, growth, shrinkage, size, last_error):
        cell = step.row, step.column
        factor = growth if step.td_error * last_error[cell] > 0.0 else shrinkage
        size[cell] = min(max(size[cell] * factor, 0.005), 0.5)
        last_error[cell] = step.td_error
        return size[cell]


def episodes_of(callback: LearningRateCallback, seed: int) -> EpisodeSeriesCallback:
    env = make_vec_env("FrozenLake-v1", vec_env_cls=CompiledVecEnv)
    episodes = EpisodeSeriesCallback()
    model = TabularQ("MlpPolicy", env, exploration_fraction=0.5, seed=seed)
    model.learn(200_000, callback=[callback, episodes])
    return episodes


runs = {
    "own step size": [episodes_of(SignAgreement(growth=1.05, shrinkage=0.95), seed) for seed in range(10)],
    "Method 2": [episodes_of(method(2), seed) for seed in range(10)],
    "Method 7": [episodes_of(method(7), seed) for seed in range(10)],
}
plot_learning_curves(runs, window=500, against="timesteps").figure.savefig("own_step_size.png", dpi=150)
print({label: round(float(sum(run.returns[-500:].mean() for run in group)) / len(group), 2) for label, group in runs.items()})
plt.show()
