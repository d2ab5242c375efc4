"""What an algorithm is made of: its update, and the tables, arrays and numbers that the update works with."""

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from sb3_adaptive_q.checks import CONSTRUCTOR, Check


class AlgorithmDeclaration:
    """
    The part of :class:`sb3_adaptive_q.TabularAlgorithm` that a subclass fills in. Only :attr:`update` has to be given; the
    rest has defaults that suit an update of one entry of one table.
    """

    #: The update, a plain function
    update: ClassVar[Callable[..., Any]]
    #: How many tables the step size has memory for
    n_tables: ClassVar[int] = 1
    #: Whether an update changes one entry of ``q_table`` and nothing else, so that a refused one can be taken back
    updates_one_entry: ClassVar[bool] = True
    #: Whether the next action is drawn from the table before the update: ``was_exploratory`` then looks at that table
    chooses_before_update: ClassVar[bool] = False

    def update_function(self) -> Callable[..., Any]:
        """
        :return: the update, where arguments of the constructor decide between several functions
        """
        return self.update

    def extra_tables(self, n_states: int, n_actions: int) -> dict[str, tuple[int, ...]]:
        """
        :param n_states: rows of the table
        :param n_actions: columns of the table
        :return: the shapes of further tables by name. They are float64, start from ``initial_q``, and are saved
        """
        return {}

    def working_arrays(self, n_envs: int, n_states: int, n_actions: int) -> dict[str, np.ndarray]:
        """
        :param n_envs: the number of environments
        :param n_states: rows of the table
        :param n_actions: columns of the table
        :return: arrays that the update works with in the course of episodes, such as traces, by name
        """
        return {}

    def check_working_arrays(self, arrays: dict[str, np.ndarray]) -> None:
        """
        Check arrays that were read from a file, whose numbers machine code looks up without a check.

        :param arrays: of the names, shapes and types of :meth:`working_arrays`
        :raises ValueError: if the update cannot go on with them
        """

    def update_parameters(self) -> tuple[float, ...]:
        """
        :return: the numbers that the update finds in ``agent.parameters``, such as λ
        """
        return ()

    def argument_checks(self) -> dict[str, Check]:
        """
        :return: what each argument of the constructor has to be, by its name; a subclass adds its own
        """
        return dict(CONSTRUCTOR)
