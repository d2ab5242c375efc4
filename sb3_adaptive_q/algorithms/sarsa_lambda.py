"""SARSA(λ) (Rummery and Niranjan, 1994), and true online SARSA(λ) (van Seijen et al., 2016)."""

from collections.abc import Callable
from typing import Any

import numpy as np

from sb3_adaptive_q.algorithms.td_update import is_sound, value_for_rule
from sb3_adaptive_q.algorithms.traces import MARKS, TraceAlgorithm, forget, mix_sizes, size_in_trace, sweep, visit
from sb3_adaptive_q.checks import FLAG, Check


def make_sarsa_lambda(mark: Callable[..., float], size_of: Callable[..., float]) -> Callable[..., Any]:
    """
    :param mark: what a visit makes of a trace, one of ``MARKS``
    :param size_of: the step size that an eligible pair moves with
    :return: the update of SARSA(λ): mark the pair, move all that are eligible, let the traces decay. Its tables are Q and
        those of :mod:`sb3_adaptive_q.algorithms.traces`. The next action is drawn from the table before the update
    """

    def sarsa_lambda(tables, agent, size, choose, expect, best, memory, draws, t):
        action, next_value, value = 0, 0.0, tables[0][t.state, t.action]
        if not t.terminated:
            action = choose(tables, t.next_state, agent.epsilon, draws)
            next_value = tables[0][t.next_state, action]
        seen = value_for_rule(tables, agent, best, t, action)
        step = size(memory, agent, t, value, next_value, t.reward + agent.gamma * next_value - value)
        if is_sound(step):
            trace_decay, threshold = agent.parameters
            visit(tables, agent.env, t, step.size, mark)
            sweep(tables, agent.env, step, size_of, step.td_error, (1.0, agent.gamma * trace_decay, threshold))
            if t.done:
                forget(tables, agent.env)
        return action, step, seen

    return sarsa_lambda


def true_online_sarsa_lambda(tables, agent, size, choose, expect, best, memory, draws, t):
    """
    Van Seijen et al. (2016), with the step sizes inside the traces, where they may differ between pairs and steps. The next
    action is drawn from the table before the update.

    :param tables: Q, those of :mod:`sb3_adaptive_q.algorithms.traces`, and for each environment the value of the next state
        and action at the last update, of shape (n_envs,)
    :param agent: the numbers of the moment
    :param size: forms the step size
    :param choose: the behaviour policy
    :param expect: unused
    :param best: the best action in a state, and its value
    :param memory: of the step size
    :param draws: the agent's counter
    :param t: the transition
    :return: the next action, the update, and Q_t(s', a) for the rule
    """
    action, next_value, value = 0, 0.0, tables[0][t.state, t.action]
    if not t.terminated:
        action = choose(tables, t.next_state, agent.epsilon, draws)
        next_value = tables[0][t.next_state, action]
    seen = value_for_rule(tables, agent, best, t, action)
    step = size(memory, agent, t, value, next_value, t.reward + agent.gamma * next_value - value)
    if is_sound(step):
        trace_decay, threshold = agent.parameters
        old_values, env = tables[5], agent.env
        change = value - old_values[env]
        visit(tables, env, t, step.size, mix_sizes)
        sweep(tables, env, step, size_in_trace, step.td_error + change, (1.0, agent.gamma * trace_decay, threshold))
        tables[0][t.state, t.action] -= step.size * change
        old_values[env] = next_value
        if t.done:
            forget(tables, env)
            old_values[env] = 0.0
    return action, step, seen


class SARSALambda(TraceAlgorithm):
    """
    SARSA with eligibility traces (Rummery and Niranjan, 1994; Singh and Sutton, 1996; van Seijen et al., 2016).

    With every transition all eligible pairs move: with the μ in force, or, with a method that has a step size for each entry,
    with the one of their own last visit. The memory of the method sees the one-step temporal-difference error.

    Before each update the agent draws its next action; at a truncation it draws one too, but does not take it. At the end of
    an episode it draws the first action of the next episode, after the update.

    :param policy: as in :class:`sb3_adaptive_q.TabularAlgorithm`, which also has the further parameters
    :param env: as there
    :param trace_decay: λ, from 0 to 1
    :param trace: how a visit marks a pair: ``"accumulating"``, ``"replacing"`` or ``"dutch"``; ``None`` for dutch traces with
        ``true_online``, else accumulating ones
    :param true_online: whether to learn exactly as the online λ-return algorithm does, which needs dutch traces
    :param trace_threshold: a pair is dropped when its trace has fallen to this; 0 keeps all of an episode. With
        ``true_online`` the step size is part of the trace
    :raises ValueError: if an argument lies outside its range
    :raises MemoryError: by ``learn``, if the traces would not fit into the memory that is free
    """

    chooses_before_update = True

    def __init__(
        self, policy: Any, env: Any, *args: Any, trace_decay: float = 0.9, trace: str | None = None,
        true_online: bool = False, trace_threshold: float = 1e-8, **kwargs: Any,
    ) -> None:  # fmt: skip
        self.true_online = true_online
        trace = trace or ("dutch" if true_online else "accumulating")
        super().__init__(policy, env, *args, trace_decay=trace_decay, trace=trace, trace_threshold=trace_threshold, **kwargs)

    def argument_checks(self) -> dict[str, Check]:
        return super().argument_checks() | {"true_online": FLAG}

    def _check_arguments(self) -> None:
        super()._check_arguments()
        if self.true_online and self.trace != "dutch":
            raise ValueError(f"`true_online=True` needs `trace='dutch'`, but got {self.trace!r}.")

    def update_function(self) -> Callable[..., Any]:
        return true_online_sarsa_lambda if self.true_online else make_sarsa_lambda(MARKS[self.trace], self._size_of())

    def working_arrays(self, n_envs: int, n_states: int, n_actions: int) -> dict[str, np.ndarray]:
        arrays = super().working_arrays(n_envs, n_states, n_actions)
        return {**arrays, "old_values": np.zeros(n_envs)} if self.true_online else arrays
