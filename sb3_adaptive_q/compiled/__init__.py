"""Machine code from plain functions: what is asked of Numba, the digest of what was frozen, and the loops."""
