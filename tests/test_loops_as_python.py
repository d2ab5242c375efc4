"""The loops are plain Python functions: run as such, without the compiler, they give what machine code gives, in every bit."""

import numpy as np
import pytest
from helpers.both_paths import assert_same, learn, make_model

from sb3_adaptive_q.compiled.jit import as_python
from sb3_adaptive_q.rollouts import compiled_rollout
from sb3_adaptive_q.rollouts.compiled_rollout import CompiledRollout


@pytest.fixture
def no_compiler(monkeypatch):
    """Python reads a record's fields by their names only where NumPy is told so."""
    for name in ("ENV", "EPISODE", "CONTROL"):
        monkeypatch.setattr(compiled_rollout, name, np.dtype((np.record, getattr(compiled_rollout, name))))
    arguments = CompiledRollout._arguments

    def with_records(rollout, record):
        tables, memory, learner, *rest = arguments(rollout, record)
        return tables, memory, learner.view(np.recarray), *rest

    monkeypatch.setattr(CompiledRollout, "_arguments", with_records)
    monkeypatch.setattr(compiled_rollout, "machine_code", lambda function, arguments: as_python(function))


@pytest.mark.parametrize("n_envs", [1, 3])
@pytest.mark.parametrize("name", ["slippery lake", "CartPole", "CartPoleFriction"])
def test_the_same_bits(name, n_envs, no_compiler, monkeypatch):
    in_python = learn(make_model(name, True, n_envs, method=7, callback_interval=100), 600)
    monkeypatch.undo()
    assert_same(in_python, learn(make_model(name, True, n_envs, method=7, callback_interval=100), 600))
