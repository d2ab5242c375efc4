"""Makes policy.png, the picture of the README: what Q-learning found on both slippery lakes. Takes a quarter of a minute."""

from pathlib import Path

import matplotlib.pyplot as plt
from stable_baselines3.common.env_util import make_vec_env

from sb3_adaptive_q import CompiledVecEnv, TabularQ
from sb3_adaptive_q.plots import plot_policy

figure, axes = plt.subplots(1, 2, figsize=(8.6, 5.5), width_ratios=(4, 8), layout="constrained")
for ax, env_id, size in zip(axes, ("FrozenLake-v1", "FrozenLake8x8-v1"), ("4 × 4", "8 × 8"), strict=True):
    env = make_vec_env(env_id, vec_env_cls=CompiledVecEnv)
    model = TabularQ("MlpPolicy", env, method=3, exploration_final_eps=0.3, seed=0).learn(30_000_000)
    plot_policy(model, ax=ax)
    ax.set_title(f"Slippery Frozen Lake, {size}", loc="left", fontsize="medium")
figure.savefig(Path(__file__).parent / "policy.png", dpi=160)
