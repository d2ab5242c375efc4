"""Who learns where: an algorithm with a method, in an environment, with settings."""

from typing import Any, NamedTuple

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecEnv

from sb3_adaptive_q import LearningRateCallback
from sb3_adaptive_q.experiments.environments import reused_vec_env
from sb3_adaptive_q.experiments.errors import DesignError
from sb3_adaptive_q.experiments.names import algorithm_class, make_method


class Learner(NamedTuple):
    """
    :param environment: an id, or the ``module:name`` of a function that makes an environment
    :param algorithm: a name, or the ``module:name`` of a class
    :param method: a number or a name, or the ``module:name`` of a class
    :param parameters: of the method, by name
    :param settings: arguments of the algorithm, by name
    """

    environment: str
    algorithm: str
    method: str
    parameters: dict[str, Any]
    settings: dict[str, Any]

    def names(self) -> tuple[str, str, str]:
        """
        :return: all in it that may be given as ``module:name``
        """
        return self.environment, self.algorithm, self.method

    def make(self, seed: int, env: VecEnv | None = None) -> tuple[BaseAlgorithm, LearningRateCallback]:
        """
        :param seed: of the agent and the environment
        :param env: the environment; ``None`` for the one that this thread keeps
        :return: a model that has learned nothing yet, and the callback to hand to ``learn``
        :raises DesignError: if a name is unknown, or an argument is refused
        """
        algorithm, callback = algorithm_class(self.algorithm), make_method(self.method, self.parameters)
        try:
            model = algorithm("MlpPolicy", env or reused_vec_env(self.environment), seed=seed, **self.settings)
        except DesignError:
            raise
        except (TypeError, ValueError) as error:
            raise DesignError(f"{self.algorithm} cannot be made in {self.environment}: {error}") from error
        model.set_logger(silent_logger())
        return model, callback


def silent_logger() -> Logger:
    """
    :return: a logger that writes nothing. Without it, SB3 makes a temporary folder at every ``learn``
    """
    return Logger(folder=None, output_formats=[])
