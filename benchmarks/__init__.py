"""Speed, always as a ratio of two things that were measured in turn in the same run."""
