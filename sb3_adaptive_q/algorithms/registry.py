"""Every algorithm by the name that RL Zoo knows it by. A new one is a file in this folder and a line here."""

from sb3_adaptive_q.algorithms.double_q import DoubleQ
from sb3_adaptive_q.algorithms.expected_sarsa import ExpectedSARSA
from sb3_adaptive_q.algorithms.n_step import NStep
from sb3_adaptive_q.algorithms.q_lambda import QLambda
from sb3_adaptive_q.algorithms.q_learning import TabularQ
from sb3_adaptive_q.algorithms.sarsa import SARSA
from sb3_adaptive_q.algorithms.sarsa_lambda import SARSALambda
from sb3_adaptive_q.base import TabularAlgorithm

ALGORITHMS: dict[str, type[TabularAlgorithm]] = {
    "tabular_q": TabularQ,
    "sarsa": SARSA,
    "expected_sarsa": ExpectedSARSA,
    "double_q": DoubleQ,
    "sarsa_lambda": SARSALambda,
    "q_lambda": QLambda,
    "n_step": NStep,
}
