"""The league's protocol as shipped: grids, budgets, seeds; the choice of settings; and what is refused."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from sb3_adaptive_q.experiments import DesignError
from sb3_adaptive_q.experiments.league.command import LeagueOptions, main
from sb3_adaptive_q.experiments.league.greedy_episodes import player
from sb3_adaptive_q.experiments.league.plan import (
    Runs,
    anytime,
    cells_of,
    choose,
    prediction_scale,
    setting_text,
    tuning_scores,
)
from sb3_adaptive_q.experiments.league.remarks import design_remark
from sb3_adaptive_q.experiments.league.settings import LeagueSettings, Task, Track
from sb3_adaptive_q.experiments.options import options_of, parse

OWN = "tests.helpers.own_rules:"
#: Steps of a run, as the protocol prints them
BUDGETS = {
    "lake4": 200_000,
    "lake4_dry": 10_000,
    "lake8": 1_000_000,
    "taxi": 500_000,
    "cliff_slippery": 200_000,
    "windy_king": 200_000,
    "riverswim": 200_000,
    "chain": 50_000,
    "double_loop": 20_000,
    "dyna_maze": 30_000,
    "hasselt_grid": 100_000,
    "roulette": 200_000,
    "garnet": 50_000,
    "moving_goal": 500_000,
    "drifting_garnet": 200_000,
    "cartpole": 1_000_000,
}
#: The publications' defaults: the first setting of each grid
DEFAULTS = {
    "constant": {"alpha": 0.1},
    "harmonic": {"a": 10},
    "polynomial": {"omega": 0.8},
    "mcclain": {"target": 0.1},
    "trigg": {"phi": 0.1},
    "bakf": {"nu_target": 0.05},
    "autostep": {"meta_step_size": 0.01, "alpha_0": 0.1},
    "idbd": {"theta": 0.01, "alpha_0": 0.1},
    "delta_bar_delta": {"kappa": 0.01, "phi": 0.05, "alpha_0": 0.1},
    "search_then_converge": {"alpha_0": 0.5, "tau": 100, "c": 1},
}
SMALL = LeagueSettings(tracks=("B",), methods=("constant", "autostep", "7"), environments=("chain", "garnet"))


def track_of(settings: LeagueSettings, name: str) -> Track:
    (track,) = (each for each in settings.chosen_tracks() if each.name == name)
    return track


@pytest.fixture(scope="module")
def league() -> dict[str, Track]:
    return {track.name: track for track in LeagueSettings().chosen_tracks()}


def test_budgets_are_those_of_the_protocol(league: dict[str, Track]) -> None:
    assert {task.name: task.steps for task in league["B"].tasks} == BUDGETS
    assert all(task.steps % 25 == 0 for track in league.values() for task in track.tasks)


def test_every_rule_has_twelve_settings_the_default_first(league: dict[str, Track]) -> None:
    for rule in league["B"].contestants:
        assert len(rule.settings) == (1 if rule.method.isdecimal() or rule.method == "rescaled_linear" else 12)
        assert len({str(setting) for setting in rule.settings}) == len(rule.settings)
        assert DEFAULTS.get(rule.method, {}).items() <= rule.settings[0].items()
    assert {rule.method for rule in league["B"].contestants} >= {*DEFAULTS, *map(str, range(1, 9))}


def test_tracks_have_the_environments_that_they_can_judge(league: dict[str, Track]) -> None:
    names = {name: {task.name for task in track.tasks} for name, track in league.items()}
    assert names["A"] == set(BUDGETS) - {"moving_goal", "drifting_garnet", "cartpole"}
    assert len(names["C"]) == 10 and names["algorithms"] == names["B"]
    assert [rule.label for rule in league["algorithms"].contestants[:5]] == [
        *("constant", "polynomial", "bakf", "autostep"),
        "constant (sarsa)",
    ]


def test_exploration_is_that_of_the_protocol(league: dict[str, Track]) -> None:
    assert league["B"].behaviour == {
        "exploration_initial_eps": 1.0,
        "exploration_final_eps": 0.05,
        "exploration_fraction": 0.5,
        "ties": "first",
    }
    assert {league["A"].behaviour[f"exploration_{end}_eps"] for end in ("initial", "final")} == {1.0}


def test_seeds_of_tuning_and_evaluation_are_never_shared() -> None:
    settings = LeagueSettings()
    tuning, evaluation = ([seed for group in settings.seeds(phase) for seed in group] for phase in ("tuning", "evaluation"))
    assert tuning == list(range(10)) and evaluation == list(range(1000, 1100))
    quick = LeagueSettings(quick=True)
    assert [sum(map(len, quick.seeds(phase))) for phase in ("tuning", "evaluation")] == [5, 20]


def test_quick_look_has_four_settings_and_a_tenth_of_the_steps() -> None:
    quick = track_of(LeagueSettings(quick=True, tracks=("B",)), "B")
    assert {task.name: 10 * task.steps for task in quick.tasks} == BUDGETS
    assert {len(rule.settings) for rule in quick.contestants} == {1, 4}


def test_cells_of_another_league_have_other_names() -> None:
    track = track_of(SMALL, "B")
    cells = [
        cell for place in ((0, 0, 0), (0, 1, 0), (1, 0, 0), (0, 0, 1)) for cell in cells_of(SMALL, track, place, "tuning")
    ]
    cells += cells_of(SMALL, track, (0, 0, 0), "evaluation")
    assert len({cell.key for cell in cells}) == len(cells) == 4 + 5  # of twenty runs each, or fewer
    quick = LeagueSettings(tracks=("B",), methods=SMALL.methods, environments=SMALL.environments, quick=True)
    assert cells_of(quick, track_of(quick, "B"), (0, 0, 0), "tuning")[0].key != cells[0].key


def test_cells_do_not_depend_on_what_else_takes_part() -> None:
    more = LeagueSettings(tracks=("A", "B"), environments=("taxi", "garnet", "chain"), runs=200)
    alone, together = track_of(SMALL, "B"), track_of(more, "B")
    first = cells_of(SMALL, alone, (2, 3, 1), "evaluation")
    place = ([rule.label for rule in together.contestants].index("autostep"), 3, 1)
    second = cells_of(more, together, place, "evaluation")
    assert alone.contestants[2].label == "autostep"
    assert [cell.key for cell in first] == [cell.key for cell in second][:5] and len(second) == 10


def test_references_always_take_part() -> None:
    assert [rule.label for rule in track_of(SMALL, "B").contestants] == ["constant", "polynomial", "autostep", "Method 7"]


# Choosing

#: Three settings, three environments: the first is good in two of them, the second nowhere bad, the third best in the last
MEANS = np.array([[1.0, 0.9, 0.0], [0.8, 0.7, 0.6], [0.1, 0.0, 1.0]])


def test_default_is_the_first_setting() -> None:
    assert [choose(MEANS, task, "default") for task in range(3)] == [0, 0, 0]


def test_best_setting_in_each_environment() -> None:
    assert [choose(MEANS, task, "per environment") for task in range(3)] == [0, 0, 2]


def test_one_for_all_is_chosen_on_the_other_environments() -> None:
    """Left out the third, the first setting is best on the rest; left out another, the second is: it is good in the third."""
    assert [choose(MEANS, task, "one for all") for task in range(3)] == [1, 1, 0]


def test_one_environment_has_no_others_to_choose_on() -> None:
    assert choose(MEANS[:, [2]], 0, "one for all") == 2


def made_up(*scores: float, runs: int = 3) -> Runs:
    return Runs(np.tile(scores, (runs, 1)), np.zeros(runs), [])


def test_disasters_are_clipped_before_they_are_averaged_over_environments() -> None:
    track = track_of(SMALL, "B")
    assert anytime(track, made_up(-1000.0, 0.9), 1.0) == pytest.approx([-0.5] * 3)
    assert anytime(track, made_up(0.5, 0.9), 1.0) == pytest.approx([0.7] * 3)


def test_prediction_is_measured_by_the_best_constant_step_size() -> None:
    settings = LeagueSettings(tracks=("C",), methods=("constant", "7"))
    track = track_of(settings, "C")
    track = track._replace(tasks=track.tasks[:1], contestants=(track.contestants[0], track.contestants[2]))
    track = track._replace(
        contestants=(track.contestants[0]._replace(settings=({"alpha": 0.1}, {"alpha": 0.2})), track.contestants[1])
    )
    runs = {(0, 0, 0): made_up(0.4, 0.4), (0, 1, 0): made_up(0.1, 0.3), (1, 0, 0): made_up(0.5, 0.3)}
    assert prediction_scale(track, runs) == pytest.approx([0.2])
    assert [means[:, 0].tolist() for means in tuning_scores(track, runs)] == [pytest.approx([0.5, 1.0]), pytest.approx([0.5])]
    assert anytime(track, made_up(np.inf, np.inf), 0.2) == pytest.approx([0.0] * 3)


def test_settings_are_named_by_what_varies() -> None:
    track = track_of(SMALL, "B")
    assert setting_text(track.contestants[2], 0) == "meta_step_size = 0.01, alpha_0 = 0.1"
    assert setting_text(track.contestants[3], 0) == "as published"


# A user's own


def test_own_rule_with_a_grid_and_own_environment() -> None:
    settings = LeagueSettings(
        tracks=("A", "B"), methods=(f"{OWN}Halving",), environments=(f"{OWN}make_lake",), sweep=("divisor=2,4,8",), steps=5000
    )
    estimation, control = settings.chosen_tracks()
    rule = control.contestants[-1]
    assert (rule.label, rule.settings) == ("Halving", ({"divisor": 2}, {"divisor": 4}, {"divisor": 8}))
    assert estimation.tasks == control.tasks == (Task(f"{OWN}make_lake", f"{OWN}make_lake", "your own", 5000, 0.99),)
    (cell, *_) = cells_of(settings, control, (2, 0, 0), "tuning")
    assert set(cell.recipe["sources"]) == {"tests.helpers.own_rules"}


def test_own_algorithm() -> None:
    settings = LeagueSettings(tracks=("B",), methods=("constant",), algorithm=f"{OWN}OwnAlgorithm", environments=("chain",))
    assert track_of(settings, "B").contestants[0].label == "constant (OwnAlgorithm)"


def test_environment_without_a_reference_is_judged_by_rollouts_on_a_scale() -> None:
    name = f"{OWN}CountingEnv"
    with pytest.raises(DesignError) as caught:
        LeagueSettings(tracks=("B",), environments=(name,)).chosen_tracks()
    assert "`P[state][action]`" in str(caught.value) and f"--scale {name}=LOW,HIGH" in str(caught.value)
    track = track_of(LeagueSettings(tracks=("B",), environments=(name,), scale=(f"{name}=1,2",)), "B")
    assert track.tasks[0].scale == (1.0, 2.0)


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["--methods", "autosteb"], "Did you mean 'autostep'"),
        (["--methods", "constant", "constant"], "must not repeat an entry"),
        (["--env", "lake5"], "Did you mean 'lake"),
        (["--env", f"{OWN}Nothing"], "Cannot import"),
        (["--algorithm", "sarsi"], "Did you mean 'sarsa'"),
        (["--tracks", "D"], "Unknown track 'D'"),
        (["--runs", "1"], "`runs` must be a whole number from 2"),
        (["--gamma", "2"], "`gamma` must be a number from 0 to 1"),
        (["--scale", "taxi"], "A scale is environment=low,high"),
        (["--scale", "taxi=8,1"], "low below high"),
        (["--scale", "taxy=1,8"], "Did you mean 'taxi'"),
        (["--scale", "taxi", "--scale", "lake4"], "A scale is environment=low,high"),
        (["--scale", "taxi=1,8", "--scale", "taxi=1,9"], "--scale taxi=... is given more than once"),
        (["--env", f"{OWN}mirrored_lake", "--steps", "50"], "MirroredActions may change actions, rewards or observations"),
        (["--env", f"{OWN}broken"], "cannot be made: RuntimeError: no such luck ("),
        (["--env", "Chain-v0", "--steps", "24"], "A run of 2 steps is too short for 5 checkpoints"),
        (["--sweep", "alpha"], "A sweep is name=value,value"),
        (["--sweep", "alpha=0.1,0.2"], "The sweep of alpha would change nothing"),
        (["--quik"], "Perhaps you meant: --quick"),
        (["--config", "/does/not/exist.yml"], "Cannot read"),
    ],
)
def test_bad_option_is_refused(arguments: list[str], part: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        status = main(["--output", str(tmp_path / "league"), "--steps", "25", "--quick", *arguments])
    except SystemExit as error:
        status = int(error.code or 0)
    message = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert status == 2 and part in message and "Traceback" not in message
    assert not (tmp_path / "league").exists()


def test_a_quick_look_draws_fewer_bootstrap_samples() -> None:
    whole, quick = LeagueSettings(), LeagueSettings(quick=True)
    assert (whole.bootstrap_samples, quick.bootstrap_samples) == (50_000, 2000)
    assert LeagueSettings(quick=True, resamples=200).bootstrap_samples == 200
    assert not design_remark(whole) and "1000 bootstrap samples" in design_remark(LeagueSettings(resamples=1000))


def test_a_league_in_which_every_run_failed_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    few = ["--quick", "--runs", "2", "--tuning-runs", "2", "--resamples", "20", "--workers", "1", "--no-progress"]
    arguments = ["--env", "Pendulum-v1", "--scale", "Pendulum-v1=-1200,-200", "--methods", "constant", "--tracks", "B", *few]
    assert main(["--output", str(tmp_path / "league"), "--steps", "50", *arguments]) == 1
    assert re.search("Every run of track B failed.*The first one: ValueError: A tabular algorithm n", capsys.readouterr().err)


def test_the_record_of_a_league_is_a_configuration() -> None:
    settings = LeagueSettings(
        environments=("taxi", "lake4"), scale=("taxi=1,8", "lake4=0,1"), sweep=("speed=0.1,0.2",), runs=7
    )
    options = options_of(yaml.safe_load(yaml.safe_dump(settings.as_data())))
    assert parse(LeagueOptions, "league", options).design == settings


def test_greedy_episodes_end_where_the_environment_has_no_limit() -> None:
    """gymnasium's cliff without a limit: upwards from the start against the wall, at -1 a step."""
    assert player("CliffWalking-v1", {})(np.zeros((48, 4))).tolist() == [-1000.0] * 20
