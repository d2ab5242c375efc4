"""
The two sources of random numbers, as plain arithmetic on unsigned 64-bit numbers: the state of each is data.

The agent draws from a counter of its own. A built-in environment's compiled dynamics draw the very numbers of gymnasium's
generator.
"""

from typing import Any

import numpy as np

# SplitMix64 (Steele, Lea and Flood, 2014)
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_S27, _S30, _S31 = np.uint64(27), np.uint64(30), np.uint64(31)
# PCG64 (O'Neill, 2014): the multiplier's halves
_MULTIPLIER_HIGH, _MULTIPLIER_LOW = np.uint64(2549297995355413924), np.uint64(4865540595714422341)
_S11, _S32, _S58, _S63, _S64 = np.uint64(11), np.uint64(32), np.uint64(58), np.uint64(63), np.uint64(64)
_LOW_HALF = np.uint64(0xFFFFFFFF)
_WORD = 2**64
#: The distance of two neighbouring numbers that are drawn
_UNIT = 1.0 / 9007199254740992.0


def uniform(draws):
    """
    :param draws: the agent's counter, an array of one uint64; moved on in place
    :return: a number in [0, 1), by SplitMix64 (Steele, Lea and Flood, 2014)
    """
    counter = draws[0] + _GOLDEN
    draws[0] = counter
    mixed = (counter ^ (counter >> _S30)) * _FIRST
    mixed = (mixed ^ (mixed >> _S27)) * _SECOND
    return float((mixed ^ (mixed >> _S31)) >> _S11) * _UNIT


def random_float(generator):
    """
    :param generator: the state of a PCG64, four uint64: high and low half of its state, then of its increment; moved on
        in place
    :return: the number that ``numpy.random.Generator(PCG64).random()`` would give next
    """
    high, low = generator[0], generator[1]
    # The 128-bit product with the multiplier, from products of half words
    low_low, low_high = low & _LOW_HALF, low >> _S32
    times_low, times_high = _MULTIPLIER_LOW & _LOW_HALF, _MULTIPLIER_LOW >> _S32
    bottom = low_low * times_low
    middle = low_high * times_low + (bottom >> _S32)
    cross = low_low * times_high + (middle & _LOW_HALF)
    carry = low_high * times_high + (middle >> _S32) + (cross >> _S32)
    high = high * _MULTIPLIER_LOW + low * _MULTIPLIER_HIGH + carry
    product = low * _MULTIPLIER_LOW
    low = product + generator[3]
    high = high + generator[2] + (np.uint64(1) if low < product else np.uint64(0))
    generator[0], generator[1] = high, low
    # The output folds the halves and rotates them
    folded, turn = high ^ low, high >> _S58
    rotated = (folded >> turn) | (folded << ((_S64 - turn) & _S63))
    return float(rotated >> _S11) * _UNIT


def draw_place(cumulative, generator):
    """
    Draw from probabilities, as gymnasium's ``categorical_sample`` does.

    :param cumulative: cumulative probabilities, of shape (n,)
    :param generator: as for :func:`random_float`
    :return: the first place whose cumulative probability is above the number drawn; 0 where rounding leaves none
    """
    # NumPy's searchsorted does the same, and takes half a second to compile
    number, low, high = random_float(generator), 0, cumulative.shape[0]
    while low < high:
        middle = (low + high) >> 1
        if cumulative[middle] <= number:
            low = middle + 1
        else:
            high = middle
    return low if low < cumulative.shape[0] else 0


def first_counter(seed: np.random.SeedSequence) -> int:
    """
    :param seed: where the agent's random numbers come from
    :return: the counter to begin with
    """
    return int(seed.generate_state(1, np.uint64)[0])


def read_pcg64(generator: np.random.Generator, words: np.ndarray) -> None:
    """
    :param generator: an environment's ``np_random``
    :param words: four uint64, which are set to its state
    :raises ValueError: if it is no PCG64, which gymnasium's generators are
    """
    state: Any = generator.bit_generator.state
    if state["bit_generator"] != "PCG64":
        raise ValueError(
            f"Compiled environments draw from gymnasium's PCG64 generator, but this one has a {state['bit_generator']}: use "
            "LeanVecEnv, which works with every generator."
        )
    number, increment = state["state"]["state"], state["state"]["inc"]
    words[:] = [number // _WORD, number % _WORD, increment // _WORD, increment % _WORD]


def write_pcg64(generator: np.random.Generator, words: np.ndarray) -> None:
    """
    :param generator: an environment's ``np_random``, whose state is set
    :param words: four uint64, the state
    """
    high, low, _, _ = words.tolist()
    state: Any = generator.bit_generator.state
    generator.bit_generator.state = {**state, "state": {**state["state"], "state": high * _WORD + low}}
