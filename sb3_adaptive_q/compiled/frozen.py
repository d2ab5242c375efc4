"""
Holds copies of functions under names that contain the digest of their source, so that Numba's disk cache finds a function
by its content; see :func:`sb3_adaptive_q.compiled.freezing.freeze`. The functions are put here at run time.
"""
