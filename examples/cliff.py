"""SARSA against Q-learning on the cliff (Sutton and Barto, 2018, example 6.6), both with ε = 0.1 throughout."""

import matplotlib.pyplot as plt
from stable_baselines3.common.env_util import make_vec_env

from sb3_adaptive_q import SARSA, CompiledVecEnv, EpisodeSeriesCallback, TabularQ
from sb3_adaptive_q.plots import plot_learning_curves, plot_policy

RUNS = 30
runs, models = {}, {}
for algorithm in (TabularQ, SARSA):
    name = "Q-learning" if algorithm is TabularQ else "SARSA"
    runs[name] = []
    for seed in range(RUNS):
        env = make_vec_env("CliffWalkingLimited-v1", vec_env_cls=CompiledVecEnv)
        episodes = EpisodeSeriesCallback()
        model = algorithm(
            "MlpPolicy", env, learning_rate=0.5, gamma=1.0, exploration_initial_eps=0.1, exploration_final_eps=0.1,
            total_episodes=500, seed=seed,
        )  # fmt: skip
        runs[name].append(episodes)
        models[name] = model.learn(100_000, callback=episodes)
    returns = [run.returns[-100:].mean() for run in runs[name]]
    print(f"{name}: mean return of the last 100 episodes {sum(returns) / RUNS:.1f}")

ax = plot_learning_curves(runs, window=20)
ax.set_ylim(-100, 0)
ax.figure.savefig("cliff_curves.png", dpi=150)

# Q-learning takes the shortest way, along the edge. SARSA's values include the steps of exploration, so it keeps away
figure, axes = plt.subplots(2, 1, figsize=(8.2, 6.4), layout="constrained")
for ax, (name, model) in zip(axes, models.items(), strict=True):
    plot_policy(model, ax=ax)
    ax.set_title(name, loc="left")
figure.savefig("cliff_policies.png", dpi=150)
plt.show()
