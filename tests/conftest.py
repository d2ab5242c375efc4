"""What holds for all tests."""

from hypothesis import settings

# How long an example takes is no test: on a busy machine it would fail for no reason
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")
