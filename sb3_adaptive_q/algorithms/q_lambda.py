"""Q(λ) in its three forms: Watkins's (1989), Peng's (Peng and Williams, 1996), and Watkins's without its cut."""

from collections.abc import Callable
from typing import Any

import numpy as np

from sb3_adaptive_q.algorithms.td_update import is_sound, keep_row, kept_value, value_for_rule
from sb3_adaptive_q.algorithms.traces import MARKS, TraceAlgorithm, forget, sweep, visit
from sb3_adaptive_q.checks import Check, one_of


def make_watkins(mark: Callable[..., float], size_of: Callable[..., float]) -> Callable[..., Any]:
    """
    :param mark: what a visit makes of a trace, one of ``MARKS``
    :param size_of: the step size that an eligible pair moves with
    :return: the update of Watkins's Q(λ) (1989): after the update the traces are cut where the next action is not greedy. The
        next action is drawn from the table before the update, by which it is also judged; all best actions are greedy
    """

    def watkins_q_lambda(tables, agent, size, choose, expect, best, memory, draws, t):
        action, best_value, value = 0, 0.0, tables[0][t.state, t.action]
        trace_decay, threshold = agent.parameters
        decay = agent.gamma * trace_decay
        if not t.terminated:
            action = choose(tables, t.next_state, agent.epsilon, draws)
            best_value = best(tables, tables[0], t.next_state)[1]
            if tables[0][t.next_state, action] != best_value:
                decay = 0.0
        seen = value_for_rule(tables, agent, best, t, action)
        step = size(memory, agent, t, value, best_value, t.reward + agent.gamma * best_value - value)
        if is_sound(step):
            visit(tables, agent.env, t, step.size, mark)
            sweep(tables, agent.env, step, size_of, step.td_error, (1.0, decay, threshold))
            if t.done:
                forget(tables, agent.env)
        return action, step, seen

    return watkins_q_lambda


def make_naive(mark: Callable[..., float], size_of: Callable[..., float]) -> Callable[..., Any]:
    """
    :param mark: what a visit makes of a trace, one of ``MARKS``
    :param size_of: the step size that an eligible pair moves with
    :return: the update of naive Q(λ): Watkins's without the cut. The next action is drawn from the table after the update
    """

    def naive_q_lambda(tables, agent, size, choose, expect, best, memory, draws, t):
        value, kept = tables[0][t.state, t.action], tables[5]
        trace_decay, threshold = agent.parameters
        best_value = 0.0 if t.terminated else best(tables, tables[0], t.next_state)[1]
        step = size(memory, agent, t, value, best_value, t.reward + agent.gamma * best_value - value)
        keep_row(kept, tables[0], t)
        if is_sound(step):
            visit(tables, agent.env, t, step.size, mark)
            sweep(tables, agent.env, step, size_of, step.td_error, (1.0, agent.gamma * trace_decay, threshold))
            if t.done:
                forget(tables, agent.env)
        action = 0 if t.terminated else choose(tables, t.next_state, agent.epsilon, draws)
        return action, step, kept_value(kept, agent, t, action, best_value)

    return naive_q_lambda


def make_peng(mark: Callable[..., float], size_of: Callable[..., float]) -> Callable[..., Any]:
    """
    :param mark: what a visit makes of a trace, one of ``MARKS``
    :param size_of: the step size that an eligible pair moves with
    :return: the update of Peng's Q(λ) (Peng and Williams, 1996, figure 1): the traces decay, the eligible pairs move by the
        error of max_a Q(s, a), the visited pair by its own, and is marked. The traces are never cut. The next action is drawn
        from the table after the update
    """

    def peng_q_lambda(tables, agent, size, choose, expect, best, memory, draws, t):
        value, kept = tables[0][t.state, t.action], tables[5]
        trace_decay, threshold = agent.parameters
        best_value = 0.0 if t.terminated else best(tables, tables[0], t.next_state)[1]
        target = t.reward + agent.gamma * best_value
        error = target - best(tables, tables[0], t.state)[1]
        step = size(memory, agent, t, value, best_value, target - value)
        keep_row(kept, tables[0], t)
        if is_sound(step):
            sweep(tables, agent.env, step, size_of, error, (agent.gamma * trace_decay, 1.0, threshold))
            tables[0][t.state, t.action] += step.size * step.td_error
            visit(tables, agent.env, t, step.size, mark)
            if t.done:
                forget(tables, agent.env)
        action = 0 if t.terminated else choose(tables, t.next_state, agent.epsilon, draws)
        return action, step, kept_value(kept, agent, t, action, best_value)

    return peng_q_lambda


#: The update by the name of the constructor's argument ``variant``
VARIANTS = {"watkins": make_watkins, "peng": make_peng, "naive": make_naive}


class QLambda(TraceAlgorithm):
    """
    Q-learning with eligibility traces, which three algorithms are called: Watkins's Q(λ) (1989), Peng's (Peng and Williams,
    1996), and the naive one, which other libraries offer as Watkins's although it does not cut the traces.

    With every transition all eligible pairs move: with the μ in force, or, with a method that has a step size for each entry,
    with the one of their own last visit. The memory of the method sees the one-step temporal-difference error. For Watkins's
    variant the agent draws, before each update, what its next action takes, at a truncation without taking it; for the others
    after each update. At the end of an episode it draws, after the update, what the first action of the next one takes.

    :param policy: as in :class:`sb3_adaptive_q.TabularAlgorithm`, which also has the further parameters
    :param env: as there
    :param variant: ``"watkins"``, ``"peng"`` or ``"naive"``
    :param trace_decay: λ, from 0 to 1
    :param trace: how a visit marks a pair: ``"accumulating"``, ``"replacing"`` or ``"dutch"``
    :param trace_threshold: a pair is dropped when its trace has fallen to this; 0 keeps all of an episode
    :raises ValueError: if an argument lies outside its range
    :raises MemoryError: by ``learn``, if the traces would not fit into the memory that is free
    """

    def __init__(
        self, policy: Any, env: Any, *args: Any, variant: str = "watkins", trace_decay: float = 0.9,
        trace: str = "accumulating", trace_threshold: float = 1e-8, **kwargs: Any,
    ) -> None:  # fmt: skip
        self.variant = variant
        super().__init__(policy, env, *args, trace_decay=trace_decay, trace=trace, trace_threshold=trace_threshold, **kwargs)

    @property
    def chooses_before_update(self) -> bool:  # type: ignore[override]
        return self.variant == "watkins"

    def argument_checks(self) -> dict[str, Check]:
        return super().argument_checks() | {"variant": one_of(VARIANTS)}

    def update_function(self) -> Callable[..., Any]:
        return VARIANTS[self.variant](MARKS[self.trace], self._size_of())

    def working_arrays(self, n_envs: int, n_states: int, n_actions: int) -> dict[str, np.ndarray]:
        arrays = super().working_arrays(n_envs, n_states, n_actions)
        # For the variants that choose after the update: the values of the next state before it
        return arrays if self.chooses_before_update else {**arrays, "next_values": np.zeros(n_actions)}
