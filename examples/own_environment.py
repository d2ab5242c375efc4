"""An environment of your own: a grid with wind (after Sutton and Barto, 2018, example 6.5), learned and drawn on its map."""

import gymnasium as gym
import matplotlib.pyplot as plt

from sb3_adaptive_q import TabularQ
from sb3_adaptive_q.plots import animate, plot_policy


class WindyGrid(gym.Env):
    """Every step costs 1. Wind blows upwards, as strongly as `wind` says of each column."""

    desc = ["." * 10, "." * 10, "." * 10, "S......G..", "." * 10, "." * 10, "." * 10]  # noqa: RUF012
    moves = ((-1, 0), (1, 0), (0, -1), (0, 1))  # up, down, left, right: for the pictures
    wind = (0, 0, 0, 1, 1, 1, 2, 2, 1, 0)
    observation_space = gym.spaces.Discrete(70)
    action_space = gym.spaces.Discrete(4)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.row, self.column = 3, 0
        return 10 * self.row + self.column, {}

    def step(self, action):
        down, right = self.moves[action]
        self.row = min(max(self.row + down - self.wind[self.column], 0), 6)
        self.column = min(max(self.column + right, 0), 9)
        return 10 * self.row + self.column, -1.0, (self.row, self.column) == (3, 7), False, {}


env = gym.wrappers.TimeLimit(WindyGrid(), max_episode_steps=500)
model = TabularQ("MlpPolicy", env, learning_rate=0.5, gamma=1.0, exploration_initial_eps=0.3, seed=0)
model.learn(50_000)
print("From the start it takes", -round(float(model.q_table[30].max())), "steps to the goal; the fewest possible are 15")
plot_policy(model).figure.savefig("windy_grid.png", dpi=150)
animate(model, WindyGrid(), "windy_grid.gif")
plt.show()
