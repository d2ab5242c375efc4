# %% [markdown]
# # Q-learning on a frozen lake
#
# A class of 45 minutes. You need Python and what a first course on reinforcement learning says about states, actions,
# rewards and the discount factor γ.
#
# At the end you can say what a table of action values is, how Q-learning changes it, what the step size μ does, and how
# to compare two methods without fooling yourself.
#
# Install what is used here with `pip install 'sb3-adaptive-q[plots]'`. Questions are marked **Q**; the answers stand at
# the end.

# %%
import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np
from stable_baselines3.common.env_util import make_vec_env

from sb3_adaptive_q import SARSA, CompiledVecEnv, EpisodeSeriesCallback, TabularQ, learn_many
from sb3_adaptive_q.planning import action_values, expected_return, greedy_policy, optimal_return, value_iteration
from sb3_adaptive_q.plots import plot_learning_curves, plot_policy, to_frame

# %% [markdown]
# ## 1. The lake (5 minutes)
#
# A frozen lake of 4 × 4 squares. You start at S and want to reach the goal G, which is worth 1. Everything else is
# worth 0. A hole H ends the episode, and so do 100 steps.
#
# The ice is slippery: you go where you wanted with probability 1/3, and to either side with probability 1/3 each.

# %%
env = gym.make("FrozenLake-v1")
for row in env.unwrapped.desc.astype(str):
    print(" ".join(row))
print("states:", env.observation_space.n, " actions:", env.action_space.n, "(left, down, right, up)")

# %% [markdown]
# How often does an agent reach the goal that acts at random? Let it try a thousand times.

# %%
rng = np.random.default_rng(0)
successes = 0
for episode in range(1000):
    state, _ = env.reset(seed=episode)
    done = False
    while not done:
        state, reward, terminated, truncated, _ = env.step(rng.integers(4))
        done = terminated or truncated
    successes += reward
print(f"A random agent reached the goal in {successes:.0f} of 1000 episodes")

# %% [markdown]
# ## 2. One update by hand (7 minutes)
#
# The agent keeps a table Q with a row for each state and a column for each action. Q(s, a) shall become the discounted
# return that follows when it does a in s, and the best it can from then on. At first all entries are 0.
#
# After every step from s with action a to s′ with reward r, Q-learning (Watkins, 1989) moves one entry towards a
# *target*:
#
# $$Q(s, a) \leftarrow Q(s, a) + \mu \, \bigl(\underbrace{r + \gamma \max_{a'} Q(s', a')}_{\text{target}} - Q(s, a)\bigr)$$
#
# The difference in brackets is the *temporal-difference error*, and μ is the *step size*, between 0 and 1. Where the
# episode ends, the target is r alone.

# %%
gamma, mu = 0.99, 0.5
Q = np.zeros((16, 4))

# From state 14 (left of the goal) the action "right" (2) reaches the goal: reward 1, the episode ends.
Q[14, 2] += mu * (1.0 - Q[14, 2])
print("after the first success: Q(14, right) =", Q[14, 2])

# In another episode, from state 13 the action "right" leads to state 14: reward 0, the episode goes on.
Q[13, 2] += mu * (0.0 + gamma * Q[14].max() - Q[13, 2])
print("after a step from 13 to 14: Q(13, right) =", Q[13, 2])

# %% [markdown]
# **Q1.** The agent succeeds once more from state 14 with "right". What is Q(14, right) then? And after a step with
# "right" from 14 that slips back to 14?

# %% [markdown]
# ## 3. The whole algorithm (8 minutes)
#
# One part is missing: which action to take. *ε-greedy* takes a random one with probability ε, and the best one of the
# table otherwise. Here ε falls from 1 to 0.05, so the agent explores first and uses what it knows later.


# %%
def q_learning(n_steps, mu, gamma, seed):
    rng = np.random.default_rng(seed)
    Q = np.zeros((16, 4))
    state, _ = env.reset(seed=seed)
    for step in range(n_steps):
        epsilon = 1.0 - 0.95 * step / n_steps
        action = rng.integers(4) if rng.random() < epsilon else int(Q[state].argmax())
        next_state, reward, terminated, truncated, _ = env.step(action)
        target = reward + (0.0 if terminated else gamma * Q[next_state].max())
        Q[state, action] += mu * (target - Q[state, action])
        state = env.reset()[0] if terminated or truncated else next_state
    return Q


Q = q_learning(100_000, mu=0.05, gamma=0.99, seed=0)
print(Q.round(2))

# %% [markdown]
# Is that a good policy? We know the probabilities of the lake, so we need not play: *dynamic programming* computes
# exactly how often a policy reaches the goal within 100 steps, and how often the best policy does.

# %%
print(f"this table's greedy policy: {expected_return(env, greedy_policy(Q), horizon=100):.1%}")
print(f"the best policy:            {optimal_return(env, horizon=100):.1%}")

# %% [markdown]
# **Q2.** Some rows of the table are still 0. Which states are these, and why?
#
# **Q3.** The target uses the *best* action of the next state, though the agent often took another one. What does the
# table then describe: what the agent does, or what it could do?

# %% [markdown]
# ## 4. The same with a library, and a picture (5 minutes)
#
# `TabularQ` is the same algorithm behind the interface of Stable-Baselines3, which you will meet again with neural
# networks. (`"MlpPolicy"` is the name of the usual policy there. Here it is the table.) The arrows of the picture are
# the greedy actions, the numbers their values.

# %%
model = TabularQ("MlpPolicy", "FrozenLake-v1", learning_rate=0.05, gamma=0.99, seed=0)
model.learn(100_000)
plot_policy(model)
plt.show()
print(f"the greedy policy reaches the goal in {expected_return(env, greedy_policy(model.q_table), horizon=100):.1%}")

# %% [markdown]
# The same table as a pandas DataFrame:

# %%
print(to_frame(model).round(2).to_string(index=False))

# %% [markdown]
# And this is what a perfect table would look like:

# %%
best = action_values(env, value_iteration(env, 0.99), 0.99)
plot_policy(best, env)
plt.show()

# %% [markdown]
# **Q4.** In the top left corner, the best action is "left", against the wall. Why?

# %% [markdown]
# ## 5. What the step size does (8 minutes)
#
# One run says little: another seed gives another table. So we let fifty agents learn, ten with each of five step sizes.
# They all act at random, so that they see the same kind of data. `CompiledVecEnv` compiles the environment, and
# `learn_many` trains the agents at the same time: fifty runs of 50 000 steps take about a second.

# %%
STEP_SIZES, RUNS = (0.001, 0.01, 0.05, 0.2, 0.8), 10


def make_model(step_size, seed):
    lake = make_vec_env("FrozenLake-v1", vec_env_cls=CompiledVecEnv)
    return TabularQ("MlpPolicy", lake, learning_rate=step_size, gamma=0.99, exploration_final_eps=1.0, seed=seed)


models = [make_model(step_size, seed) for step_size in STEP_SIZES for seed in range(RUNS)]
for steps, marker in ((50_000, "x"), (500_000, "o")):
    learn_many(models, steps, log_interval=None)
    values = np.array([model.q_table[0].max() for model in models]).reshape(len(STEP_SIZES), RUNS)
    plt.plot(range(len(STEP_SIZES)), values, marker, color="black", markerfacecolor="none")
    print(f"after {steps} steps, spread within a step size:", values.std(axis=1).round(3))
plt.axhline(best[0].max(), color="gray", linestyle="--")
plt.xticks(range(len(STEP_SIZES)), STEP_SIZES)
plt.xlabel("step size μ")
plt.ylabel("learned value of the start state")
plt.title("crosses: 50 000 steps, circles: 500 000 steps, dashed: true value", loc="left", fontsize="medium")
plt.show()

# %% [markdown]
# A small μ has hardly moved after 50 000 steps. A large μ moves at once and never settles: each entry follows the last
# few targets, and these are random. The entries that happen to be too high are the ones that the maximum in the target
# picks, so that a large μ also *overestimates*.
#
# **Q5.** On ice that is not slippery, which μ would be best?
#
# **Q6.** Suggest a μ that changes in the course of learning.

# %% [markdown]
# ## 6. Step sizes that change (6 minutes)
#
# Robbins and Monro (1951) say: μ must fall, but not too fast, for instance as 1 / N(s, a)^0.8, where N(s, a) counts the
# updates of an entry. That is `"polynomial"`. Others let μ follow the errors: `"autostep"` (Mahmood, Sutton, Degris and
# Pilarski, 2012) keeps a step size of its own for every entry and makes it larger where the errors of successive steps
# agree in sign.
#
# We compare them with a constant μ over ten runs each. The shaded area is a 95 % bootstrap interval: the range in which
# the mean of many more runs probably lies.


# %%
def episodes_of(method, method_kwargs, seed):
    lake = make_vec_env("FrozenLake-v1", vec_env_cls=CompiledVecEnv)
    model = TabularQ(
        "MlpPolicy", lake, method=method, method_kwargs=method_kwargs, gamma=0.99, exploration_fraction=0.5, seed=seed
    )
    episodes = EpisodeSeriesCallback()
    model.learn(200_000, callback=episodes)
    return episodes


candidates = {
    "constant μ = 0.05": ("constant", {"alpha": 0.05}),
    "1 / N(s, a)^0.8": ("polynomial", {"omega": 0.8}),
    "autostep": ("autostep", None),
}
runs = {label: [episodes_of(*choice, seed) for seed in range(10)] for label, choice in candidates.items()}
plot_learning_curves(runs, window=500, against="timesteps")
plt.show()

# %% [markdown]
# **Q7.** The curves stay below the success of the best policy. Give two reasons.
#
# **Q8.** Two intervals overlap. May you say that the two methods are equally good?

# %% [markdown]
# ## 7. What if the agent will go on exploring? (6 minutes)
#
# On the cliff, every step costs 1 and a fall costs 100. Q-learning learns the shortest way, along the edge. SARSA uses
# the action that the agent *takes* next in its target, instead of the best one, and so learns the values of an agent
# that explores.

# %%
returns = {}
figure, axes = plt.subplots(2, 1, figsize=(9, 7), layout="constrained")
for ax, (name, algorithm) in zip(axes, {"Q-learning": TabularQ, "SARSA": SARSA}.items(), strict=True):
    returns[name] = []
    for seed in range(20):
        cliff = make_vec_env("CliffWalkingLimited-v1", vec_env_cls=CompiledVecEnv)
        agent = algorithm(
            "MlpPolicy",
            cliff,
            learning_rate=0.1,
            gamma=1.0,
            exploration_initial_eps=0.1,
            exploration_final_eps=0.1,
            total_episodes=1000,
            seed=seed,
        )
        episodes = EpisodeSeriesCallback()
        agent.learn(200_000, callback=episodes)
        returns[name].append(episodes)
    plot_policy(agent, ax=ax)
    ax.set_title(name, loc="left")
plt.show()
plot_learning_curves(returns, window=50).set_ylim(-100, 0)
plt.show()

# %% [markdown]
# **Q9.** Which of the two policies would you take if the agent stops exploring after training?

# %% [markdown]
# ## Homework
#
# 1. Repeat section 6 on `"FrozenLake8x8-v1"` with ten times as many steps. Does the order of the methods stay the same?
# 2. Write a step size of your own (`examples/own_step_size.py` shows how) that beats the constant one in section 6.
#    Choose its parameters on seeds 0 to 9, and report the result on seeds 10 to 19. Why not on the same seeds?
# 3. Draw `plot_policy(model, what="memory:visits")` of a model that learned with `method="polynomial"`. Where has it
#    been, and where not?

# %% [markdown]
# ## Answers
#
# **Q1.** 0.5 + 0.5 · (1 − 0.5) = 0.75. After slipping back, the target is 0.99 · 0.75 = 0.7425, so 0.75 + 0.5 · (0.7425
# − 0.75) = 0.74625.
#
# **Q2.** The four holes and the goal: the episode has ended there, so no action is taken and no entry is updated.
#
# **Q3.** What it could do: the values of the best policy, whatever the agent does meanwhile. This is called
# *off-policy*.
#
# **Q4.** With "left" you stay, or slip down along the left edge. There you can always choose an action that cannot slip
# into a hole. It is slow and safe, and the discount factor of 0.99 makes slowness cheap.
#
# **Q5.** μ = 1: every target is exact as soon as the next state's values are, so there is no noise to average.
#
# **Q6.** Large first and small later, for each entry by itself: that is what section 6 does.
#
# **Q7.** The agent still explores with ε = 0.05 or more, and every point is a mean over the last 500 episodes, of which
# the first ones are older. (A third reason: the table may not be perfect.)
#
# **Q8.** No. The data do not tell them apart, which is not the same as being equal. More runs may tell.
#
# **Q9.** That of Q-learning: without exploration, the shortest way is the best one, -13. While the agent explores,
# SARSA earns more.
