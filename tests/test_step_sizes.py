"""The catalogue of step sizes as data: names, parameters, messages, the listing, and the paper's rules beside it."""

import inspect
import io
import math
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from helpers.one_cell import make_step
from helpers.paper_learner import paper_rates
from hypothesis import given, settings
from hypothesis import strategies as st

from sb3_adaptive_q import step_sizes
from sb3_adaptive_q.algorithms.td_update import Agent, Memory, Transition
from sb3_adaptive_q.step_sizes import STEP_SIZES, Description, Parameter, describe, find_step_size, paper, resolve_parameters
from sb3_adaptive_q.step_sizes.adaptive import delta_bar_delta, have_opposite_signs, obgd
from sb3_adaptive_q.step_sizes.cells import MOST_ARRAYS, SCOPES, make_size, scope_shape
from sb3_adaptive_q.step_sizes.counts import horizon

NAMES = list(STEP_SIZES)
PARAMETERS = [(name, key) for name, step_size in STEP_SIZES.items() for key in step_size.parameters]


class TestCatalogue:
    def test_what_it_holds(self) -> None:
        expected = """constant polynomial harmonic unbiased_constant bakf autostep delta_bar_delta trigg mcclain kesten
            horizon rescaled_linear idbd search_then_converge benveniste swift_td k1 obgd rmsprop adagrad"""
        assert NAMES == expected.split()

    @pytest.mark.parametrize("name", NAMES)
    def test_function_and_data_agree(self, name: str) -> None:
        """The arguments of the function are μ, the step, the parameters, and the arrays, by name and in this order."""
        step_size = find_step_size(name)
        arguments = list(inspect.signature(step_size.step_size).parameters)
        assert arguments == ["mu", "step", *step_size.parameters, *step_size.memory]
        assert len(arguments) <= 9
        assert step_size.name == name == step_size.step_size.__name__
        assert (step_size.lower, step_size.upper) == (0.0, 1.0)
        assert "\n" not in step_size.formula + step_size.source
        assert step_size.counts == ("step.count" in inspect.getsource(step_size.step_size))
        assert ":return:" in (step_size.step_size.__doc__ or "")

    @pytest.mark.parametrize("name", NAMES)
    def test_every_memory_starts_from_a_number(self, name: str) -> None:
        step_size = find_step_size(name)
        starts = step_size.start_values(resolve_parameters(name, {}))
        assert starts.keys() == step_size.memory.keys()
        assert all(type(start) is float and math.isfinite(start) for start in starts.values())

    def test_the_memory_starts_from_the_given_parameters(self) -> None:
        def starts(name: str, **given: float) -> dict[str, float]:
            return find_step_size(name).start_values(resolve_parameters(name, given))

        assert starts("autostep", alpha_0=0.25) == {"size": 0.25, "trace": 0.0, "normalizer": 0.0}
        assert starts("idbd", alpha_0=1.0) == {"log_size": 0.0, "trace": 0.0}
        assert starts("k1", alpha_0=0.5) == {"log_gain": 0.0, "trace": 0.0}
        assert starts("swift_td", alpha_0=0.5, eta=0.25)["log_size"] == math.log(0.25)

    def test_it_is_independent_of_numba_and_of_stable_baselines(self) -> None:
        folder = Path(step_sizes.__file__).parent
        for path in folder.glob("*.py"):
            imports = [line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith(("import", "from"))]
            for line in imports:
                assert not any(word in line for word in ("numba", "stable_baselines3", "torch"))
                own = line.partition("sb3_adaptive_q.")[2]
                assert not own or own.startswith(("step_sizes", "output "))


class TestByHand:
    """Borders that the golden sequences do not touch."""

    @pytest.mark.parametrize(
        ("first", "second", "opposite"),
        [(-1.0, 1.0, True), (1.0, -1.0, True), (1.0, 2.0, False), (-1.0, 0.0, False), (0.0, 1.0, False), (1.0, 0.0, False)],
    )
    def test_signs(self, first: float, second: float, opposite: bool) -> None:
        assert have_opposite_signs(first, second) is opposite

    def test_delta_bar_delta(self) -> None:
        """Errors 1, 1, 0, 1, -1 with κ = 0.5 and φ = 0.5: up, up to 1 and no further, the same, 1 again, half of it."""
        size, mean_error = np.full((1, 1), 0.25), np.zeros((1, 1))
        sizes = [
            delta_bar_delta(0.0, make_step(td_error=error), 0.25, 0.5, 0.5, 0.5, size, mean_error)
            for error in (1.0, 1.0, 0.0, 1.0, -4.0)
        ]
        assert sizes == [0.25, 0.75, 0.75, 1.0, 0.5]

    @pytest.mark.parametrize(
        ("alpha", "kappa", "error", "size"), [(1.0, 0.5, 1.0, 1.0), (1.0, 0.5, 8.0, 0.25), (0.5, 4.0, 0.5, 0.25)]
    )
    def test_obgd(self, alpha: float, kappa: float, error: float, size: float) -> None:
        """α / max(1, α κ max(|δ|, 1))."""
        assert obgd(0.0, make_step(td_error=error), alpha, kappa) == size

    def test_a_horizon_of_0_without_discounting(self) -> None:
        """1/n, as everywhere."""
        assert [horizon(0.0, make_step(count=n, gamma=1.0), 0.0) for n in (1.0, 2.0, 4.0)] == [1.0, 0.5, 0.25]


class TestParameters:
    @pytest.mark.parametrize(("name", "key"), PARAMETERS)
    def test_its_range(self, name: str, key: str) -> None:
        """Bounds count or do not, as declared; one step of a float beyond is refused."""
        parameter = find_step_size(name).parameters[key]
        others = {"upper": 1.0} if key == "lower" else {"lower": 0.0} if key == "upper" else {}
        sides = ((parameter.lower, parameter.open_lower, -math.inf), (parameter.upper, parameter.open_upper, math.inf))
        for bound, is_open, outside in sides:
            allowed = [parameter.default, math.nextafter(bound, -outside)] + ([] if is_open or math.isinf(bound) else [bound])
            for value in allowed:
                assert resolve_parameters(name, {key: value} | others)[key] == value
            for value in [math.nextafter(bound, outside)] + ([bound] if is_open or math.isinf(bound) else []):
                with pytest.raises(ValueError, match=f"'{name}': `{key}` must be a number in"):
                    resolve_parameters(name, {key: value} | others)

    @pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "0.1", None, True, [0.1], 1j, np.bool_(True)])
    def test_what_is_no_number(self, value: object) -> None:
        with pytest.raises(ValueError, match=r"Step size 'constant': `alpha` must be a number in \[0, 1\], but got "):
            resolve_parameters("constant", {"alpha": value})

    @pytest.mark.parametrize("value", [1, np.float32(0.5), np.int64(1), np.float64(0.1)])
    def test_numbers_of_any_kind(self, value: float) -> None:
        resolved = resolve_parameters("constant", {"alpha": value})["alpha"]
        assert resolved == value
        assert type(resolved) is float

    @pytest.mark.parametrize(
        ("name", "given"),
        [
            ("polynomial", {"omega": 1.5}),
            ("polynomial", {"omega": 0.0}),
            ("constant", {"alpha": 1.01}),
            ("harmonic", {"a": 0.0}),
            ("horizon", {"horizon": math.inf}),
            ("autostep", {"meta_step_size": -0.01}),
            ("autostep", {"tau": 0.5}),
            ("k1", {"alpha_0": 1.0}),
            ("idbd", {"alpha_0": 1e-6}),
            ("trigg", {"phi": 0.0}),
            ("rmsprop", {"decay": 1.0}),
            ("rmsprop", {"epsilon": 0.0}),
        ],
    )
    def test_values_that_the_sources_exclude(self, name: str, given: dict[str, float]) -> None:
        with pytest.raises(ValueError, match="must be a number in"):
            resolve_parameters(name, given)

    def test_defaults_are_filled_in_the_functions_order(self) -> None:
        resolved = resolve_parameters("autostep", {"tau": 100, "alpha_0": 1})
        assert list(resolved.items()) == [("alpha_0", 1.0), ("meta_step_size", 0.01), ("tau", 100.0)]
        assert resolve_parameters("rescaled_linear", {}) == {}

    def test_bounds_in_the_wrong_order(self) -> None:
        with pytest.raises(ValueError, match=r"`lower` must not be above `upper`, but got lower=0.5 and upper=0.2"):
            resolve_parameters("benveniste", {"lower": 0.5, "upper": 0.2})

    def test_an_unknown_parameter(self) -> None:
        with pytest.raises(ValueError, match="'idbd' has the parameters alpha_0, theta, but got 'mu'"):
            resolve_parameters("idbd", {"mu": 0.1})
        with pytest.raises(ValueError, match="'rescaled_linear' has no parameters, but got 'gamma'"):
            resolve_parameters("rescaled_linear", {"gamma": 0.9})

    #: The step sizes that are logarithms in their memory have other bounds
    @pytest.mark.parametrize(
        "name", [name for name, key in PARAMETERS if key == "alpha_0" and name not in ("idbd", "k1", "swift_td")]
    )
    def test_a_first_step_size_is_above_0_and_at_most_1(self, name: str) -> None:
        parameter = find_step_size(name).parameters["alpha_0"]
        assert (parameter.range, parameter.meaning) == ("(0, 1]", "the first step size")
        assert resolve_parameters(name, {"alpha_0": 1})["alpha_0"] == 1.0
        for wrong in (0.0, 1.5):
            with pytest.raises(ValueError, match=r"`alpha_0` must be a number in \(0, 1\], but got"):
                resolve_parameters(name, {"alpha_0": wrong})

    def test_the_notation_of_ranges(self) -> None:
        assert Parameter(0.5, 0.0, 1.0, "").range == "[0, 1]"
        assert Parameter(0.5, 0.0, 1.0, "", open_lower=True, open_upper=True).range == "(0, 1)"
        assert Parameter(0.5, -math.inf, math.inf, "").range == "(-inf, inf)"


class TestNames:
    @pytest.mark.parametrize(("wrong", "right"), [("autostp", "autostep"), ("IDBD", "idbd"), ("poly", "polynomial")])
    def test_the_nearest_are_offered(self, wrong: str, right: str) -> None:
        with pytest.raises(ValueError, match=f"There is no step size '{wrong}'. Did you mean .*'{right}'"):
            find_step_size(wrong)

    def test_several_may_be_near(self) -> None:
        with pytest.raises(ValueError, match=r"Did you mean 'constant' or 'unbiased_constant'\?$"):
            find_step_size("constantt")

    @pytest.mark.parametrize("wrong", ["zzz", "", 3, None, ["idbd"]])
    def test_all_are_listed_where_none_is_near(self, wrong: object) -> None:
        with pytest.raises(ValueError, match=r"There is no step size .* The names are constant, polynomial, .*, adagrad"):
            find_step_size(wrong)


class TestListing:
    rows = (Description("7", "μ ← clip(μ + β6) if Q(s', a') ≥ Q(s, a)", ("change = 0.005",), "Çimen et al. 2023"),)

    @pytest.mark.parametrize("encoding", ["utf-8", "cp1252", "ascii", "cp437", None])
    def test_every_method_stands_in_it(self, encoding: str | None) -> None:
        text = describe(self.rows, encoding)
        text.encode(encoding or "ascii")
        heads = [line.partition(" ")[0] for line in text.splitlines() if line and not line.startswith(" ")]
        assert heads[: len(NAMES) + 1] == ["7", *NAMES]

    def test_an_entry(self) -> None:
        entry = """
trigg  (Trigg, Leach 1967)
    E ← (1 - φ) E + φ δ, M ← (1 - φ) M + φ |δ|, μ = |E| / M
    phi = 0.1 in (0, 1]: the weight φ of the newest error
"""
        assert entry in describe()
        assert describe(self.rows).startswith(f"7  (Çimen et al. 2023)\n    {self.rows[0].formula}\n    change = 0.005\n")

    @pytest.mark.parametrize("width", [60, 80, 127])
    def test_it_keeps_to_the_width(self, width: int) -> None:
        text = describe(width=width)
        assert max(len(line) for line in text.splitlines() if line.startswith(" ")) <= width

    def test_signs_are_spelled_out_where_a_terminal_lacks_them(self) -> None:
        text = describe(self.rows, encoding="ascii")
        assert "mu = alpha_0 a / (a + n - 1)" in text
        assert "mu <- clip(mu + beta6) if Q(s', a') >= Q(s, a)" in text
        assert text.replace("least squares?", "").count("?") == 1, "of the name that has a cedilla"

    def test_a_terminal_of_windows(self) -> None:
        """Its encoding has no μ, so that printing would raise."""
        terminal = io.TextIOWrapper(io.BytesIO(), encoding="cp1252")
        print(describe(self.rows, terminal.encoding), file=terminal, flush=True)
        with pytest.raises(UnicodeEncodeError):
            print(describe(self.rows), file=terminal, flush=True)


class TestRulesOfThePaper:
    rules: ClassVar = {
        1: lambda mu, step: paper.constant_rate(mu, step, 0.01),
        2: lambda mu, step: paper.constant_rate(mu, step, 0.05),
        3: lambda mu, step: paper.linear_decay_rate(mu, step, 0.01, 0.04),
        4: lambda mu, step: paper.linear_growth_rate(mu, step, 0.01, 0.04),
        5: lambda mu, step: paper.proportional_rate(mu, step, -0.05, 0.001, 0.01),
        6: lambda mu, step: paper.proportional_rate(mu, step, 0.05, 0.001, 0.01),
        7: lambda mu, step: paper.sign_rate(mu, step, 0.005, 0.001, 0.01),
        8: lambda mu, step: paper.sign_rate(mu, step, -0.005, 0.001, 0.01),
    }

    @pytest.mark.parametrize("number", rules)
    @given(
        mu=st.floats(0.001, 0.01),
        values=st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0)),
        tie=st.booleans(),
        progress=st.floats(0.0, 1.0),
    )
    @settings(max_examples=30)
    def test_against_the_equations(
        self, number: int, mu: float, values: tuple[float, float], tie: bool, progress: float
    ) -> None:
        """Which the tests' own learner writes down a second time."""
        value, next_value = values[0], values[0] if tie else values[1]
        step = make_step(value=value, next_value=next_value, progress=progress)
        expected = paper_rates(float)[number](mu, value, next_value, progress)
        assert self.rules[number](mu, step) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(("scope", "shape"), [("pair", (7, 3)), ("state", (7, 1)), ("shared", (1, 1))])
def test_a_scope_is_a_shape_of_cells(scope: str, shape: tuple[int, int]) -> None:
    assert scope_shape(scope, 7, 3) == shape
    cells = {SCOPES[scope](state, action) for state in range(7) for action in range(3)}
    assert cells == set(np.ndindex(shape))


@pytest.mark.parametrize("n_arrays", range(MOST_ARRAYS + 1))
def test_without_counts_the_arrays_are_the_step_sizes_own(n_arrays: int) -> None:
    """All of them, those of the table that is updated, and the count is 0."""
    seen: list[Any] = []

    def step_size(mu: float, step: Any, *arrays: np.ndarray) -> float:
        seen.append((mu, step.count, [float(array[step.row, step.column]) for array in arrays]))
        return 0.25

    arrays = tuple(np.full((2, 3, 2), float(number)) + np.arange(2.0)[:, None, None] / 8 for number in range(n_arrays))
    memory = Memory(arrays, (), (0.0, 1.0), (), 1)
    agent = Agent(0.9, 0.0, 0.5, 0.0, 0, 0, ())
    transition = Transition(2, 1, 1.0, 0, False, False, 0)
    update = make_size(step_size, "pair", False, n_arrays)(memory, agent, transition, 0.5, 2.0, 1.5)
    assert seen == [(0.5, 0.0, [number + 0.125 for number in range(n_arrays)])]
    assert (update.count, update.size) == (0.0, 0.25)
    assert all((array[1] == number + 0.125).all() for number, array in enumerate(arrays))
