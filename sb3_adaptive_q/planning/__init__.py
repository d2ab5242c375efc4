"""
Dynamic programming on transition tables: optimal values, exact returns of policies, and what the environments' best is.

Every function takes an environment with a table, as gymnasium's toy-text environments have it, the pair of ``P`` and the
start distribution, or a :class:`TabularModel`. To evaluate many policies, make the model once: reading a table takes longer
than evaluating a policy.
"""

from sb3_adaptive_q.planning.evaluation import (
    average_reward,
    expected_return,
    optimal_return,
    policy_evaluation,
    value_iteration,
)
from sb3_adaptive_q.planning.policies import (
    SoftOptimum,
    action_values,
    epsilon_greedy_optimum,
    epsilon_greedy_policy,
    greedy_policy,
    optimal_policy,
    uniform_policy,
)
from sb3_adaptive_q.planning.references import Reference, reference
from sb3_adaptive_q.envs.tabular_model import TabularModel

__all__ = [
    "Reference",
    "SoftOptimum",
    "TabularModel",
    "action_values",
    "average_reward",
    "epsilon_greedy_optimum",
    "epsilon_greedy_policy",
    "expected_return",
    "greedy_policy",
    "optimal_policy",
    "optimal_return",
    "policy_evaluation",
    "reference",
    "uniform_policy",
    "value_iteration",
]
