"""
The table of ``docs/benchmark.md``: every algorithm in five environments, beside the best that a policy can reach.

``python -m sb3_adaptive_q.experiments.benchmark`` makes it anew, with RL Zoo's hyperparameters for these environments.
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import yaml
from rl_zoo3 import get_wrapper_class
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv
from tqdm import tqdm

from sb3_adaptive_q import ALGORITHMS, CompiledVecEnv, EpisodeSeriesCallback, TabularAlgorithm, TabularQ, learn_many
from sb3_adaptive_q.checks import whole_number
from sb3_adaptive_q.experiments.design import check_options
from sb3_adaptive_q.experiments.errors import DesignError
from sb3_adaptive_q.experiments.options import parse, report_errors
from sb3_adaptive_q.experiments.statistics import bootstrap, interval, mean
from sb3_adaptive_q.experiments.text import format_estimate, markdown_table
from sb3_adaptive_q.planning import Reference, epsilon_greedy_optimum, optimal_policy, reference
from sb3_adaptive_q.zoo import CONFIG

COMMAND = "python -m sb3_adaptive_q.experiments.benchmark"
ENVIRONMENTS = ("FrozenLake-v1", "FrozenLake8x8-v1", "Taxi-v4", "CliffWalkingLimited-v1", "CartPole-v1")
#: Episodes that judge a greedy policy where there is no transition table, and the seed of their environment
N_EPISODES, EPISODES_SEED = 100, 20_000
#: Bootstrap samples of an interval
RESAMPLES = 10_000
#: The exploration rate that a training ends with, by default
FINAL_EPSILON = 0.05
TEXT = """# Benchmark

Every algorithm in five environments, with the hyperparameters that `python train.py` uses for them, and the defaults of
the algorithm otherwise. Numbers are the mean return of the greedy policy after training: the mean of {runs} seeds, with its
95 % bootstrap interval in brackets. The returns are exact, by policy evaluation on the transition table within the limit of
steps; only those of Cart Pole, which has no table, are the mean of {episodes} episodes.

{command}

This command makes this page again in about a minute on two cores. The first time takes longer, because it compiles the
functions.

{table}

- **Optimum**: the best that any policy can do within the limit of steps, by dynamic programming. It may count the steps
  that are left, which the policy of a table cannot. In Cart Pole it is the limit of 500 steps, an upper bound.
- **Optimal for γ = {gamma}**: the policy that is optimal without a limit of steps and with the discount factor of the
  training. This is what Q-learning learns.
- **Best with ε = {epsilon}**: the greedy actions of the best policy that takes a random action with the probability
  {epsilon}, the exploration rate at the end of the training. SARSA and its relatives tend to the values of this policy,
  from those of more exploration: at the cliff they keep away from the edge.

Double Expected SARSA is `DoubleQ` with `target="expected"`, SARSA(0.9) is `SARSALambda` and Watkins's Q(0.9) is `QLambda`,
both with λ = 0.9, and 4-step SARSA is `NStep`.

All algorithms have the same step size, although traces and returns of many steps want a smaller one than returns of one
step. So the table says that the algorithms work, and not which of them is best: for that, each would have to be tuned
(`python train.py --algo sarsa_lambda --optimize`).
"""


class Contestant(NamedTuple):
    """
    :param title: what the table calls it
    :param algorithm: its name in the registry
    :param arguments: what differs from its defaults
    """

    title: str
    algorithm: str
    arguments: dict[str, Any] = {}  # noqa: RUF012


CONTESTANTS = (
    Contestant("Q-learning", "tabular_q"),
    Contestant("SARSA", "sarsa"),
    Contestant("Expected SARSA", "expected_sarsa"),
    Contestant("Double Q-learning", "double_q"),
    Contestant("Double Expected SARSA", "double_q", {"target": "expected"}),
    Contestant("SARSA(0.9)", "sarsa_lambda"),
    Contestant("Watkins's Q(0.9)", "q_lambda"),
    Contestant("4-step SARSA", "n_step"),
)


class Task(NamedTuple):
    """
    An environment and how it is learned.

    :param env_id: its id
    :param n_timesteps: the steps of a training
    :param wrapper: a function that wraps the environment; ``None`` for none
    :param arguments: of the algorithm
    """

    env_id: str
    n_timesteps: int
    wrapper: Any
    arguments: dict[str, Any]

    @classmethod
    def of(cls, env_id: str) -> "Task":
        """
        :param env_id: an environment of RL Zoo's file
        :return: what the file says of it
        """
        entry = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))[env_id]
        wrapper = get_wrapper_class(entry)
        others = {name: value for name, value in entry.items() if name not in ("n_timesteps", "policy", "env_wrapper")}
        return cls(env_id, int(entry["n_timesteps"]), wrapper, others)

    def make_vec_env(self) -> VecEnv:
        """
        :return: the environment, compiled
        """
        return make_vec_env(self.env_id, vec_env_cls=CompiledVecEnv, wrapper_class=self.wrapper)

    def scale(self) -> Reference | None:
        """
        :return: exact returns, where the environment has a transition table
        """
        env = gym.make(self.env_id)
        return reference(env, gamma=self.arguments["gamma"]) if hasattr(env.unwrapped, "P") else None


def run(contestant: Contestant, task: Task, n_seeds: int) -> np.ndarray:
    """
    Learn with several seeds, on all cores.

    :param contestant: who learns
    :param task: where
    :param n_seeds: from 0 on
    :return: the mean return of the greedy policy for each seed, of shape (n_seeds,)
    """
    algorithm, arguments = ALGORITHMS[contestant.algorithm], task.arguments | contestant.arguments
    models = [algorithm("MlpPolicy", task.make_vec_env(), seed=seed, **arguments) for seed in range(n_seeds)]
    learn_many(models, task.n_timesteps, log_interval=None)
    scale = task.scale()
    if scale is not None:
        return np.array([scale.measure(model.q_table.argmax(axis=1)) for model in models])
    return np.array([play(model, task) for model in models])


def play(model: TabularAlgorithm, task: Task) -> float:
    """
    :param model: has learned
    :param task: the environment
    :return: the mean return of its greedy policy over episodes that begin alike for all models
    """
    still: dict[str, Any] = {"learning_rate": 0.0, "exploration_initial_eps": 0.0, "exploration_final_eps": 0.0}
    player = TabularQ(
        "MlpPolicy", task.make_vec_env(), ties="first", total_episodes=N_EPISODES, initial_q=model.q_table,
        seed=EPISODES_SEED, **still,
    )  # fmt: skip
    series = EpisodeSeriesCallback()
    player.learn(sys.maxsize // 4, callback=series, log_interval=None)
    return float(series.returns.mean())


def in_words(scores: np.ndarray) -> str:
    """
    :param scores: of independent runs, of shape (n_runs,)
    :return: their mean with its 95 % interval
    """
    runs = scores.reshape(1, -1, 1)
    found = interval(scores.mean(), bootstrap(runs, mean, RESAMPLES)[:, 0])
    return format_estimate(*found, decimals=_decimals(found.value))


def bounds(task: Task) -> tuple[str, str, str]:
    """
    :param task: the environment
    :return: what the best policies reach: within the limit of steps, with the discount factor, and with exploration
    """
    scale = task.scale()
    if scale is None:
        return str(gym.spec(task.env_id).max_episode_steps), "", ""
    soft = epsilon_greedy_optimum(scale.model, FINAL_EPSILON, scale.gamma)
    policies = optimal_policy(scale.model, scale.gamma), soft.actions
    optimal, exploring = (_number(scale.measure(policy)) for policy in policies)
    return _number(scale.optimal_return), optimal, exploring


def make_page(tasks: Sequence[Task], n_seeds: int) -> str:
    """
    :param tasks: the environments
    :param n_seeds: the runs of each algorithm in each of them
    :return: the page, as Markdown
    """
    gamma = f"{tasks[0].arguments['gamma']:g}"
    titles = ("**Optimum**", f"**Optimal for γ = {gamma}**", f"**Best with ε = {FINAL_EPSILON:g}**")
    rows = [[title, *values] for title, *values in zip(titles, *map(bounds, tasks), strict=True)]
    pairs = [(contestant, task) for contestant in CONTESTANTS for task in tasks]
    with tqdm(pairs, unit="cell") as bar:
        cells: Iterator[str] = iter([in_words(run(*pair, n_seeds)) for pair in bar])
    rows += [[contestant.title, *(next(cells) for _ in tasks)] for contestant in CONTESTANTS]
    steps = ["Steps of a training", *(f"{task.n_timesteps:,}".replace(",", " ") for task in tasks)]
    table = markdown_table(["", *(task.env_id for task in tasks)], [steps, *rows])
    return TEXT.format(
        runs=n_seeds, episodes=N_EPISODES, command=f"```sh\n{COMMAND}\n```", table=table, gamma=gamma,
        epsilon=f"{FINAL_EPSILON:g}",
    )  # fmt: skip


def _number(value: float) -> str:
    return f"{value:.{_decimals(value)}f}"


def _decimals(value: float) -> int:
    return 0 if abs(value) >= 100 else 2 if abs(value) >= 1 else 3


@dataclass(frozen=True)
class Options:
    """
    Let every algorithm learn in five environments, and write the page with the table.

    :param output: the page
    :param runs: seeds of each algorithm in each environment
    """

    output: Path = Path("docs/benchmark.md")
    runs: int = 10

    def __post_init__(self) -> None:
        check_options(self, {"runs": whole_number(2)})  # an interval needs two


def main(arguments: Sequence[str] | None = None) -> int:
    """
    :param arguments: of the command line; ``None`` for those of this process
    :return: the exit status
    """

    def benchmark() -> None:
        options = parse(Options, COMMAND, sys.argv[1:] if arguments is None else arguments)
        if options.output.is_dir() or not options.output.parent.is_dir():
            raise DesignError(f"{options.output} cannot be written: give --output a file in a folder that exists.")
        page = make_page([Task.of(env_id) for env_id in ENVIRONMENTS], options.runs)
        options.output.write_text(page, encoding="utf-8")
        print(f"The page is {options.output}.")

    return report_errors(benchmark)


if __name__ == "__main__":
    sys.exit(main())
