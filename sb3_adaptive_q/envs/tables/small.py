"""Small processes with one difficulty each: a rare reward, a delayed choice, many noisy actions."""

from sb3_adaptive_q.envs.tables.types import Outcome, Start, Table, ended, start_in


def river_swim(largest_reward: float = 1.0, starts: tuple[int, ...] = (0,)) -> tuple[Table, Start]:
    """
    Build RiverSwim (Strehl and Littman, 2008): to swim right is hard, and pays only at the end.

    Action 0 goes left, surely, and pays 5 in the leftmost of 6 states; action 1 tries to go right, and pays 10 000 where it
    stays in the rightmost. All rewards are divided by 10 000 unless ``largest_reward`` says otherwise.

    :param largest_reward: 10 000 in the publication
    :param starts: where episodes begin, each equally often; (1, 2) in the publication
    :return: table and start distribution
    """
    small = 5e-4 * largest_reward
    swims = _swims((0.7, 0.3), (0.1, 0.6, 0.3), (0.7, 0.3))
    return _river(swims, small, largest_reward), start_in(6, *starts)


def river_swim_osband() -> tuple[Table, Start]:
    """
    Build the RiverSwim of Osband, Russo and Van Roy (2013): other probabilities, rewards of 0.005 and 1.

    :return: table and start distribution
    """
    return _river(_swims((0.4, 0.6), (0.05, 0.6, 0.35), (0.4, 0.6)), 0.005, 1.0), start_in(6, 0)


def _swims(first: tuple[float, ...], inner: tuple[float, ...], last: tuple[float, ...]) -> list[list[tuple[float, int]]]:
    """For each state the (probability, next state) of swimming right, from left to right."""
    return [
        list(zip(first, (0, 1), strict=True)),
        *(list(zip(inner, (state - 1, state, state + 1), strict=True)) for state in range(1, 5)),
        list(zip(last, (4, 5), strict=True)),
    ]


def _river(swims: list[list[tuple[float, int]]], small: float, large: float) -> Table:
    return {
        state: {
            0: [(1.0, max(state - 1, 0), small if state == 0 else 0.0, False)],
            1: [(p, to, large if state == to == 5 else 0.0, False) for p, to in swims[state]],
        }
        for state in range(6)
    }


def chain(slip: float = 0.2) -> tuple[Table, Start]:
    """
    Build the chain of 5 states (Strens, 2000).

    Action 0 goes forward, and pays 10 where it stays in the last state; action 1 goes back to the first state and pays 2.

    :param slip: the probability that the other action's effect and reward come about
    :return: table and start distribution
    """

    def row(state: int) -> dict[int, list[Outcome]]:
        forward = (min(state + 1, 4), 10.0 if state == 4 else 0.0, False)
        back = (0, 2.0, False)
        return {0: [(1.0 - slip, *forward), (slip, *back)], 1: [(1.0 - slip, *back), (slip, *forward)]}

    return {state: row(state) for state in range(5)}, start_in(5, 0)


def double_loop() -> tuple[Table, Start]:
    """
    Build the double loop of 9 states (Watkins, 1989; Dearden, Friedman and Russell, 1998).

    From state 0 action 0 enters the right loop (1 to 4), which any action completes for a reward of 1 after 5 steps;
    action 1 enters the left loop (5 to 8), which pays 2 if action 1 is taken in 5, 6 and 7, where action 0 goes back to 0. In
    state 8 both actions complete it.

    :return: table and start distribution
    """

    def always(state: int, reward: float = 0.0) -> list[Outcome]:
        return [(1.0, state, reward, False)]

    table = {0: {0: always(1), 1: always(5)}}
    table |= {state: {0: always(state + 1), 1: always(state + 1)} for state in (1, 2, 3)}
    table |= {state: {0: always(0), 1: always(state + 1)} for state in (5, 6, 7)}
    table |= {4: {0: always(0, 1.0), 1: always(0, 1.0)}, 8: {0: always(0, 2.0), 1: always(0, 2.0)}}
    return dict(sorted(table.items())), start_in(9, 0)


def six_arms() -> tuple[Table, Start]:
    """
    Build SixArms (Strehl and Littman, 2008): the less likely an arm lets one in, the better it pays.

    From state 0 action i leads to state i + 1 with its probability. There action i pays for ever; all others lead back.

    :return: table and start distribution
    """
    arms = zip((1.0, 0.15, 0.1, 0.05, 0.03, 0.01), (50.0, 133.0, 300.0, 800.0, 1660.0, 6000.0), strict=True)
    table: Table = {0: {}}
    for arm, (probability, reward) in enumerate(arms):
        table[0][arm] = [(probability, arm + 1, 0.0, False), (1.0 - probability, 0, 0.0, False)]
        table[arm + 1] = {action: [(1.0, 0, 0.0, False)] for action in range(6)}
        table[arm + 1][arm] = [(1.0, arm + 1, reward, False)]
    return table, start_in(7, 0)


#: How many bets there are that cover so many of the 38 numbers; the counts of an American table add up to 161, and the nine
#: that are missing to van Hasselt's 170 are counted with the bets on two numbers
_BETS = {1: 38, 2: 62 + 9, 3: 15, 4: 22, 5: 1, 6: 11, 12: 6, 18: 6}


def roulette() -> tuple[Table, Start]:
    """
    Build American roulette with 170 bets of 1, and a last action that leaves the table (van Hasselt, 2010, section 4.1).

    A bet on k numbers wins 36 / k - 1 with probability k / 38, so that every bet loses 1/19 on average. The one on five
    numbers pays 6, as in casinos, and loses 3/38. Which 170 bets he counted, van Hasselt does not say.

    :return: table and start distribution
    """
    bets: list[list[Outcome]] = []
    for covered, count in _BETS.items():
        win = 6.0 if covered == 5 else 36.0 / covered - 1.0
        bets += [[(covered / 38.0, 0, win, False), (1.0 - covered / 38.0, 0, -1.0, False)]] * count
    playing = {**dict(enumerate(bets)), len(bets): [(1.0, 1, 0.0, True)]}
    return {0: playing, 1: ended(1, len(playing))}, start_in(2, 0)


def max_bias(n_actions: int = 10) -> tuple[Table, Start]:
    """
    Build the example of maximisation bias (Sutton and Barto, 2018, example 6.7).

    State 0 is their A: the first half of the actions goes left, to B, the other half right, which ends the episode; both
    with a reward of 0. In B, state 1, every action ends it with -1.1 or 0.9, each half of the time: mean and variance of
    the normal distribution there. They do not print the number of actions.

    :param n_actions: an even number
    :return: table and start distribution
    """
    a = {action: [(1.0, 1, 0.0, False) if action < n_actions // 2 else (1.0, 2, 0.0, True)] for action in range(n_actions)}
    b: dict[int, list[Outcome]] = {action: [(0.5, 2, -1.1, True), (0.5, 2, 0.9, True)] for action in range(n_actions)}
    return {0: a, 1: b, 2: ended(2, n_actions)}, start_in(3, 0)
