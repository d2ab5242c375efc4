"""RL Zoo with the tabular algorithms: they are registered there, and its programs run with our defaults."""

import argparse
import json
import runpy
import shutil
import sys
from collections.abc import Callable
from functools import partial
from math import sqrt
from pathlib import Path
from statistics import fmean, stdev
from typing import Any
from urllib.parse import quote

import gymnasium as gym
import rl_zoo3.enjoy
import rl_zoo3.train
import yaml
from optuna.samplers import BaseSampler
from rl_zoo3.exp_manager import ExperimentManager
from rl_zoo3.hyperparams_opt import HYPERPARAMS_CONVERTER, HYPERPARAMS_SAMPLER
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import SubprocVecEnv, VecEnv

from sb3_adaptive_q import search_space
from sb3_adaptive_q.algorithms.registry import ALGORITHMS
from sb3_adaptive_q.callbacks import method as make_method
from sb3_adaptive_q.hyperparameters import tensorboard_outputs
from sb3_adaptive_q.output import locate, spell_out_what_cannot_be_written
from sb3_adaptive_q.step_sizes import STEP_SIZES
from sb3_adaptive_q.vec_env import CompiledVecEnv, LeanVecEnv
from sb3_adaptive_q.zoo_runs import FOLDER, plot_training, with_latest_model

ALGORITHM = "tabular_q"
#: The file of hyperparameters, unless ``-conf`` names another one
CONFIG = Path(__file__).parent / "hyperparams" / "tabular.yml"
VEC_ENVS = {"dummy": LeanVecEnv, "compiled": CompiledVecEnv, "subproc": SubprocVecEnv}
#: The first arguments of RL Zoo's programs. Those of the user follow and override them
DEFAULTS = ["--algo", ALGORITHM, "--env", "FrozenLake-v1"]
#: The greedy evaluation after the training. With a hundred episodes the standard error would be 0.05 on FrozenLake
N_EVALUATION_EPISODES = 500
N_EVALUATION_ENVS = 10
#: The limit of steps in evaluations, if the environment has none. A greedy policy may walk against a wall for ever
EVALUATION_LIMIT = 1000
#: Errors of a mistake in an argument that RL Zoo evaluates as Python
NOT_PYTHON = (NameError, SyntaxError)
#: Errors of a mistake on the command line or in the YAML file, while an experiment is set up
MISTAKES = (
    *NOT_PYTHON, ArithmeticError, AssertionError, AttributeError, ImportError, LookupError, OSError, TypeError, ValueError,
    gym.error.Error, yaml.YAMLError,
)  # fmt: skip


def register() -> None:
    """Make the tabular algorithms known to RL Zoo, with their search space for ``--optimize``."""
    for name, algorithm in ALGORITHMS.items():
        rl_zoo3.ALGOS[name] = algorithm
        HYPERPARAMS_SAMPLER[name] = partial(search_space.sample, algorithm=name)
        HYPERPARAMS_CONVERTER[name] = search_space.convert  # type: ignore[assignment]


def merge_method(hyperparams: dict[str, Any] | None, method: int | str | None) -> dict[str, Any]:
    """
    Let the method or learning rate of the command line replace those of the YAML file, with all their parameters.

    :param hyperparams: the value of ``-params``
    :param method: the value of ``--method``
    :return: the hyperparameters that override the YAML file's entry
    :raises ValueError: if both set the learning rate
    """
    merged = dict(hyperparams or {})
    rivals = sorted({"method", "learning_rate"} & set(merged))
    if method is not None and rivals:
        raise ValueError(f"--method {method} and -params {rivals[0]}:... both set the learning rate: give one of them.")
    if method is not None:
        merged["method"] = method
    if "method" in merged:
        merged.setdefault("method_kwargs", None)
    elif "learning_rate" in merged:
        merged.update(method=None, method_kwargs=None)
    return merged


class TabularExperiment(ExperimentManager):
    """
    An experiment of RL Zoo with our vectorised environments and hyperparameters, and a summary at the end.

    :param args: RL Zoo's part of the command line, which it saves beside the model
    :param algo: the key of the algorithm
    :param ours: our part of the command line, from :func:`parse_options`; ``started`` is set once all is built
    """

    def __init__(self, args: argparse.Namespace, algo: str, *arguments: Any, ours: argparse.Namespace, **options: Any) -> None:
        if algo in ALGORITHMS and options["config"] is None:
            options["config"] = str(CONFIG)
        if args.tensorboard_log and Path(args.tensorboard_log).is_file():
            raise NotADirectoryError(f"-tb must name a folder, but {args.tensorboard_log} is a file")
        super().__init__(args, algo, *arguments, **options)
        self.ours = ours
        self.resumed = False
        self.vec_env_class = VEC_ENVS[ours.vec_env]
        args.vec_env = ours.vec_env
        if algo in ALGORITHMS:
            args.hyperparams = self.custom_hyperparams = merge_method(self.custom_hyperparams, ours.method)

    def setup_experiment(self) -> tuple[BaseAlgorithm, dict[str, Any]] | None:
        """
        Read the hyperparameters, and build the environments and the model.

        :return: the model and the hyperparameters to save; ``None`` if these are to be optimised
        """
        results = super().setup_experiment()
        self.ours.started = True
        return results

    def read_hyperparameters(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """
        :return: as in RL Zoo
        :raises ValueError: if the YAML file has no entries by environment, or this one's lacks what a training needs
        """
        if self.algo in ALGORITHMS and not self.trial_id and Path(self.config).suffix in (".yml", ".yaml"):
            check_entry(self.config, self.env_name.gym_id, self.custom_hyperparams or {})
        return super().read_hyperparameters()

    def _load_pretrained_agent(self, hyperparams: dict[str, Any], env: VecEnv) -> BaseAlgorithm:
        """Load the model of ``-i``, and resume its training if it is unfinished and the command line changes nothing."""
        if self.algo in ALGORITHMS and not self.custom_hyperparams:
            model = ALGORITHMS[self.algo].resume(
                self.trained_agent, env, tensorboard_log=self.tensorboard_log, verbose=self.verbose
            )
            if model.remaining_timesteps > 0:
                print(f"Continuing the training of {self.trained_agent}: {model.remaining_timesteps} steps are left")
                self.resumed = True
                return model
        return super()._load_pretrained_agent(hyperparams, env)

    def learn(self, model: BaseAlgorithm) -> None:
        """
        Train, or continue the training that was resumed, to its end or until it is interrupted.

        :param model: the model
        """
        if not self.resumed:
            super().learn(model)
            return
        try:
            model.finish(self.callbacks)  # type: ignore[attr-defined]  # of a tabular algorithm
        except KeyboardInterrupt:
            pass  # the model is saved all the same, as in RL Zoo
        finally:
            for callback in self.callbacks[:1]:  # a progress bar, which is to be closed
                callback.on_training_end()
            assert model.env is not None
            model.env.close()

    def create_envs(self, n_envs: int, eval_env: bool = False, no_log: bool = False) -> VecEnv:
        """
        Make the environments of the training or of an evaluation. An evaluation gets the ``env_kwargs`` of the YAML file,
        which RL Zoo leaves out, and a limit of steps where the environment has none.

        :param n_envs: how many
        :param eval_env: whether they are for an evaluation
        :param no_log: whether to write no Monitor file
        :return: the environments
        """
        if eval_env and self._eval_env_kwargs_args is None:
            self.eval_env_kwargs = dict(self.env_kwargs)
        if eval_env and self._has_no_limit():
            self.eval_env_kwargs = {**self.eval_env_kwargs, "max_episode_steps": EVALUATION_LIMIT}
        return super().create_envs(n_envs, eval_env, no_log)

    def _has_no_limit(self) -> bool:
        given = {**self.env_kwargs, **(self._eval_env_kwargs_args or {})}
        return gym.spec(self.env_name.gym_id).max_episode_steps is None and "max_episode_steps" not in given

    def save_trained_model(self, model: BaseAlgorithm) -> None:
        """
        Save the model, and print a summary of the training.

        :param model: the trained model
        """
        super().save_trained_model(model)
        recent = [info["r"] for info in model.ep_info_buffer or ()]
        greedy = self._greedy_rewards(model)
        for output in tensorboard_outputs(model):
            # The tag is that of SB3's EvalCallback, whose evaluations have few episodes
            output.write({"eval/mean_reward": fmean(greedy)}, {"eval/mean_reward": ()}, model.num_timesteps)
        rows = [
            (f"Training, last {len(recent)} episodes", describe(recent)),
            (f"Greedy policy, {len(greedy)} episodes", describe(greedy) + self._limit_in_words()),
            ("Model", f"{self.save_path}/{self.env_name}.zip"),
            *self._tensorboard_rows(model),
        ]
        width = max(len(name) for name, _ in rows)
        print("\n" + "\n".join(f"{name:<{width}}  {value}" for name, value in rows))

    def _create_sampler(self, sampler_method: str) -> BaseSampler:
        try:
            return super()._create_sampler(sampler_method)
        except ModuleNotFoundError as error:
            sys.exit(
                f"error: --sampler {sampler_method} needs {error.name}: install it with  pip install {error.name}  or use "
                "--sampler tpe"
            )

    def _limit_in_words(self) -> str:
        return f", each of at most {EVALUATION_LIMIT} steps" if self._has_no_limit() else ""

    def _greedy_rewards(self, model: BaseAlgorithm) -> list[float]:
        # Played in the ordinary environment, however the model was trained
        self.vec_env_class = LeanVecEnv
        env = self.create_envs(N_EVALUATION_ENVS, eval_env=True)
        rewards, _ = evaluate_policy(model, env, N_EVALUATION_EPISODES, return_episode_rewards=True)
        env.close()
        assert isinstance(rewards, list)
        return rewards

    def _tensorboard_rows(self, model: BaseAlgorithm) -> list[tuple[str, str]]:
        if self.tensorboard_log is None:
            return [("TensorBoard log", "none (-tb FOLDER writes one)")]
        return [
            ("TensorBoard log", str(model.logger.get_dir())),
            ("Open it with", f"{tensorboard_command()} --logdir {Path(self.tensorboard_log).parent}"),
            ("Mean reward, step size", tensorboard_address()),
        ]


def describe(rewards: list[float]) -> str:
    """
    :param rewards: the return of every episode
    :return: their mean and its standard error, in words
    """
    if len(rewards) < 2:
        return "fewer than two episodes"
    return f"mean reward {fmean(rewards):.2f} ± {stdev(rewards) / sqrt(len(rewards)):.2f} (standard error)"


def tensorboard_command() -> str:
    """:return: the command that starts TensorBoard, also if the virtual environment is not activated"""
    beside = Path(sys.executable).with_name("tensorboard")
    if shutil.which("tensorboard") == str(beside) or not beside.exists():
        return "tensorboard"
    return str(beside.relative_to(Path.cwd()) if beside.is_relative_to(Path.cwd()) else beside)


def tensorboard_address() -> str:
    """:return: the address that shows the mean reward and μ on TensorBoard's first screen, for a server at its usual port"""
    cards = [{"plugin": "scalars", "tag": tag} for tag in ("rollout/ep_rew_mean", "train/learning_rate")]
    return f"http://localhost:6006/?pinnedCards={quote(json.dumps(cards, separators=(',', ':')))}#timeseries"


def method_name(text: str) -> int | str:
    """
    :param text: what was given for ``--method``
    :return: the number or the name
    :raises argparse.ArgumentTypeError: if there is no such method
    """
    try:
        number = int(text) if text.lstrip("-").isdigit() else text
        make_method(number)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return number


def check_entry(path: str, env_id: str, changes: dict[str, Any]) -> None:
    """
    :param path: a YAML file of hyperparameters
    :param env_id: an environment
    :param changes: hyperparameters of the command line, which replace those of the file
    :raises ValueError: if the file is no mapping from environments to entries, or this one's lacks its steps or the policy
    """
    try:
        entries = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ValueError(f"Cannot read {path}: {error}") from error
    if not isinstance(entries, dict):
        raise ValueError(f"{path} must have an entry for each environment, or one named `default`, but holds {entries!r}.")
    name = env_id if env_id in entries else "default"
    if name not in entries:
        return  # RL Zoo says so
    try:
        needed = {**entries[name], **changes}
        int(needed["n_timesteps"]), needed["policy"]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ValueError(
            f"The entry {name} of {path} must hold hyperparameters, one `name: value` a line, among them a whole number as "
            f"`n_timesteps` and `policy: MlpPolicy`, but is {entries[name]!r}."
        ) from error
    n_envs = needed.get("n_envs", 1)
    if not (type(n_envs) is int and n_envs >= 1):
        raise ValueError(f"`n_envs` must be a whole number of at least 1, but is {n_envs!r}.")


def parse_options(arguments: list[str]) -> tuple[argparse.Namespace, list[str]]:
    """
    :param arguments: the command line
    :return: our options, and the rest, which is RL Zoo's
    """
    parser = argparse.ArgumentParser(
        usage="%(prog)s [train | enjoy | record-video | plot] [option ...]",
        description="Train an agent with RL Zoo, evaluate it and save it. The first word may ask for something else: `enjoy` "
        "shows a trained agent, `record-video` records a video of one, and `plot` draws the returns of trainings; each has "
        "its own --help. The defaults are --algo tabular_q --env FrozenLake-v1 and the hyperparameters in "
        f"{CONFIG}. The options of this package come first, those of RL Zoo's training below.",
        add_help=False,
        allow_abbrev=False,
    )
    parser.add_argument(
        "--method",
        type=method_name,
        metavar="METHOD",
        help="the method that sets the step size: 1 to 8 for the paper's methods, or one of "
        f"{', '.join(STEP_SIZES)}. It replaces the method or learning rate of the YAML file, with its parameters; "
        "-params 'method_kwargs:dict(omega=0.6)' changes those of the method. `python -m sb3_adaptive_q methods` prints "
        "formulas and parameters",
    )
    parser.add_argument(
        "--vec-env",
        choices=VEC_ENVS,
        default="dummy",
        help="dummy (the default) steps the environments one after the other; compiled trains in machine code, which is much "
        "faster, in environments that compile; subproc runs each environment in a process of its own",
    )
    parser.add_argument(
        "-P",
        "--progress",
        action="store_true",
        help="show a progress bar instead of the log tables (add --verbose 1 for both)",
    )
    parser.set_defaults(started=False)
    ours, rest = parser.parse_known_args(arguments)
    if {"-h", "--help"} & set(rest):
        parser.print_help()
        print()
    return ours, rest


def train(arguments: list[str]) -> None:
    """
    Run RL Zoo's ``train`` with our defaults and options.

    :param arguments: the command line
    :raises SystemExit: if there is a mistake in it, or in the YAML file
    """
    ours, rest = parse_options(arguments)
    progress = ["-P", "--verbose", "0"] if ours.progress else []
    sys.argv[1:] = [*DEFAULTS, *progress, *rest]
    rl_zoo3.train.ExperimentManager = partial(TabularExperiment, ours=ours)  # type: ignore
    try:
        rl_zoo3.train.train()
    except MISTAKES as error:
        if ours.started:
            raise
        hint = (
            " (values of -params are Python expressions: gamma:0.9, name:\"'text'\")" if isinstance(error, NOT_PYTHON) else ""
        )
        text = locate(error) if isinstance(error, LookupError | ArithmeticError) else error  # whose text alone says little
        sys.exit(f"error: {text}{hint}")


def enjoy(arguments: list[str]) -> None:
    """
    Run RL Zoo's ``enjoy``, which plays a trained agent, with our defaults.

    :param arguments: the command line
    :raises SystemExit: if there is no such agent
    """
    sys.argv[1:] = with_latest_model([*DEFAULTS, "-f", FOLDER, *arguments])
    _show(rl_zoo3.enjoy.enjoy)


def record_video(arguments: list[str]) -> None:
    """
    Run RL Zoo's ``record_video``, which films a trained agent, with our defaults.

    :param arguments: the command line
    :raises SystemExit: if there is no such agent
    """
    sys.argv[1:] = with_latest_model([*DEFAULTS, "-f", FOLDER, *arguments])
    _show(partial(runpy.run_module, "rl_zoo3.record_video", run_name="__main__"))


def _show(program: Callable[[], Any]) -> None:
    try:
        program()
    except (AssertionError, ValueError) as error:
        sys.exit(f"error: {error} (a search with --optimize leaves no model: train one first)")
    except gym.error.DependencyNotInstalled as error:
        sys.exit(f"error: {error}")


def plot(arguments: list[str]) -> None:
    """
    Run RL Zoo's ``plot_train``, which plots the returns of trainings, with our defaults.

    :param arguments: the command line; ``-o FILE`` saves the picture
    :raises SystemExit: if there is nothing to plot
    """
    plot_training(["-a", ALGORITHM, "-e", "FrozenLake-v1", "-f", FOLDER, *arguments])


#: What the first argument may ask for; anything else is training
PROGRAMS = {"train": train, "enjoy": enjoy, "record-video": record_video, "plot": plot}


def main(arguments: list[str] | None = None) -> None:
    """
    Train; or show a trained agent or its training, if the first argument is ``enjoy``, ``record-video`` or ``plot``.

    :param arguments: the command line; ``None`` for that of the process
    :raises SystemExit: if there is a mistake in it
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    spell_out_what_cannot_be_written()
    register()
    if arguments[:1] and arguments[0] in PROGRAMS:
        PROGRAMS[arguments[0]](arguments[1:])
    else:
        train(arguments)


if __name__ == "__main__":
    main()
