"""Writes the catalogue of step sizes: what the registry says of each, and what each does on two small problems."""

import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import gymnasium as gym
import numpy as np
from docstring_parser import DocstringStyle, parse
from matplotlib import rc_context
from matplotlib.backends.backend_svg import FigureCanvasSVG
from typeset import to_latex

from sb3_adaptive_q import STEP_SIZES
from sb3_adaptive_q.plots.style import COLORS, STYLE, PlotFigure, tidy
from sb3_adaptive_q.step_sizes import Step, StepSize, clip_size

RUNS, UPDATES, START, GAMMA = 30, 400, 4.0, 0.9
#: The variance of a step of the mean, by the problem's name
PROBLEMS = {"noisy": 0.0, "moving": 0.01}
#: What is shown of the first run, the same for all step sizes
LIMITS = {"noisy": (-1.5, START + 0.5), "moving": (-6.5, START + 0.5)}


class Problem(NamedTuple):
    """
    Random targets around a mean.

    :param targets: of shape (RUNS, UPDATES)
    :param means: of the same shape
    """

    targets: np.ndarray
    means: np.ndarray


class Course(NamedTuple):
    """
    What a step size makes of a problem.

    :param estimates: after each update, of shape (RUNS, UPDATES)
    :param sizes: of each update, of the same shape
    """

    estimates: np.ndarray
    sizes: np.ndarray


def write(folder: Path) -> None:
    """
    Write ``step_sizes.md`` and a picture for each step size. What has not changed is not written again.

    :param folder: where to
    """
    folder.mkdir(exist_ok=True)
    problems = {name: draw_targets(variance) for name, variance in PROBLEMS.items()}
    courses = {name: {key: follow(each, problem) for key, problem in problems.items()} for name, each in STEP_SIZES.items()}
    for name in STEP_SIZES:
        write_picture(folder / f"{name}.svg", problems, courses[name])
    sections = [section(each) for each in STEP_SIZES.values()]
    write_if_new(folder / "step_sizes.md", "\n\n".join([error_table(problems, courses), *sections]) + "\n")


def draw_targets(variance: float) -> Problem:
    """
    :param variance: of a step of the mean
    :return: the rewards of DriftingMean-v0, whose noise has the variance 1, in ``RUNS`` runs with the seeds 0, 1, ...
    """
    env = gym.make("DriftingMean-v0", variance=variance)
    targets, means = np.zeros((RUNS, UPDATES)), np.zeros((RUNS, UPDATES))
    for run in range(RUNS):
        env.reset(seed=run)
        for i in range(UPDATES):
            _, targets[run, i], _, _, info = env.step(0)
            means[run, i] = info["mean"]
    return Problem(targets, means)


def follow(each: StepSize, problem: Problem) -> Course:
    """
    :param each: a step size, with its default parameters
    :param problem: what to estimate
    :return: its estimates, which start from ``START``, and the step sizes
    """
    parameters = {name: parameter.default for name, parameter in each.parameters.items()}
    course = Course(np.zeros_like(problem.targets), np.zeros_like(problem.targets))
    for run, targets in enumerate(problem.targets):
        memory = [np.full((1, 1), start) for start in each.start_values(parameters).values()]
        estimate = START
        for i, target in enumerate(targets):
            error = float(target) - estimate
            step = Step(0, 0, 0, 0, i + 1.0, estimate, 0.0, error, i / UPDATES, GAMMA, 0.0)
            size = clip_size(each.step_size(0.0, step, *parameters.values(), *memory), each.lower, each.upper)
            estimate += size * error
            course.estimates[run, i], course.sizes[run, i] = estimate, size
    return course


def error_table(problems: dict[str, Problem], courses: dict[str, dict[str, Course]]) -> str:
    """
    :param problems: the problems by name
    :param courses: what each step size made of each of them
    :return: a table of the root mean square errors over the last quarter of the updates
    """
    rows = ["| `method` | noisy | moving | source |", "| --- | ---: | ---: | --- |"]
    for name, course in courses.items():
        last = [(course[key].estimates - problem.means)[:, -UPDATES // 4 :] for key, problem in problems.items()]
        errors = " | ".join(f"{np.sqrt(np.mean(each**2)):.2f}" for each in last)
        rows.append(f"| [`{name}`](#{name.replace('_', '-')}) | {errors} | {STEP_SIZES[name].source} |")
    return "\n".join(rows)


def section(each: StepSize) -> str:
    """
    :param each: a step size
    :return: its part of the page
    """
    text = parse(inspect.getdoc(each.step_size) or "", DocstringStyle.REST)
    meanings = {parameter.arg_name: parameter.description or "" for parameter in text.params}
    starts = each.start_values({name: parameter.default for name, parameter in each.parameters.items()})
    lines = [f"({each.name.replace('_', '-')})=", f"### {each.name}", "", " ".join((text.description or "").split()), ""]
    lines += ["$$", to_latex(each.formula, tuple(each.parameters)), "$$", "", f"Source: {each.source}.", ""]
    lines += list(table(("parameter", "default", "range", "meaning"), _parameter_rows(each)))
    memory = [(f"`{name}`", f"{start:.4g}", " ".join(meanings[name].split())) for name, start in starts.items()]
    if each.counts:
        memory.append(("`visits`", "0", "n, the number of updates"))
    lines += list(table(("memory of each cell", "starts from", "meaning"), memory))
    lines += [f"![μ and the estimate with {each.name}, on the noisy and on the moving problem](generated/{each.name}.svg)"]
    return "\n".join(lines)


def _parameter_rows(each: StepSize) -> list[tuple[str, ...]]:
    return [
        (f"`{name}`", f"{parameter.default:g}", parameter.range.replace("inf", "∞"), parameter.meaning)
        for name, parameter in each.parameters.items()
    ]


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> Iterator[str]:
    """
    :param head: the titles of the columns
    :param rows: the cells
    :return: the lines of a Markdown table and an empty one, or nothing where there are no rows
    """
    if rows:
        for row in (head, ("---",) * len(head), *rows):
            yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |"
        yield ""


def write_picture(path: Path, problems: dict[str, Problem], courses: dict[str, Course]) -> None:
    """
    :param path: of the picture
    :param problems: the problems by name
    :param courses: what a step size made of each of them
    """
    # Text as text and numbers of its own for the parts make the file small, and the same whenever it is made
    with rc_context({**STYLE, "svg.fonttype": "none", "svg.hashsalt": "step sizes", "path.simplify_threshold": 0.5}):
        figure = PlotFigure(figsize=(8.0, 3.4), layout="constrained")
        axes = figure.subplots(2, 2, sharex=True, height_ratios=(1.5, 1.0))
        for column, (name, problem) in enumerate(problems.items()):
            _draw_course(axes[:, column], problem, courses[name])
            axes[0, column].set_title(f"{name} targets", loc="left", fontsize="medium")
            axes[0, column].set_ylim(LIMITS[name])
            axes[1, column].set_xlabel("n")
        axes[0, 0].set_ylabel("first run")
        axes[0, 0].legend(loc="upper right", frameon=False, fontsize="small", ncols=2)
        axes[1, 0].set_ylabel("μ")
        FigureCanvasSVG(figure).print_svg(path, metadata={"Date": None})


def _draw_course(axes: np.ndarray, problem: Problem, course: Course) -> None:
    n = np.arange(1, UPDATES + 1)
    top, bottom = axes
    top.plot(n, problem.means[0], color=COLORS[1], linestyle="--", linewidth=1.2, label="mean of the targets", zorder=3)
    top.plot(n, course.estimates[0], color=COLORS[0], linewidth=1.0, label="estimate")
    low, middle, high = np.quantile(course.sizes, (0.1, 0.5, 0.9), axis=0)
    bottom.fill_between(n, low, high, color=COLORS[6], linewidth=0)
    bottom.plot(n, middle, color=COLORS[0], linewidth=1.0)
    bottom.set(yscale="log", ylim=(0.001, 1.5), yticks=(0.001, 0.01, 0.1, 1.0), yticklabels=("0.001", "0.01", "0.1", "1"))
    for ax in (top, bottom):
        tidy(ax)


def write_if_new(path: Path, text: str) -> None:
    """
    :param path: of the file
    :param text: what it shall hold; where it does already, the file keeps its time, and Sphinx does not read it again
    """
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")
