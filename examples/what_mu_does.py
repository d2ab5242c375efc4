"""What the step size μ does: fifty runs with five step sizes, learned at the same time on all cores."""

import time

import matplotlib.pyplot as plt
from stable_baselines3.common.env_util import make_vec_env

from sb3_adaptive_q import CompiledVecEnv, TabularQ, learn_many

STEP_SIZES = (0.001, 0.01, 0.05, 0.2, 0.8)
RUNS = 10
TRUE_VALUE = 0.542  # of the start state under the best policy, by dynamic programming


def make_model(step_size: float, seed: int) -> TabularQ:
    # Always random: Q-learning learns the values of the best policy whoever acts
    env = make_vec_env("FrozenLake-v1", vec_env_cls=CompiledVecEnv)
    return TabularQ("MlpPolicy", env, learning_rate=step_size, exploration_final_eps=1.0, seed=seed)


models = [make_model(step_size, seed) for step_size in STEP_SIZES for seed in range(RUNS)]
learn_many(models, 100)  # compiles
figure, ax = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
for steps, marker, shift in ((50_000, "x", -0.1), (500_000, "o", 0.1)):
    start = time.perf_counter()
    learn_many(models, steps, log_interval=None)
    print(f"{len(models)} runs of {steps} steps took {time.perf_counter() - start:.1f} s")
    values = [model.q_table[0].max() for model in models]
    positions = [i // RUNS + shift for i in range(len(models))]
    ax.plot(positions, values, marker, color="black", markerfacecolor="none", label=f"{steps} steps")
ax.axhline(TRUE_VALUE, color="gray", linestyle="--", label="true value")
ax.set_xticks(range(len(STEP_SIZES)), [f"{step_size:g}" for step_size in STEP_SIZES])
ax.set(xlabel="step size μ", ylabel="learned value of the start state")
ax.set_title("A small μ learns slowly; a large one keeps the noise, and overestimates", loc="left", fontsize="medium")
ax.legend(frameon=False)
figure.savefig("what_mu_does.png", dpi=150)
plt.show()
