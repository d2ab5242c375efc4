"""The two training loops: one step at a time, and compiled."""
