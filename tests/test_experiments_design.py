"""The design of a study: what may be asked for, from the command line and from a file, and how it is refused."""

from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from sb3_adaptive_q import method
from sb3_adaptive_q.study import DesignError, StudyError, StudySettings
from sb3_adaptive_q.study.command_line import main, read_arguments

DATA = {
    "runs": st.integers(1, 10**6),
    "episodes": st.integers(1, 10**9),
    "seed": st.integers(0, 2**64),
    "gamma": st.floats(0, 1),
    "exploration_final_eps": st.floats(0, 1),
    "beta_1": st.floats(0, 0.5),
    "beta_5": st.floats(0, 100),
    "methods": st.lists(st.integers(1, 8), min_size=1, unique=True),
    "preset": st.sampled_from(["literal", "table8"]),
    "next_action": st.sampled_from([None, "same", "next", "max"]),
}


def refused(capsys: pytest.CaptureFixture[str], *arguments: str, status: int = 2) -> str:
    """The message with which the command line refuses: one line, no traceback."""
    assert main(list(arguments)) == status
    message = capsys.readouterr().err
    assert message.startswith("Error: ") and message.count("\n") == 1
    return message


def test_defaults_are_the_papers() -> None:
    settings = StudySettings()
    assert (settings.runs, settings.episodes, settings.gamma) == (20, 30_000, 0.99)
    assert settings.methods == (1, 2, 3, 4, 5, 6, 7, 8)
    assert settings.systems == ("FrozenLake-v1", "CartPoleFriction-v0")


@pytest.mark.parametrize("number", range(1, 9))
def test_default_parameters_are_those_of_the_methods(number: int) -> None:
    chosen = method(number, **StudySettings().method_kwargs(number)).rate
    assert chosen.as_data() == method(number).rate.as_data()


@pytest.mark.parametrize("number", [5, 6, 7, 8])
def test_fitted_preset_looks_at_the_maximum_and_resets_to_beta_7(number: int) -> None:
    kwargs = StudySettings(preset="table8", beta_7=0.002).method_kwargs(number)
    assert (kwargs["mu_0"], kwargs["next_action"], kwargs["reset_each_episode"]) == (0.002, "max", True)


def test_fitted_preset_leaves_the_other_methods_alone() -> None:
    for number in (1, 2, 3, 4):
        assert StudySettings(preset="table8").method_kwargs(number) == StudySettings().method_kwargs(number)


def test_next_action_overrides_the_preset() -> None:
    assert StudySettings(preset="table8", next_action="same").method_kwargs(7)["next_action"] == "same"


@pytest.mark.parametrize(
    ("beta", "number", "name", "value"),
    [
        ("beta_1", 1, "beta", 0.02),
        ("beta_2", 2, "beta", 0.02),
        ("beta_3", 3, "beta_3", 0.02),
        ("beta_1", 4, "beta_1", 0.02),
        ("beta_5", 5, "gain", -0.02),
        ("beta_5", 6, "gain", 0.02),
        ("beta_6", 7, "step", 0.02),
        ("beta_6", 8, "step", -0.02),
        ("beta_7", 5, "lower", 0.02),
        ("beta_8", 8, "upper", 0.02),
        ("beta_1", 7, "mu_0", 0.02),
    ],
)
def test_every_beta_reaches_its_method(beta: str, number: int, name: str, value: float) -> None:
    settings, _ = read_arguments([f"--{beta.replace('_', '-')}", "0.02", *(["--beta-8", "0.03"] if beta != "beta_8" else [])])
    assert settings.method_kwargs(number)[name] == value


@given(st.fixed_dictionaries({}, optional=DATA))
def test_yaml_gives_back_the_settings(data: dict[str, object]) -> None:
    settings = StudySettings.from_data(data)
    assert StudySettings.from_data(yaml.safe_load(yaml.safe_dump(settings.as_data()))) == settings


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["--methods", "9"], "Unknown method 9"),
        (["--methods", "1", "1"], "must not repeat"),
        (["--systems", "Nonsense-v0"], "Unknown system 'Nonsense-v0'"),
        (["--systems", "Acrobot-v1"], "cannot compile"),
        (["--preset", "table9"], "literal, table8"),
        (["--next-action", "best"], "same, next, max"),
        (["--runs", "0"], "runs must be at least 1"),
        (["--episodes", "-3"], "episodes must be at least 1"),
        (["--seed", "-1"], "seed must be at least 0"),
        (["--gamma", "1.5"], "gamma"),
        (["--gamma", "nan"], "gamma"),
        (["--beta-2", "-0.1"], "beta_2"),
        (["--beta-5", "inf"], "beta_5"),
        (["--beta-7", "0.5"], "beta_7 must not be above beta_8"),
        (["--beta-3", "0.995"], "beta_1 + beta_3"),
        (["--workers", "0"], "workers must be a whole number"),
        (["--config", "/does/not/exist.yml"], "Cannot read"),
    ],
)
def test_bad_option_is_refused(arguments: list[str], part: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "study"
    assert part in refused(capsys, *arguments, "--output", str(output))
    assert not output.exists()


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("runz: 3", "Unknown setting 'runz'"),
        ("runs: many", "runs must be a whole number"),
        ("runs: 2.5", "runs must be a whole number"),
        ("runs: true", "runs must be a whole number"),
        ("gamma: high", "gamma must be a number"),
        ("methods: []", "methods must not be empty"),
        ("preset: 8", "preset must be a text"),
        ("tensorboard: 3", "tensorboard must be a text"),
        ("- runs", "one `name: value` a line"),
        ("runs: [", "Cannot read"),
    ],
)
def test_bad_file_is_refused(text: str, part: str, tmp_path: Path) -> None:
    config = tmp_path / "design.yml"
    config.write_text(text)
    with pytest.raises(DesignError, match=part):
        read_arguments(["--config", str(config)])


def test_file_gives_the_design_and_options_override_it(tmp_path: Path) -> None:
    config = tmp_path / "design.yml"
    config.write_text("runs: 7\ngamma: 1\nmethods: [1, 7]\nsystems: Taxi-v4\noutput: elsewhere\nworkers: 3\n")
    settings, execution = read_arguments(["--config", str(config), "--runs", "9"])
    assert (settings.runs, settings.gamma, settings.methods, settings.systems) == (9, 1.0, (1, 7), ("Taxi-v4",))
    assert execution == {"output": "elsewhere", "workers": 3, "dask": None, "tensorboard": None}


def test_errors_of_design_are_errors_of_study() -> None:
    assert issubclass(DesignError, StudyError) and issubclass(DesignError, ValueError)
