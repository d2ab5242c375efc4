"""Frozen Lake, step by step: learn, look at the table, test the policy, watch an episode. Takes half a minute."""

import gymnasium as gym
import matplotlib.pyplot as plt
from stable_baselines3.common.evaluation import evaluate_policy

from sb3_adaptive_q import EpisodeSeriesCallback, TabularQ, method
from sb3_adaptive_q.plots import animate, plot_learning_curves, plot_policy

# 1. The environment: 16 cells of slippery ice. An action goes astray in two of three cases.
env = gym.make("FrozenLake-v1")
print("States:", env.observation_space.n, " Actions:", env.action_space.n, "(left, down, right, up)")

# 2. The agent: a table of 16 rows and 4 columns, all zeros at first.
model = TabularQ("MlpPolicy", env, gamma=0.99, seed=0)
print("Before learning, the table's largest entry is", model.q_table.max())

# 3. Learning. Method 7 of the paper sets the step size μ; the callback keeps the return of every episode.
episodes = EpisodeSeriesCallback()
model.learn(300_000, callback=[method(7), episodes])
print("After learning, the start state is worth", round(float(model.q_table[0].max()), 3))

# 4. The greedy policy, on a thousand new episodes. No policy reaches the goal in more than 74 % of them.
mean, _ = evaluate_policy(model, model.get_env(), n_eval_episodes=1000, deterministic=True)
print(f"The greedy policy reaches the goal in {100 * mean:.0f} % of the episodes")

# 5. What was learned, as pictures. The curve stays below the greedy policy, because the agent explored while it learned.
plot_policy(model).figure.savefig("lake_policy.png", dpi=150)
plot_learning_curves({"Method 7": [episodes]}).figure.savefig("lake_curve.png", dpi=150)
animate(model, "FrozenLake-v1", "lake.gif", seed=1)
plt.show()
