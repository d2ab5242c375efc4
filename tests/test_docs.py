"""What the documentation is made from: formulas, the small problems of the catalogue, and the table of log tags."""

import re
import sys
from pathlib import Path

import gymnasium as gym
import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.mathtext import MathTextParser
from stable_baselines3.common.logger import KVWriter, Logger

from sb3_adaptive_q import METHODS, STEP_SIZES, TabularQ

mpl.use("Agg")

DOCS = Path(__file__).parent.parent / "docs"


@pytest.fixture
def catalogue(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(DOCS)
    import catalogue

    yield catalogue
    for name in ("catalogue", "typeset"):
        sys.modules.pop(name)


class TestFormulas:
    @pytest.mark.parametrize(
        "name, latex",
        [
            ("search_then_converge", r"μ = \frac{α_0 (1 + x)}{1 + x + τ u^2} \\ u = \frac{n - 1}{τ} \\ x = \frac{c u}{α_0}"),
            ("k1", r"β \leftarrow β + θ δ h \\ μ = \frac{e^{β}}{1 + e^{β}} \\ h \leftarrow (h + μ δ) (1 - μ)"),
            ("rmsprop", r"v \leftarrow b v + (1 - b) δ^2 \\ μ = \frac{α}{\sqrt{v + ε}}"),
            ("obgd", r"μ = \frac{α}{\max(1 , α κ \max(|δ| , 1))}"),
            ("mcclain", r"μ \leftarrow \frac{μ}{1 + μ - \mathit{target}\,} \\ μ = α_0 \text{ at } n = 1"),
        ],
    )
    def test_as_one_would_write_them(self, catalogue, name, latex):
        each = STEP_SIZES[name]
        assert catalogue.to_latex(each.formula, tuple(each.parameters)) == rf"\begin{{gathered}}{latex}\end{{gathered}}"

    def test_all_are_valid(self, catalogue):
        parser = MathTextParser("path")
        formulas = [(each.formula, tuple(each.parameters)) for each in STEP_SIZES.values()]
        for formula, names in formulas + [(each.formula, ("t_max",)) for each in METHODS.values()]:
            body = catalogue.to_latex(formula, names)[len(r"\begin{gathered}") : -len(r"\end{gathered}")]
            for line in body.split(r" \\ "):
                parser.parse(f"${line.replace('text', 'mathrm')}$")
                assert body.count("(") == body.count(")") and body.count("{") == body.count("}")


class TestCatalogue:
    def test_a_constant_has_the_error_that_is_known(self, catalogue):
        """Muth (1960): before an update the error has the variance (μ² + q) / (μ (2 - μ)), where the noise has 1."""
        mu = STEP_SIZES["constant"].parameters["alpha"].default
        for variance in (0.0, 0.01):
            problem = catalogue.draw_targets(variance)
            estimates = catalogue.follow(STEP_SIZES["constant"], problem).estimates
            errors = (problem.means[:, 1:] - estimates[:, :-1])[:, 100:]
            # Successive errors share most of their targets: of 9000, about 9000 μ / 2 are independent
            assert np.mean(errors**2) == pytest.approx((mu**2 + variance) / (mu * (2 - mu)), rel=4 * np.sqrt(2 / 450))

    def test_the_harmonic_one_gives_the_mean(self, catalogue):
        problem = catalogue.draw_targets(0.01)
        estimates = catalogue.follow(STEP_SIZES["harmonic"], problem).estimates
        means = np.cumsum(problem.targets, axis=1) / np.arange(1, problem.targets.shape[1] + 1)
        np.testing.assert_allclose(estimates, means, atol=1e-12)

    def test_a_section_says_what_the_registry_says(self, catalogue):
        text = catalogue.section(STEP_SIZES["bakf"])
        assert "| `nu_target` | 0.05 | [0, 1] |" in text and "George, Powell 2006" in text
        assert {f"`{name}`" for name in (*STEP_SIZES["bakf"].memory, "visits")} <= set(re.findall("`[a-z_]+`", text))


class Recorder(KVWriter):
    def __init__(self) -> None:
        self.tags: dict[str, bool] = {}

    def write(self, key_values, key_excluded, step=0):
        self.tags |= {key: "tensorboard" in (key_excluded[key] or ()) for key in key_values}

    def close(self) -> None:
        pass


class Success(gym.Wrapper):
    def step(self, action):
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated, truncated, info | {"is_success": reward > 0}


def test_the_table_of_log_tags_is_complete():
    recorder = Recorder()
    model = TabularQ("MlpPolicy", Success(gym.make("FrozenLake-v1")), seed=0)
    model.set_logger(Logger(None, [recorder]))
    model.learn(1000, log_interval=10)
    rows = re.findall(r"^\| `(\S+)` \| (.*?) \|", (DOCS / "log_tags.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert {tag: "not in TensorBoard" in meaning for tag, meaning in rows} == recorder.tags
