"""The measure of the paper's study: every episode of one run, and the table that was learned."""

from collections.abc import Mapping
from typing import Any

from sb3_adaptive_q import EpisodeSeriesCallback
from sb3_adaptive_q.checks import MOST_STEPS
from sb3_adaptive_q.experiments.learners import Learner

#: The episodes over which the paper's avg_100 is taken
WINDOW = 100
#: A run in numbers, and its series: lists of an entry per episode, the table row by row
NUMBERS = ("seed", "episodes", "steps", "last_return", "mean_last_100")
SERIES = ("returns", "lengths", "mu", "epsilon", "q_table", "n_actions")


def measure_episodes(recipe: Mapping[str, Any]) -> dict[str, list[Any]]:
    """
    Train once.

    :param recipe: ``learner``, ``seed`` and ``steps``; the learner's settings may hold ``total_episodes``
    :return: one row with the columns ``NUMBERS`` and ``SERIES``
    :raises ValueError: if no episode ended
    """
    model, method = Learner(**recipe["learner"]).make(recipe["seed"])
    series = EpisodeSeriesCallback()
    model.learn(recipe["steps"] or MOST_STEPS, callback=[method, series], log_interval=None)  # type: ignore[arg-type]
    # They hold the model and the callback itself, and would keep both until the garbage collector comes by
    series.locals.clear()
    if not len(series.returns):
        raise ValueError("No episode ended: please give it more steps.")
    q_table = model.q_table  # type: ignore[attr-defined]
    returns, lengths = series.returns, series.lengths
    numbers = (recipe["seed"], len(returns), int(lengths.sum()), returns[-1], returns[-WINDOW:].mean())
    arrays = (returns, lengths, series.rates, series.epsilons, q_table.ravel(), q_table.shape[1])
    return {name: [value] for name, value in zip((*NUMBERS, *SERIES), (*numbers, *arrays), strict=True)}
