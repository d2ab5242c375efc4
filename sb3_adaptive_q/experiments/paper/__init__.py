"""The paper's experiment: every method in every system, many times, and what follows from it."""
