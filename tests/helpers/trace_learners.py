"""Algorithms with traces as the textbooks write them: whole arrays at every step, or the λ-returns themselves."""

from collections.abc import Iterator

import numpy as np
from helpers.golden import GoldenSequence, GoldenTransition


def episodes_of(sequence: GoldenSequence) -> Iterator[list[GoldenTransition]]:
    """The transitions of each episode, the last of which may be unfinished."""
    episode: list[GoldenTransition] = []
    for t in sequence.transitions:
        episode.append(t)
        if t.terminated or t.truncated:
            yield episode
            episode = []
    if episode:
        yield episode


def sizes_of_visits(sequence: GoldenSequence, constant: float | None) -> list[float]:
    """The step size of every transition: a constant, or one over the visits of the pair, this one included."""
    visits = np.zeros((sequence.n_states, sequence.n_actions))
    sizes = []
    for t in sequence.transitions:
        visits[t.state, t.action] += 1
        sizes.append(constant if constant is not None else 1.0 / float(visits[t.state, t.action]))
    return sizes


def sweep_everything(
    algorithm: str, trace: str, sequence: GoldenSequence, decay: float, constant: float | None, threshold: float,
    in_force: list[float] | None = None,
) -> list[np.ndarray]:  # fmt: skip
    """
    SARSA(λ) and Q(λ) with a trace for every entry of the table, all of which move at every step.

    :param algorithm: ``"sarsa"``, ``"watkins"``, ``"naive"`` or ``"peng"``
    :param trace: ``"accumulating"``, ``"replacing"`` or ``"dutch"``
    :param sequence: the transitions
    :param decay: λ
    :param constant: the step size of all; ``None`` for one over the visits of each pair
    :param threshold: a trace that has fallen to this is set to 0
    :param in_force: the step size of each transition, with which all pairs then move, in place of ``constant``
    :return: the table after every transition
    """
    shape, gamma = (sequence.n_states, sequence.n_actions), sequence.gamma
    q, traces, sizes, tables = np.zeros(shape), np.zeros(shape), np.zeros(shape), []
    for t, size in zip(sequence.transitions, in_force or sizes_of_visits(sequence, constant), strict=True):
        pair = t.state, t.action
        if in_force is not None:
            sizes[:] = size
        largest = 0.0 if t.terminated else q[t.next_state].max()
        next_value = 0.0 if t.terminated else q[t.next_state, t.next_action]
        cut = algorithm == "watkins" and next_value != largest
        target = t.reward + gamma * (next_value if algorithm == "sarsa" else largest)
        own = target - q[pair]
        if algorithm == "peng":
            error = target - q[t.state].max()
            traces *= gamma * decay
            q += sizes * error * traces
            traces[traces <= threshold] = 0.0
            q[pair] += size * own
        traces[pair] = {"accumulating": traces[pair] + 1, "replacing": 1, "dutch": (1 - size) * traces[pair] + 1}[trace]
        sizes[pair] = size
        if algorithm != "peng":
            q += sizes * own * traces
            traces *= 0.0 if cut else gamma * decay
            traces[traces <= threshold] = 0.0
        if t.terminated or t.truncated:
            traces[:] = 0.0
        tables.append(q.copy())
    return tables


def online_lambda_returns(sequence: GoldenSequence, decay: float, constant: float | None) -> list[np.ndarray]:
    """
    The online λ-return algorithm (van Seijen et al., 2016): at every step all updates of the episode are done again, with
    the λ-returns that are known by then.

    :param sequence: the transitions
    :param decay: λ
    :param constant: the step size of all; ``None`` for one over the visits of each pair
    :return: the table after every transition
    """
    q, tables = np.zeros((sequence.n_states, sequence.n_actions)), []
    sizes = iter(sizes_of_visits(sequence, constant))
    for episode in episodes_of(sequence):
        start, known_sizes, next_values = q, [], []
        for horizon, newest in enumerate(episode, 1):
            known_sizes.append(next(sizes))
            next_values.append(0.0 if newest.terminated else q[newest.next_state, newest.next_action])
            q = start.copy()
            for k in range(horizon):
                target = _lambda_return(episode[k:horizon], next_values[k:horizon], sequence.gamma, decay)
                pair = episode[k].state, episode[k].action
                q[pair] += known_sizes[k] * (target - q[pair])
            tables.append(q)
    return tables


def _lambda_return(seen: list[GoldenTransition], next_values: list[float], gamma: float, decay: float) -> float:
    """The mean of the n-step returns of the first transition, all the remaining weight on the longest."""
    rewards, mean = 0.0, 0.0
    for n, (t, next_value) in enumerate(zip(seen, next_values, strict=True), 1):
        rewards += gamma ** (n - 1) * t.reward
        weight = decay ** (n - 1) * (1.0 if n == len(seen) else 1.0 - decay)
        mean += weight * (rewards + gamma**n * next_value)
    return mean
