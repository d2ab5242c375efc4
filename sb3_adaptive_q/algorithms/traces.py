"""
Eligibility traces: a list of the pairs that are eligible, so that a step costs what these cost and not what the table costs.

Each environment has its own list, in four arrays behind the algorithm's table. ``places``, of shape (n_envs, n_states,
n_actions), says where in the list a pair stands, counted from 1, or 0. ``pairs``, of shape (n_envs, longest list, 2), holds
state and action of each; ``traces``, of the same shape, its trace and the step size of its last visit. ``n_pairs``, of shape
(n_envs,), is the length of the list.
"""

from collections.abc import Callable
from math import ceil, log
from typing import Any

import numpy as np

from sb3_adaptive_q.base import TabularAlgorithm
from sb3_adaptive_q.checks import NOT_NEGATIVE, RATE, Check, check_range, one_of
from sb3_adaptive_q.policies import check_memory


def accumulate(trace, size):
    """
    :param trace: E(s, a) before the visit
    :param size: unused
    :return: the accumulating trace after it
    """
    return trace + 1.0


def replace(trace, size):
    """
    :param trace: unused
    :param size: unused
    :return: the replacing trace after a visit (Singh and Sutton, 1996). Those of the other actions are not cleared
    """
    return 1.0


def mix(trace, size):
    """
    :param trace: E(s, a) before the visit
    :param size: the step size of the visit
    :return: the dutch trace after it (van Seijen and Sutton, 2014)
    """
    return (1.0 - size) * trace + 1.0


def mix_sizes(trace, size):
    """
    :param trace: E(s, a) before the visit, with the step size in it
    :param size: the step size of the visit
    :return: the dutch trace after it, with the step size in it, as true online SARSA(λ) has it
    """
    return trace + size * (1.0 - trace)


#: How a visit marks a pair, by the name of the constructor's argument ``trace``
MARKS = {"accumulating": accumulate, "replacing": replace, "dutch": mix}


def size_in_force(size, step):
    """
    :param size: the step size that an eligible pair had when it was visited last
    :param step: the update of the pair that is visited now
    :return: the step size of this update: where there is one for the whole training, that of every pair
    """
    return step.size


def size_at_visit(size, step):
    """
    :param size: the step size that an eligible pair had when it was visited last
    :param step: the update of the pair that is visited now
    :return: the former
    """
    return size


def size_in_trace(size, step):
    """
    :param size: the step size that an eligible pair had when it was visited last
    :param step: the update of the pair that is visited now
    :return: 1, for traces that have the step size in them
    """
    return 1.0


def visit(tables, env, t, size, mark):
    """
    Mark the pair that is visited, and put it on the list.

    :param tables: places, pairs, traces and the number of pairs from the second on
    :param env: the number of the environment
    :param t: the transition
    :param size: the step size of the visit
    :param mark: what the visit makes of the trace
    """
    places, pairs, traces, n_pairs = tables[1][env], tables[2][env], tables[3][env], tables[4]
    place = places[t.state, t.action]
    if place == 0:
        if n_pairs[env] == pairs.shape[0]:  # these traces are from a file, or from before λ or the threshold was changed
            forget(tables, env)
        n_pairs[env] += 1
        place = n_pairs[env]
        places[t.state, t.action] = place
        pairs[place - 1, 0], pairs[place - 1, 1], traces[place - 1, 0] = t.state, t.action, 0.0
    traces[place - 1, 0], traces[place - 1, 1] = mark(traces[place - 1, 0], size), size


def sweep(tables, env, step, size_of, error, factors):
    """
    Move the values of all eligible pairs, let their traces decay, and drop pairs whose trace is no longer above a threshold.

    :param tables: Q, places, pairs, traces and the number of pairs
    :param env: the number of the environment
    :param step: the update of the pair that is visited
    :param size_of: the step size of an eligible pair
    :param error: what the values are moved by, times step size and trace
    :param factors: what the traces are multiplied with before the values move, what afterwards, and the threshold
    """
    values, places, pairs, traces = tables[0], tables[1][env], tables[2][env], tables[3][env]
    before, after, threshold = factors
    n_pairs, i = tables[4][env], 0
    while i < n_pairs:
        state, action, trace = pairs[i, 0], pairs[i, 1], traces[i, 0] * before
        values[state, action] += size_of(traces[i, 1], step) * error * trace
        trace *= after
        if trace > threshold:
            traces[i, 0] = trace
            i += 1
            continue
        # The last pair of the list, which has not moved yet, takes the place
        n_pairs -= 1
        pairs[i, 0], pairs[i, 1] = pairs[n_pairs, 0], pairs[n_pairs, 1]
        traces[i, 0], traces[i, 1] = traces[n_pairs, 0], traces[n_pairs, 1]
        places[pairs[i, 0], pairs[i, 1]] = i + 1
        places[state, action] = 0
    tables[4][env] = n_pairs


def forget(tables, env):
    """
    Empty the list, at the end of an episode.

    :param tables: places, pairs, traces and the number of pairs from the second on
    :param env: the number of the environment
    """
    places, pairs = tables[1][env], tables[2][env]
    for i in range(tables[4][env]):
        places[pairs[i, 0], pairs[i, 1]] = 0
    tables[4][env] = 0


def longest_list(decay: float, threshold: float, n_entries: int) -> int:
    """
    :param decay: γλ
    :param threshold: the trace below which a pair is dropped
    :param n_entries: of the table
    :return: more pairs than can be eligible at a time
    """
    if decay == 0.0:
        return 1
    if decay == 1.0 or threshold == 0.0:
        return n_entries
    # A trace is at most 1 / (1 - γλ) after a visit, and falls by γλ with every step
    steps = log(min(threshold * (1.0 - decay), 1.0)) / log(decay)
    return min(ceil(steps) + 3, n_entries)


class TraceAlgorithm(TabularAlgorithm):
    """
    What the algorithms with eligibility traces share.

    :param policy: as in :class:`sb3_adaptive_q.TabularAlgorithm`, which also has the further parameters
    :param env: as there
    :param trace_decay: λ, from 0 to 1
    :param trace: how a visit marks a pair: ``"accumulating"``, ``"replacing"`` or ``"dutch"``
    :param trace_threshold: a pair is dropped when its trace has fallen to this; 0 keeps all of an episode
    """

    updates_one_entry = False

    def __init__(
        self, policy: Any, env: Any, *args: Any, trace_decay: float, trace: str, trace_threshold: float, **kwargs: Any
    ) -> None:
        self.trace_decay = trace_decay
        self.trace = trace
        self.trace_threshold = trace_threshold
        super().__init__(policy, env, *args, **kwargs)

    def argument_checks(self) -> dict[str, Check]:
        own = {"trace_decay": RATE, "trace": one_of(MARKS), "trace_threshold": NOT_NEGATIVE}
        return super().argument_checks() | own

    def _size_of(self) -> Callable[..., float]:
        """Which step size an eligible pair moves with: its own, where the method has one for each."""
        return size_at_visit if self._method is not None and self._method.has_memory else size_in_force

    def update_parameters(self) -> tuple[float, ...]:
        return self.trace_decay, self.trace_threshold

    def working_arrays(self, n_envs: int, n_states: int, n_actions: int) -> dict[str, np.ndarray]:
        longest = longest_list(self.gamma * self.trace_decay, self.trace_threshold, n_states * n_actions)
        places, pairs = (n_envs, n_states, n_actions), (n_envs, longest, 2)
        advice = "use a larger `trace_threshold`, fewer environments or fewer cells"
        check_memory({"places": places, "pairs": pairs, "traces": pairs}, advice)
        return {
            "places": np.zeros(places, np.int64),
            "pairs": np.zeros(pairs, np.int64),
            "traces": np.zeros(pairs),
            "n_pairs": np.zeros(n_envs, np.int64),
        }

    def check_working_arrays(self, arrays: dict[str, np.ndarray]) -> None:
        super().check_working_arrays(arrays)
        longest = arrays["pairs"].shape[1]
        check_range("n_pairs", arrays["n_pairs"], longest + 1)
        known = np.zeros_like(arrays["places"])
        for env, n_pairs in enumerate(arrays["n_pairs"].tolist()):
            states, actions = arrays["pairs"][env, :n_pairs].T
            check_range("pairs", states, known.shape[1])
            check_range("pairs", actions, known.shape[2])
            known[env, states, actions] = np.arange(1, n_pairs + 1)
            traces, sizes = arrays["traces"][env, :n_pairs].T
            if not ((traces >= 0.0) & np.isfinite(traces) & (sizes >= 0.0) & (sizes <= 1.0)).all():
                raise ValueError("`traces` must hold a number of at least 0 and a step size from 0 to 1 for each pair.")
        if (known != arrays["places"]).any() or np.count_nonzero(known) != arrays["n_pairs"].sum():
            raise ValueError("`places` must say where in the list of `pairs` each eligible pair stands, but does not.")
