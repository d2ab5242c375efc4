"""The design of an experiment: what may be asked for, from the command line, a file and Python, and how it is refused."""

from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from sb3_adaptive_q import METHODS
from sb3_adaptive_q.experiments import Choice, Design, DesignError, Execution, ExperimentError
from sb3_adaptive_q.experiments.names import make_method
from sb3_adaptive_q.experiments.options import options_of, parse
from sb3_adaptive_q.experiments.paper.command import StudyOptions, main
from sb3_adaptive_q.experiments.paper.settings import StudySettings

OWN = "tests.helpers.own_rules:"
DATA = {
    "runs": st.integers(1, 10**6),
    "episodes": st.integers(1, 10**9),
    "seed": st.integers(0, 2**64),
    "gamma": st.floats(0, 1),
    "exploration_final_eps": st.floats(0, 1),
    "beta_1": st.floats(0, 0.5),
    "beta_5": st.floats(0, 100),
    "methods": st.lists(st.integers(1, 8).map(str), min_size=1, unique=True).map(tuple),
    "preset": st.sampled_from(["literal", "table8"]),
    "next_action": st.sampled_from([None, "same", "next", "max"]),
    "sweep": st.just(("gamma=0.9,0.99", "beta_3=0.1")),
}


def labels(settings: StudySettings) -> list[str]:
    return list(dict.fromkeys(variant.label for variant in settings.design().variants()))


def read(*arguments: str) -> StudySettings:
    return parse(StudyOptions, "study", arguments).design


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The message with which the command line refuses, without a traceback."""
    try:
        status = main(list(arguments))
    except SystemExit as error:
        status = int(error.code or 0)
    assert status == 2
    message = capsys.readouterr().err
    assert "Traceback" not in message
    return " ".join(message.replace("│", " ").split())


# The paper's settings


def test_defaults_are_the_papers() -> None:
    settings = StudySettings()
    assert (settings.runs, settings.episodes, settings.gamma) == (20, 30_000, 0.99)
    assert settings.methods == ("1", "2", "3", "4", "5", "6", "7", "8")
    assert settings.systems == ("FrozenLake-v1", "CartPoleFriction-v0")


@pytest.mark.parametrize("number", METHODS)
def test_default_parameters_are_those_of_the_methods(number: int) -> None:
    name = str(number)
    chosen = make_method(name, StudySettings().method_kwargs(name)).method
    assert chosen.data == make_method(name, {}).method.data


@pytest.mark.parametrize("number", ["5", "6", "7", "8"])
def test_fitted_preset_looks_at_the_maximum_and_resets_to_beta_7(number: str) -> None:
    kwargs = StudySettings(preset="table8", beta_7=0.002).method_kwargs(number)
    assert (kwargs["mu_0"], kwargs["next_action"], kwargs["reset_each_episode"]) == (0.002, "max", True)


def test_fitted_preset_leaves_the_other_methods_alone() -> None:
    for number in ("1", "2", "3", "4"):
        assert StudySettings(preset="table8").method_kwargs(number) == StudySettings().method_kwargs(number)


def test_next_action_overrides_the_preset() -> None:
    assert StudySettings(preset="table8", next_action="same").method_kwargs("7")["next_action"] == "same"


@pytest.mark.parametrize(
    ("beta", "number", "name", "value"),
    [
        ("beta_1", "1", "beta", 0.02),
        ("beta_2", "2", "beta", 0.02),
        ("beta_3", "3", "beta_3", 0.02),
        ("beta_1", "4", "beta_1", 0.02),
        ("beta_5", "5", "gain", -0.02),
        ("beta_5", "6", "gain", 0.02),
        ("beta_6", "7", "step", 0.02),
        ("beta_6", "8", "step", -0.02),
        ("beta_7", "5", "lower", 0.02),
        ("beta_8", "8", "upper", 0.02),
        ("beta_1", "7", "mu_0", 0.02),
    ],
)
def test_every_beta_reaches_its_method(beta: str, number: str, name: str, value: float) -> None:
    settings = read(f"--{beta.replace('_', '-')}", "0.02", *(["--beta-8", "0.03"] if beta != "beta_8" else []))
    assert settings.method_kwargs(number)[name] == value


def test_ties_go_to_the_first_action() -> None:
    (variant, *_) = StudySettings().design().variants()
    assert variant.learner.settings["ties"] == "first"


# Sweeps


def test_sweep_of_a_beta_varies_the_methods_that_have_it() -> None:
    settings = StudySettings(methods=("1", "2", "7"), sweep=("beta_1=0.005,0.01",))
    assert labels(settings) == [
        "Method 1, beta_1 = 0.005",
        "Method 1, beta_1 = 0.01",
        "Method 2",
        "Method 7, beta_1 = 0.005",
        "Method 7, beta_1 = 0.01",
    ]
    swept = [variant.learner.parameters for variant in settings.design().variants()[:2]]
    assert swept == [{"beta": 0.005}, {"beta": 0.01}]


def test_sweep_of_a_setting_varies_all_methods() -> None:
    settings = StudySettings(methods=("1", "2"), sweep=("gamma=0.9,0.99",), systems=("FrozenLake-v1",))
    assert labels(settings) == [f"Method {number}, gamma = {gamma}" for number in (1, 2) for gamma in (0.9, 0.99)]
    assert [variant.learner.settings["gamma"] for variant in settings.design().variants()] == [0.9, 0.99, 0.9, 0.99]


def test_sweeps_are_combined() -> None:
    settings = StudySettings(methods=("7",), systems=("FrozenLake-v1",), sweep=("beta_6=0.001,0.002", "episodes=5,6,7"))
    assert len(settings.design().variants()) == 6


def test_sweep_of_a_parameter_varies_the_methods_that_have_it() -> None:
    settings = StudySettings(methods=("constant", "autostep", f"{OWN}Halving"), sweep=("alpha=0.1,0.2", "divisor=2,4"))
    assert labels(settings) == [
        "constant, alpha = 0.1",
        "constant, alpha = 0.2",
        "autostep",
        "Halving, divisor = 2",
        "Halving, divisor = 4",
    ]


def test_sweep_of_an_argument_of_the_algorithm() -> None:
    settings = StudySettings(methods=("1",), systems=("FrozenLake-v1",), sweep=("initial_q=0,1",))
    assert labels(settings) == ["Method 1, initial_q = 0", "Method 1, initial_q = 1"]


@pytest.mark.parametrize("name", ["device", "seed", "total_episodes", "_init_setup_model", "policy", "learning_rate"])
def test_sweep_of_what_is_not_compared_is_refused(name: str) -> None:
    with pytest.raises(DesignError, match=f"Unknown sweep '{name}'"):
        StudySettings(sweep=(f"{name}=1,2",)).design()


def test_sweep_of_an_argument_that_an_algorithm_hands_on() -> None:
    settings = StudySettings(
        methods=("1",), systems=("FrozenLake-v1",), algorithms=("n_step",), sweep=("initial_q=0,1", "n=1,2")
    )
    assert len(settings.design().variants()) == 4


def test_sweep_with_one_number_twice_is_refused() -> None:
    with pytest.raises(DesignError, match=r"the sweep of gamma must not repeat an entry, but has 1\.0 twice"):
        StudySettings(sweep=("gamma=1,1.0",)).design()


def test_single_value_is_a_setting() -> None:
    settings = StudySettings(methods=("constant",), systems=("FrozenLake-v1",), sweep=("alpha=0.3",))
    (variant,) = settings.design().variants()
    assert variant.learner.parameters == {"alpha": 0.3}


# What is given as module:name


def test_own_rule_environment_and_algorithm() -> None:
    settings = read("--method", f"{OWN}Halving", "7", "--env", f"{OWN}make_lake", "--algorithm", f"{OWN}OwnAlgorithm")
    first, _ = settings.design().variants()
    assert first.label == "Halving" and first.learner.environment == f"{OWN}make_lake"
    model, callback = first.learner.make(0)
    assert type(model).__name__ == "OwnAlgorithm" and type(callback).__name__ == "Halving"


def test_edited_rule_makes_other_cells(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = "from sb3_adaptive_q import LearningRateCallback\nclass Own(LearningRateCallback):\n    @staticmethod\n"
    source += "    def rule(mu, step):\n        return 0.1\n"
    (tmp_path / "edited_rule.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    design = Design(environments=["FrozenLake-v1"], methods=["edited_rule:Own"], steps=10, runs=1)
    (before,) = design.cells()
    (tmp_path / "edited_rule.py").write_text(source.replace("0.1", "0.2"))
    (after,) = design.cells()
    assert before.key != after.key and before.recipe["seed"] == after.recipe["seed"]


# In Python and in YAML


def test_design_in_python_is_that_in_yaml(tmp_path: Path) -> None:
    design = Design(
        environments=["FrozenLake-v1"],
        methods=["7", Choice("constant", {"alpha": [0.1, 0.2]})],
        settings={"gamma": [0.9, 0.99]},
        steps=1000,
        runs=3,
    )
    text = """
        environments: [FrozenLake-v1]
        methods:
          - 7
          - {name: constant, alpha: [0.1, 0.2]}
        settings: {gamma: [0.9, 0.99]}
        steps: 1000
        runs: 3
    """
    (tmp_path / "design.yml").write_text(text)
    assert [cell.key for cell in Design.from_yaml(tmp_path / "design.yml").cells()] == [cell.key for cell in design.cells()]
    assert len(design.cells()) == 3 * 3 * 2
    assert design.variants()[-1].label == "constant, alpha = 0.2, gamma = 0.99"


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("environments: [FrozenLake-v1]\nmethods: [1]\nsteps: 10\nrunz: 3", "Unknown entry 'runz'. Did you mean 'runs'"),
        ("methods: [1]\nsteps: 10", "does not describe a design"),
        ("environments: [FrozenLake-v1]\nmethods: [1]", "give `steps`"),
        ("environments: [FrozenLake-v1]\nmethods: [{gain: 1}]\nsteps: 10", "Unknown method ''"),
        ("environments: [FrozenLake-v1]\nmethods: [1]\nsteps: 10\nsettings: {gamma: 2}", "gamma"),
        ("environments: [FrozenLake-v1]\nmethods: [1]\nsteps: 10\nsettings: {gama: 0.9}", "cannot be made"),
        ("- 1", "one `name: value` a line"),
    ],
)
def test_bad_design_in_yaml_is_refused(text: str, part: str, tmp_path: Path) -> None:
    (tmp_path / "design.yml").write_text(text)
    with pytest.raises(DesignError) as caught:
        Design.from_yaml(tmp_path / "design.yml")
    assert part in str(caught.value)


@given(st.fixed_dictionaries({}, optional=DATA))
def test_yaml_gives_back_the_settings(data: dict[str, object]) -> None:
    settings = StudySettings(**data)  # type: ignore[arg-type]
    assert read(*options_of(yaml.safe_load(yaml.safe_dump(settings.as_data())))) == settings


def test_file_gives_the_design_and_options_override_it(tmp_path: Path) -> None:
    config = tmp_path / "design.yml"
    text = "runs: 7\ngamma: 1\nmethods: [1, 7]\nsystems: Taxi-v4\noutput: elsewhere\nworkers: 3\nprogress: false\n"
    config.write_text(text + "sweep: [beta_1=0.1]\nversions: {numpy: '1'}\n")
    options = parse(StudyOptions, "study", ["--runs", "9", "--config", str(config)])
    assert options.design == StudySettings(runs=9, gamma=1.0, methods=("1", "7"), systems=("Taxi-v4",), sweep=("beta_1=0.1",))
    assert options.execution == Execution(output=Path("elsewhere"), workers=3, progress=False)


# What is refused


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["--methods", "9"], "Unknown method '9'. There are 1, 2"),
        (["--methods", "autosteb"], "Did you mean 'autostep'"),
        (["--methods", "1", "1"], "methods must not repeat an entry, but has 1 twice"),
        (["--methods"], "methods must be a list with at least one entry"),
        (["--methods", "no_such_module:Rule"], "Cannot import 'no_such_module:Rule'"),
        (["--methods", f"{OWN}Nothing"], "Cannot import"),
        (["--methods", f"{OWN}NoRule"], "must make a LearningRateCallback"),
        (["--systems", "FrozenLak-v1"], "Did you mean 'FrozenLake-v1'"),
        (["--systems", "Acrobot-v1"], "tabular_q cannot be made in Acrobot-v1"),
        (["--systems", f"{OWN}Halving"], "must make a gymnasium environment"),
        (["--algorithms", "tabular_p"], "Did you mean 'tabular_q'"),
        (["--algorithms", f"{OWN}make_lake"], "must be the class of an algorithm"),
        (["--preset", "table9"], "Did you mean 'table8'"),
        (["--next-action", "nxt"], "`next_action` must be one of same, next, max"),
        (["--sweep", "beta_9=1,2"], "Unknown sweep 'beta_9'. Did you mean 'beta_"),
        (["--sweep", "runs=1,2"], "Unknown sweep 'runs'"),
        (["--sweep", "beta_1"], "A sweep is name=value,value"),
        (["--sweep", "beta_1=0.1,0.1"], "must not repeat an entry"),
        (["--sweep", "beta_1=0.1", "--sweep", "beta_1=0.2"], "names a setting twice: give all its values in one"),
        (["--sweep", "gamma=0.9,1.9"], "gamma"),
        (["--runs", "0"], "`runs` must be a whole number from 1"),
        (["--runs", "many"], "--runs"),
        (["--runz", "3"], "Perhaps you meant: --runs"),
        (["--episodes", "-3"], "`episodes` must be a whole number from 1"),
        (["--seed", "-1"], "`seed` must be a whole number of at least 0"),
        (["--gamma", "1.5"], "gamma"),
        (["--gamma", "nan"], "gamma"),
        (["--beta-2", "-0.1"], "beta_2"),
        (["--beta-5", "inf"], "beta_5"),
        (["--beta-7", "0.5"], "beta_7 must not be above beta_8"),
        (["--beta-3", "0.995"], "beta_1 + beta_3"),
        (["--workers", "0"], "`workers` must be a whole number"),
        (["--config", "/does/not/exist.yml"], "Cannot read"),
        (["--config"], "--config needs the name of a file"),
    ],
)
def test_bad_option_is_refused(arguments: list[str], part: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "study"
    assert part in refused(capsys, "--output", str(output), *arguments)
    assert not output.exists()


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("runz: 3", "Perhaps you meant: --runs"),
        ("runs: many", "--runs"),
        ("runs: 2.5", "--runs"),
        ("gamma: high", "--gamma"),
        ("methods: []", "methods must be a list"),
        ("- runs", "one `name: value` a line"),
        ("runs: [", "Cannot read"),
    ],
)
def test_bad_file_is_refused(text: str, part: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "design.yml"
    config.write_text(text)
    assert part in refused(capsys, "--config", str(config), "--output", str(tmp_path / "study"))


def test_help_has_words_for_every_option(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "independent runs of each method (default: 20)" in text and "discount factor γ (default: 0.99)" in text
    assert "chosen by fitting, so not evidence for it" in text


def test_errors_of_design_are_errors_of_experiments() -> None:
    assert issubclass(DesignError, ExperimentError) and issubclass(DesignError, ValueError)
