"""Machine code from plain functions: copies that nothing changes, what is asked of Numba, and the loops."""
