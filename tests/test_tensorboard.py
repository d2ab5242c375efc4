"""What a training writes to TensorBoard beside its curves: the name of the run, and the hyperparameters."""

from pathlib import Path
from typing import Any

import pytest
from stable_baselines3.common.logger import configure
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams import metadata, plugin_data_pb2

from sb3_adaptive_q import SARSA, NStep, SARSALambda, TabularQ, method

LAKE = "FrozenLake-v1"


def plugin_data(run: Path, tag: str) -> Any:
    """What TensorBoard's HPARAMS plugin reads of a run under one of its tags."""
    content = EventAccumulator(str(run)).Reload().SummaryMetadata(tag).plugin_data.content
    return plugin_data_pb2.HParamsPluginData.FromString(content)


def hparams(run: Path) -> dict[str, Any]:
    values = plugin_data(run, metadata.SESSION_START_INFO_TAG).session_start_info.hparams
    return {name: getattr(value, value.WhichOneof("kind")) for name, value in values.items()}


@pytest.mark.parametrize(
    ("kind", "arguments", "callback", "expected"),
    [
        (TabularQ, {}, None, "TabularQ_1"),
        (TabularQ, {"method": 7}, None, "TabularQ_method7_1"),
        (SARSA, {"method": "autostep"}, None, "SARSA_autostep_1"),
        (TabularQ, {}, 3, "TabularQ_method3_1"),
        (TabularQ, {"method": 7}, "harmonic", "TabularQ_harmonic_1"),
    ],
)
def test_the_run_is_named_by_algorithm_and_method(
    kind: Any, arguments: dict[str, Any], callback: Any, expected: str, tmp_path: Path
) -> None:
    model = kind("MlpPolicy", LAKE, tensorboard_log=str(tmp_path), **arguments)
    model.learn(10, callback=callback and [method(callback)])
    assert [path.name for path in tmp_path.iterdir()] == [expected]


def test_a_run_that_goes_on_keeps_its_name(tmp_path: Path) -> None:
    model = TabularQ("MlpPolicy", LAKE, tensorboard_log=str(tmp_path)).learn(10, callback=method(7))
    model.learn(10, reset_num_timesteps=False)
    assert [path.name for path in tmp_path.iterdir()] == ["TabularQ_method7_1"]


def test_hyperparameters_of_a_method(tmp_path: Path) -> None:
    model = TabularQ("MlpPolicy", LAKE, gamma=0.9, exploration_final_eps=0.1, seed=3, tensorboard_log=str(tmp_path))
    model.learn(1000, callback=method(5, gain=-0.2))
    (run,) = tmp_path.iterdir()
    assert hparams(run) == {
        "algorithm": "TabularQ",
        "gamma": 0.9,
        "method": "method5",
        "method_kwargs": "gain=-0.2, lower=0.001, upper=0.01, mu_0=0.01, next_action=same",
        "seed": 3.0,
        "table/initial_q": 0.0,
        "ties": "random",
        "ε/exploration": "epsilon_greedy",
        "ε/exploration_final_eps": 0.1,
        "ε/exploration_fraction": 1.0,
        "ε/exploration_initial_eps": 1.0,
        "ε/exploration_schedule": "linear",
        "μ/first": 0.01,
        "μ/gain": -0.2,
        "μ/lower": 0.001,
        "μ/upper": 0.01,
        "μ/mu_0": 0.01,
        "μ/next_action": "same",
    }


def test_the_metrics_are_those_of_the_log(tmp_path: Path) -> None:
    TabularQ("MlpPolicy", LAKE, method=7, seed=0, tensorboard_log=str(tmp_path)).learn(1000)
    (run,) = tmp_path.iterdir()
    metrics = [each.name.tag for each in plugin_data(run, metadata.EXPERIMENT_TAG).experiment.metric_infos]
    scalars = EventAccumulator(str(run)).Reload().Tags()["scalars"]
    assert set(metrics) - {"eval/mean_reward"} == {"rollout/ep_rew_mean", "train/learning_rate"} <= set(scalars)


def test_hyperparameters_without_a_method_and_of_other_algorithms(tmp_path: Path) -> None:
    def values_of(model: Any) -> dict[str, Any]:
        run = tmp_path / str(len(list(tmp_path.iterdir())))
        model.set_logger(configure(str(run), ["tensorboard"]))
        model.learn(50)
        return hparams(run)

    schedules: dict[str, Any] = {"learning_rate": lambda left: 0.2 * left, "exploration_schedule": lambda done: 0.5}
    plain = values_of(TabularQ("MlpPolicy", LAKE, **schedules))
    assert (plain["method"], plain["method_kwargs"], plain["μ/first"]) == ("learning_rate", "", 0.2)
    assert plain["ε/exploration_schedule"] == "a function" and "seed" not in plain
    traces = values_of(SARSALambda("MlpPolicy", LAKE, trace_decay=0.5, method="polynomial"))
    assert (traces["algorithm"], traces["trace_decay"], traces["true_online"]) == ("SARSALambda", 0.5, False)
    assert (traces["method"], traces["μ/omega"]) == ("polynomial", method("polynomial").method.data.parameters["omega"])
    assert values_of(NStep("MlpPolicy", LAKE, n=3))["n"] == 3.0


def test_other_logs_have_no_hyperparameters(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = TabularQ("MlpPolicy", LAKE, method=7)
    model.set_logger(configure(str(tmp_path), ["stdout", "csv", "json"]))
    model.learn(500)
    assert "hparams" not in capsys.readouterr().out + (tmp_path / "progress.csv").read_text()
