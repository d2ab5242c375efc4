"""train.py from the command line to the saved model: defaults, our options, RL Zoo's, mistakes."""

import csv
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import gymnasium as gym
import numpy as np
import pytest
import rl_zoo3.train
import yaml
from stable_baselines3.common.vec_env import SubprocVecEnv, VecEnv
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from sb3_adaptive_q import LeanVecEnv, TabularQ, zoo
from sb3_adaptive_q.vec_env import CompiledVecEnv

PROJECT = Path(__file__).resolve().parent.parent
#: Entries as a user would write them; the steps are few because each of them is trained
CONFIG: dict[str, dict[str, Any]] = {
    "FrozenLake-v1": {"n_timesteps": 2000, "policy": "MlpPolicy", "method": 5, "method_kwargs": {"gain": -0.2}},
    "CliffWalkingLimited-v1": {
        "n_timesteps": 2000,
        "policy": "MlpPolicy",
        "callback": [{"sb3_adaptive_q.callbacks.SignRateCallback": {"step": 0.004}}],
    },
    "NanReward-v0": {"n_timesteps": 2000, "policy": "MlpPolicy"},
}


class NanReward(gym.Env[int, int]):
    """Gives a reward that is not a number."""

    observation_space = gym.spaces.Discrete(2)
    action_space = gym.spaces.Discrete(2)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed)
        return 0, {}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        return 0, float("nan"), False, False, {}


class Run:
    """
    Runs the command line in this process, in a folder of its own.

    :param folder: what is given as ``-f``
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __call__(self, *arguments: str) -> None:
        """Train, by default with few steps and without evaluations in between."""
        defaults = ["-f", str(self.folder), "--seed", "0", "-n", "2000", "--eval-freq", "-1"]
        zoo.main([*defaults, *arguments])

    def path(self, env_id: str = "FrozenLake-v1", number: int = 1) -> Path:
        return self.folder / "tabular_q" / f"{env_id}_{number}"

    def model(self, env_id: str = "FrozenLake-v1", number: int = 1) -> TabularQ:
        return TabularQ.load(self.path(env_id, number) / f"{env_id}.zip")

    def saved(self, name: str, env_id: str = "FrozenLake-v1") -> Any:
        # RL Zoo's files name Python classes
        return yaml.load((self.path(env_id) / env_id / name).read_text(), Loader=yaml.UnsafeLoader)


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    # Both are set by main(): to be as they were afterwards
    monkeypatch.setattr(sys, "argv", ["train.py"])
    monkeypatch.setattr(rl_zoo3.train, "ExperimentManager", rl_zoo3.train.ExperimentManager)
    monkeypatch.chdir(tmp_path)
    return Run(tmp_path / "logs")


@pytest.fixture
def config(tmp_path: Path) -> str:
    path = tmp_path / "own.yml"
    path.write_text(yaml.safe_dump(CONFIG))
    return str(path)


def printed(text: str, name: str) -> str:
    """The value of a row of the summary."""
    (value,) = re.findall(rf"^{name} +(.*)$", text, re.MULTILINE)
    return str(value)


def printed_mean(text: str, name: str) -> float:
    (value,) = re.findall(r"mean reward (-?[\d.]+) ±", printed(text, name))
    return float(value)


def episode_rewards(path: Path) -> list[float]:
    """The episodes' returns, from the file that gymnasium's part of the training left."""
    with (path / "0.monitor.csv").open() as file:
        next(file)
        return [float(row["r"]) for row in csv.DictReader(file)]


def greedy_return(model: TabularQ, env: gym.Env[Any, Any], n_episodes: int) -> float:
    """The mean return of the greedy policy, played step by step."""
    returns = []
    for episode in range(n_episodes):
        observation, _ = env.reset(seed=episode)
        ended, total = False, 0.0
        while not ended:
            action, _ = model.predict(np.asarray(observation), deterministic=True)
            observation, reward, terminated, truncated, _ = env.step(int(action))
            total += float(reward)
            ended = terminated or truncated
        returns.append(total)
    return sum(returns) / n_episodes


# Defaults and the summary


def test_defaults_and_summary(run: Run, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    run("-tb", "runs", "-n", "60000")
    output = capsys.readouterr().out
    model = run.model()
    assert (model.num_timesteps, model.method, model.gamma) == (60000, 1, 0.99)
    assert f"Loading hyperparameters from: {zoo.CONFIG}" in output
    last = episode_rewards(run.path())[-100:]
    assert printed_mean(output, "Training, last 100 episodes") == pytest.approx(sum(last) / 100, abs=0.005)
    # Each is the mean of 500 returns of 0 or 1: their difference has a standard deviation of at most 0.032
    mean = printed_mean(output, "Greedy policy, 500 episodes")
    assert mean == pytest.approx(greedy_return(model, gym.make("FrozenLake-v1"), 500), abs=0.16)
    assert printed(output, "Model") == str(run.path() / "FrozenLake-v1.zip")
    assert printed(output, "TensorBoard log") == "runs/FrozenLake-v1/TabularQ_method1_1"
    assert printed(output, "Open it with").endswith("tensorboard --logdir runs")
    log = EventAccumulator(str(tmp_path / "runs" / "FrozenLake-v1" / "TabularQ_method1_1")).Reload()
    assert {"rollout/ep_rew_mean", "train/learning_rate"} <= set(log.Tags()["scalars"])
    assert log.Scalars("eval/mean_reward")[-1].value == pytest.approx(mean, abs=0.005)
    assert log.SummaryMetadata("_hparams_/session_start_info").plugin_data.plugin_name == "hparams"
    assert unquote(printed(output, "Mean reward, step size")).endswith('"tag":"train/learning_rate"}]#timeseries')


def test_summary_without_tensorboard(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    run("--log-interval", "-2")
    output = capsys.readouterr().out
    assert printed(output, "TensorBoard log") == "none (-tb FOLDER writes one)"
    assert "rollout/" not in output


def test_tensorboard_needs_a_folder(run: Run, tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("")
    with pytest.raises(SystemExit, match="-tb must name a folder, but runs is a file"):
        run("-tb", "runs")
    assert not run.path().exists()


def test_other_algorithms_still_train(run: Run, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zoo, "N_EVALUATION_EPISODES", 20)
    run("--algo", "a2c", "--env", "CartPole-v1", "-n", "200", "-params", "n_envs:2")
    assert "Greedy policy, 20 episodes" in capsys.readouterr().out
    assert (run.folder / "a2c" / "CartPole-v1_1" / "CartPole-v1.zip").exists()


# The entries of our own file

#: Environment, and the least mean return of the greedy policy. FrozenLake: the optimum is 0.74 within 100 steps;
#: Taxi: 5% under the optimum of 7.93 (value iteration over ``env.P``); the cliff: the shortest safe way
GOALS = {
    "FrozenLake-v1": 0.70,
    "CliffWalkingLimited-v1": -13.0,
    "Taxi-v4": 7.53,
    "CartPoleFriction-v0": 180.0,
    "CartPole-v1": 180.0,
}


@pytest.mark.parametrize("env_id", GOALS)
def test_entries_of_the_yaml_file_learn(env_id: str, run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    """With their own number of steps: 100 000 to a million, compiled."""
    run("--env", env_id, "-n", "-1", "--vec-env", "compiled", "--verbose", "0")
    assert printed_mean(capsys.readouterr().out, "Greedy policy, 500 episodes") >= GOALS[env_id]
    assert run.model(env_id).num_timesteps == yaml.safe_load(zoo.CONFIG.read_text())[env_id]["n_timesteps"]


def test_evaluations_of_a_compiled_training_are_not_warned_of(run: Run, recwarn: pytest.WarningsRecorder) -> None:
    run("--vec-env", "compiled", "--eval-freq", "1000")
    assert not any("is called once for a block" in str(each.message) for each in recwarn)


def test_evaluations_end_where_the_environment_has_no_limit(
    run: Run, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zoo, "EVALUATION_LIMIT", 7)
    monkeypatch.setattr(zoo, "N_EVALUATION_EPISODES", 20)
    run("--env", "RingWalk-v0", "--eval-freq", "1000")
    with np.load(run.path("RingWalk-v0") / "evaluations.npz") as evaluations:
        assert (evaluations["ep_lengths"] == 7).all()
    assert "each of at most 7 steps" in printed(capsys.readouterr().out, "Greedy policy, 20 episodes")


def test_evaluations_have_the_arguments_of_the_yaml_file(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zoo, "N_EVALUATION_EPISODES", 20)
    (tmp_path / "dry.yml").write_text(
        yaml.safe_dump({"FrozenLake-v1": {**CONFIG["FrozenLake-v1"], "env_kwargs": {"is_slippery": False}}})
    )
    made = []
    create_envs = zoo.TabularExperiment.create_envs

    def spy(self: zoo.TabularExperiment, *positional: Any, **named: Any) -> VecEnv:
        env = create_envs(self, *positional, **named)
        made.append(len(env.get_attr("P")[0][0][0]))
        return env

    monkeypatch.setattr(zoo.TabularExperiment, "create_envs", spy)
    run("-conf", "dry.yml", "--eval-freq", "1000")
    assert made == [1, 1, 1]  # outcomes of an action: on ice there are 3


# Our own options


def test_method_replaces_that_of_the_yaml_file(run: Run, config: str) -> None:
    """Method 7 has no gain: what the file has for Method 5 must go."""
    run("-conf", config, "--method", "7", "-params", "gamma:0.5")
    model = run.model()
    assert (model.method, model.method_kwargs, model.gamma) == (7, None, 0.5)
    assert run.saved("config.yml")["method"] == 7
    assert run.saved("args.yml")["hyperparams"] == {"gamma": 0.5, "method": 7, "method_kwargs": None}


def test_the_yaml_method_stays_without_the_option(run: Run, config: str) -> None:
    run("-conf", config, "-params", "gamma:0.5")
    model = run.model()
    assert (model.method, model.method_kwargs, model.gamma) == (5, {"gain": -0.2}, 0.5)


def test_learning_rate_replaces_the_yaml_method(run: Run, config: str) -> None:
    run("-conf", config, "-params", "learning_rate:0.25")
    assert run.model().method is None
    assert run.model().mu == 0.25


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], LeanVecEnv),
        (["--vec-env", "dummy"], LeanVecEnv),
        (["--vec-env", "compiled"], CompiledVecEnv),
        (["--vec-env", "subproc"], SubprocVecEnv),
    ],
)
def test_vec_env(arguments: list[str], expected: type[VecEnv], run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of training and of the evaluations in between; the evaluation at the end plays the ordinary environment."""
    made = []
    create_envs = zoo.TabularExperiment.create_envs

    def spy(self: zoo.TabularExperiment, *positional: Any, **named: Any) -> VecEnv:
        env = create_envs(self, *positional, **named)
        made.append((type(env), env.num_envs, named.get("eval_env", False)))
        return env

    monkeypatch.setattr(zoo.TabularExperiment, "create_envs", spy)
    run(*arguments, "-params", "n_envs:2", "--eval-freq", "1000")
    assert made == [(expected, 1, True), (expected, 2, False), (LeanVecEnv, 10, True)]
    assert (run.path() / "evaluations.npz").exists()
    assert run.saved("args.yml")["vec_env"] == (arguments or ["--vec-env", "dummy"])[-1]


def test_compiled_trains_the_same_model(run: Run) -> None:
    run("--method", "7", "-n", "20000", "--eval-freq", "5000")
    run("--method", "7", "-n", "20000", "--eval-freq", "5000", "--vec-env", "compiled")
    assert np.array_equal(run.model(number=1).q_table, run.model(number=2).q_table)
    assert run.model(number=1).q_table.any()
    assert run.model(number=1).mu == run.model(number=2).mu
    evaluations = [np.load(run.path(number=number) / "evaluations.npz") for number in (1, 2)]
    for name in ("timesteps", "results", "ep_lengths"):
        assert np.array_equal(evaluations[0][name], evaluations[1][name])


def test_methods_as_callbacks_in_yaml(run: Run, config: str) -> None:
    """RL Zoo ends the training of its first callback twice, which must do no harm."""
    run("--env", "CliffWalkingLimited-v1", "-conf", config)
    model = run.model("CliffWalkingLimited-v1")
    assert model.method is None
    # From μ0 = 0.01 in steps of 0.004 between the bounds: what 2000 such steps can lead to
    reachable = {0.01, 0.006, 0.002, 0.001, 0.005, 0.009}
    assert any(model.mu == pytest.approx(mu) for mu in reachable)
    model.set_env(gym.make("CliffWalkingLimited-v1"))
    mus = set()
    model.learn(500, callback=lambda local_variables, _: mus.add(round(local_variables["self"].mu, 9)) or True)
    assert len(mus) > 1 and mus <= reachable


# RL Zoo's options


def test_progress_bar_instead_of_tables(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    run("-P")
    output = "".join(capsys.readouterr())
    assert "2,000/2,000" in output and "100%" in output
    assert "rollout/" not in output
    run("-P", "--verbose", "1", "-n", "4000")
    assert "rollout/" in "".join(capsys.readouterr())


def test_evaluations_and_checkpoints(run: Run) -> None:
    run("--eval-freq", "500", "--eval-episodes", "3", "--save-freq", "1000")
    with np.load(run.path() / "evaluations.npz") as evaluations:
        assert evaluations["timesteps"].tolist() == [500, 1000, 1500, 2000]
        assert evaluations["results"].shape == (4, 3)
    steps = {path.stem: TabularQ.load(path).num_timesteps for path in run.path().glob("rl_model_*.zip")}
    assert steps == {"rl_model_1000_steps": 1000, "rl_model_2000_steps": 2000}


def test_seed_decides_the_result(run: Run) -> None:
    for seed in ("1", "1", "2"):
        run("--seed", seed, "-n", "20000")
    first, second, third = (run.model(number=number).q_table for number in (1, 2, 3))
    assert np.array_equal(first, second)
    assert not np.array_equal(first, third)


def test_continue_with_another_method(run: Run) -> None:
    run("--method", "2", "-n", "20000")
    table = run.model().q_table.copy()
    saved = str(run.path() / "FrozenLake-v1.zip")
    run("-i", saved, "--method", "1", "-n", "1")
    run("-i", saved, "-params", "learning_rate:0.5", "-n", "1")
    assert (run.model().mu, run.model(number=2).mu, run.model(number=3).mu) == (0.05, 0.01, 0.5)
    # One step changes one entry at most
    assert table.any() and (run.model(number=2).q_table != table).sum() <= 1


@pytest.mark.parametrize("vec_env", ["dummy", "compiled"])
def test_continue_from_a_checkpoint(vec_env: str, run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    """As if nothing had happened: the seed and the number of steps are those of the training that was broken off."""
    run("--vec-env", vec_env, "--save-freq", "700")
    capsys.readouterr()
    run("--vec-env", vec_env, "-i", str(run.path() / "rl_model_700_steps.zip"), "--seed", "7", "-n", "5")
    assert "rl_model_700_steps.zip: 1300 steps are left" in capsys.readouterr().out
    whole, rest = run.model(), run.model(number=2)
    assert rest.q_table.tobytes() == whole.q_table.tobytes()
    assert rest.training.as_data() == whole.training.as_data()


def test_optimize(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    run("--optimize", "--n-trials", "4", "--pruner", "none", "--no-optim-plots")
    (report,) = (run.folder / "tabular_q").glob("report_*.csv")
    with report.open() as file:
        assert [row["state"] for row in csv.DictReader(file)] == ["COMPLETE"] * 4
    assert "Best trial" in capsys.readouterr().out


def test_enjoy_plays_the_saved_model(run: Run, config: str, capsys: pytest.CaptureFixture[str]) -> None:
    run("--env", "CartPoleFriction-v0", "--vec-env", "compiled")
    capsys.readouterr()
    zoo.main(["enjoy", "--env", "CartPoleFriction-v0", "-f", str(run.folder), "--no-render", "-n", "400"])
    output = capsys.readouterr().out
    (mean,) = re.findall(r"Mean reward: ([\d.]+) ", output)
    assert 1.0 <= float(mean) <= 200.0


def test_record_video_films_the_saved_model(run: Run, config: str, tmp_path: Path) -> None:
    run("--env", "FrozenLake-v1")
    zoo.main(["record-video", "-f", str(run.folder), "-o", str(tmp_path / "film"), "-n", "3"])
    (film,) = (tmp_path / "film").glob("*.mp4")
    assert film.stat().st_size > 0


# Mistakes

USAGE = 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--env", "FrozenLak-v1"], "FrozenLak-v1 not found .* FrozenLake-v1"),
        (["--env", "CartPole-v1", "-params", "env_wrapper:None"], r"wrappers\.DiscretizeObservation"),
        (["-params", "method:9"], "A method is a number from 1 to 8 .* but got 9"),
        (["-params", "gamma:2"], "`gamma` must be a number from 0 to 1, but got 2"),
        (["-params", "gama:0.9"], "unexpected keyword argument 'gama'"),
        (["-params", "gamma:high"], "'high' is not defined .*are Python expressions"),
        (["-params", "gamma"], "invalid syntax .*are Python expressions"),
        (["--method", "7", "-params", "method_kwargs:dict(gain=1)"], "Method 7 has the parameters .*, but got gain"),
        (["--method", "1", "-params", "learning_rate:0.5"], "give one of them"),
        (["-params", "callback:'sb3_adaptive_q.callbacks.NoSuchCallback'"], "NoSuchCallback"),
        (["-conf", "missing.yml"], "missing.yml"),
        (["-i", "missing.zip"], r"\.zip file"),
        (["--gym-packages", "missing"], "No module named 'missing'"),
    ],
)
def test_mistakes_are_told_in_a_sentence(arguments: list[str], message: str, run: Run) -> None:
    with pytest.raises(SystemExit, match=message) as stop:
        run(*arguments)
    assert str(stop.value.code).startswith("error: ")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "bad.yml must have an entry for each environment, or one named `default`, but holds None"),
        ("FrozenLake-v1:", "The entry FrozenLake-v1 of bad.yml must hold hyperparameters"),
        ("FrozenLake-v1: [1, 2]", r"among them a whole number as `n_timesteps` and `policy: MlpPolicy`, but is \[1, 2\]"),
        ("default: {n_timesteps: lots, policy: MlpPolicy}", "The entry default of bad.yml"),
        ("default: {n_timesteps: 1000}", "The entry default of bad.yml"),
    ],
)
def test_yaml_without_what_is_needed(run: Run, tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "bad.yml").write_text(text)
    with pytest.raises(SystemExit, match=f"error: .*{message}"):
        run("-conf", "bad.yml")


def test_yaml_that_the_command_line_completes(run: Run, tmp_path: Path) -> None:
    (tmp_path / "part.yml").write_text("FrozenLake-v1: {n_timesteps: 1000}")
    run("-conf", "part.yml", "-params", "policy:'MlpPolicy'")
    assert run.model().num_timesteps >= 1000


def test_yaml_that_cannot_be_read(run: Run, tmp_path: Path) -> None:
    (tmp_path / "broken.yml").write_text("FrozenLake-v1: [")
    with pytest.raises(SystemExit, match=r"(?s)error: .*broken\.yml"):
        run("-conf", "broken.yml")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--method", "9"], "argument --method: A method is a number from 1 to 8"),
        (["--method", "one"], "argument --method: There is no step size 'one'"),
        (["--vec-env", "fast"], "argument --vec-env: invalid choice: 'fast'"),
        (["--no-such-option"], "unrecognized arguments: --no-such-option"),
    ],
)
def test_wrong_options(arguments: list[str], message: str, run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        run(*arguments)
    assert stop.value.code == USAGE
    assert message in capsys.readouterr().err


def test_enjoy_without_a_model(run: Run) -> None:
    with pytest.raises(SystemExit, match=r"error: .*tabular_q folder was not found"):
        zoo.main(["enjoy", "--env", "Taxi-v4", "--no-render"])


def test_errors_while_learning_keep_their_traceback(run: Run, config: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(gym.registry, "NanReward-v0", gym.envs.registration.EnvSpec("NanReward-v0", NanReward))
    with pytest.raises(ValueError, match="Rewards must be finite"):
        run("--env", "NanReward-v0", "-conf", config)


def test_help_shows_our_options_and_rl_zoos(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        run("--help")
    output = capsys.readouterr().out
    assert stop.value.code == 0
    assert all(option in output for option in ("--method", "compiled", "--progress", "--eval-freq", "--save-freq"))


# The files themselves


@pytest.mark.parametrize("program", [[str(PROJECT / "train.py")], ["-m", "sb3_adaptive_q.zoo"]])
def test_runs_from_any_folder(program: list[str], tmp_path: Path) -> None:
    arguments = ["-n", "500", "-f", "logs", "--vec-env", "compiled", "--seed", "0"]
    finished = subprocess.run([sys.executable, *program, *arguments], cwd=tmp_path, capture_output=True, text=True)
    assert finished.returncode == 0, finished.stderr
    assert (tmp_path / "logs" / "tabular_q" / "FrozenLake-v1_1" / "FrozenLake-v1.zip").exists()
    assert printed(finished.stdout, "Model") == "logs/tabular_q/FrozenLake-v1_1/FrozenLake-v1.zip"


def test_train_py_without_rl_zoo(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "sb3_adaptive_q.zoo")
    monkeypatch.setitem(sys.modules, "rl_zoo3", None)
    with pytest.raises(SystemExit, match=r"rl_zoo3 is not installed"):
        runpy.run_path(str(PROJECT / "train.py"))
