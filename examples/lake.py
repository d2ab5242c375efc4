"""Frozen Lake, step by step: learn, look at the table, judge the policy, watch an episode. Takes about ten seconds."""

import gymnasium as gym
import matplotlib.pyplot as plt

from sb3_adaptive_q import EpisodeSeriesCallback, TabularQ
from sb3_adaptive_q.planning import expected_return, greedy_policy, optimal_return
from sb3_adaptive_q.plots import animate, plot_learning_curves, plot_policy

# 1. The environment: 16 cells of slippery ice. An action goes astray in two of three cases.
env = gym.make("FrozenLake-v1")
print("States:", env.observation_space.n, " Actions:", env.action_space.n, "(left, down, right, up)")

# 2. The agent: a table of 16 rows and 4 columns, all zeros at first.
model = TabularQ("MlpPolicy", env, learning_rate=0.05, gamma=0.99, seed=0)
print("Before learning, the table's largest entry is", model.q_table.max())

# 3. Learning, with a step size μ that stays at 0.05. The callback keeps the return of every episode.
episodes = EpisodeSeriesCallback()
model.learn(300_000, callback=episodes)
print("After learning, the start state is worth", round(float(model.q_table[0].max()), 3))

# 4. The greedy policy, judged exactly from the environment's transition probabilities, within the 100 steps of an episode.
success = expected_return(env, greedy_policy(model.q_table), horizon=100)
best = optimal_return(env, horizon=100)
print(f"The greedy policy reaches the goal in {success:.0%} of the episodes, the best one in {best:.0%}")

# 5. What was learned, as pictures. The curve stays below the greedy policy, because the agent explored while it learned.
plot_policy(model).figure.savefig("lake_policy.png", dpi=150)
plot_learning_curves({"μ = 0.05": [episodes]}).figure.savefig("lake_curve.png", dpi=150)
animate(model, "FrozenLake-v1", "lake.gif", seed=1)
plt.show()
