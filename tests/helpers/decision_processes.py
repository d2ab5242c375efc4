"""Small decision processes for hypothesis, and dynamic programming on dense matrices to compare with."""

import numpy as np
from hypothesis import strategies as st

Table = dict[int, dict[int, list[tuple[float, int, float, bool]]]]


@st.composite
def processes(draw, continuing=False):
    """A table of up to five states and three actions, and a start distribution; some outcomes end the episode."""
    n_states, n_actions = draw(st.integers(1, 5)), draw(st.integers(1, 3))
    outcome = st.tuples(
        st.integers(1, 5),
        st.integers(0, n_states - 1),
        st.integers(-8, 8).map(lambda number: number / 4),
        st.just(False) if continuing else st.booleans(),
    )

    def row():
        outcomes = draw(st.lists(outcome, min_size=1, max_size=3))
        total = sum(weight for weight, *_ in outcomes)
        return [(weight / total, *rest) for weight, *rest in outcomes]

    table = {state: {action: row() for action in range(n_actions)} for state in range(n_states)}
    weights = draw(st.lists(st.integers(0, 3), min_size=n_states, max_size=n_states).filter(any))
    return table, [weight / sum(weights) for weight in weights]


@st.composite
def policies(draw, table):
    """Probabilities of the actions, some of them 0, of shape (n_states, n_actions)."""
    rows = st.lists(st.integers(0, 3), min_size=len(table[0]), max_size=len(table[0])).filter(any)
    weights = np.array([draw(rows) for _ in table], float)
    return weights / weights.sum(axis=1, keepdims=True)


def matrices(table: Table) -> tuple[np.ndarray, np.ndarray]:
    """
    :return: the probabilities to go on in each state, of shape (n_states, n_actions, n_states), and the mean rewards
    """
    shape = (len(table), len(table[0]))
    transitions, rewards = np.zeros((*shape, len(table))), np.zeros(shape)
    for state, row in table.items():
        for action, outcomes in row.items():
            for probability, next_state, reward, terminated in outcomes:
                rewards[state, action] += probability * reward
                transitions[state, action, next_state] += 0.0 if terminated else probability
    return transitions, rewards


def under(table: Table, policy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    :param policy: probabilities of the actions
    :return: the probabilities to go on in each state, of shape (n_states, n_states), and the mean rewards
    """
    transitions, rewards = matrices(table)
    return np.einsum("sa,sat->st", policy, transitions), (policy * rewards).sum(axis=1)


def solved(table: Table, policy: np.ndarray, gamma: float) -> np.ndarray:
    """
    :return: the values of a policy by the linear equations v = r + gamma P v
    """
    transitions, rewards = under(table, policy)
    return np.linalg.solve(np.eye(len(table)) - gamma * transitions, rewards)
