"""Environment ids that ``gymnasium.make`` knows once ``sb3_adaptive_q`` has been imported."""

import gymnasium as gym


def register_envs() -> None:
    """
    Register the environments of this package with gymnasium; ids that are already registered are left alone.

    ``gymnasium.make("sb3_adaptive_q:CartPoleFriction-v0")`` imports the package, and so registers them, by itself.
    """
    if "CartPoleFriction-v0" not in gym.registry:
        gym.register(
            id="CartPoleFriction-v0",
            entry_point="sb3_adaptive_q.envs.cartpole_friction:CartPoleFrictionEnv",
            max_episode_steps=200,
            reward_threshold=195.0,
        )
    # gymnasium's CliffWalking-v1 has no step limit: a greedy policy that runs into a wall would never end an episode.
    if "CliffWalkingLimited-v1" not in gym.registry:
        gym.register(
            id="CliffWalkingLimited-v1",
            entry_point="gymnasium.envs.toy_text.cliffwalking:CliffWalkingEnv",
            max_episode_steps=200,
        )
