"""One file an algorithm: its update as a plain function, and its class."""
