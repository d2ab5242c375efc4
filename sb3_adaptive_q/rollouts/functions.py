"""The functions that a model's choices stand for, put together for a learning loop."""

from collections.abc import Callable
from typing import Any, NamedTuple

from sb3_adaptive_q.action_masks import make_masked
from sb3_adaptive_q.behaviour import BEHAVIOURS, SCHEDULES, WIDE, WIDE_BEHAVIOURS, Behaviour
from sb3_adaptive_q.compiled.loops import make_learn_one, make_update_loop


class Choices(NamedTuple):
    """
    What the machine code of a learning loop depends on, besides the environment.

    :param update: the algorithm's update
    :param size: forms the step size of this update
    :param rule: forms the scalar step size that the next update starts from
    :param behaviour: a key of ``BEHAVIOURS``
    :param exploration_schedule: a name in ``SCHEDULES``, or a plain function of the progress
    :param masked: whether the behaviour keeps to the actions that a mask allows
    :param n_actions: columns of the table
    :param chooses_before_update: whether the algorithm draws the next action from the table before the update
    """

    update: Callable[..., Any]
    size: Callable[..., Any]
    rule: Callable[..., float]
    behaviour: tuple[str, str]
    exploration_schedule: str | Callable[[float], float]
    masked: bool
    n_actions: int
    chooses_before_update: bool

    def learn_one(self) -> Callable[..., Any]:
        """
        :return: the function that learns from one transition
        """
        explore = make_explore(self.behaviour, self.exploration_schedule)
        return make_learn_one(self.update, self.size, self.rule, self.functions_of_behaviour(), explore)

    def update_loop(self) -> Callable[..., Any]:
        """
        :return: the function that learns from one transition of an ordinary environment
        """
        return make_update_loop(self.learn_one(), self.functions_of_behaviour().show, self.chooses_before_update)

    def functions_of_behaviour(self) -> Behaviour:
        """
        :return: what the behaviour policy is made of
        """
        behaviour = (WIDE_BEHAVIOURS if self.n_actions >= WIDE else BEHAVIOURS)[self.behaviour]
        return make_masked(behaviour) if self.masked else behaviour


def make_explore(behaviour: tuple[str, str], schedule: str | Callable[[float], float]) -> Callable[..., float]:
    """
    :param behaviour: a key of ``BEHAVIOURS``
    :param schedule: a name in ``SCHEDULES``, or a plain function of the progress
    :return: a function of what a training holds fixed and of the progress; it gives -1 for what is out of range
    """
    if not callable(schedule):
        by_name = SCHEDULES[schedule]

        def explore(fixed, progress):
            return by_name(
                progress, fixed.exploration_initial, fixed.exploration_final, fixed.exploration_fraction
            )  # fmt: skip

        return explore
    of_progress, is_temperature = schedule, behaviour[0] == "boltzmann"

    def explore_freely(fixed, progress):
        rate = float(of_progress(progress))
        fits = 0.0 < rate if is_temperature else 0.0 <= rate <= 1.0
        return rate if fits else -1.0

    return explore_freely
