"""The rewards of a running episode, for a Monitor that needs only their sum and their number."""

from collections.abc import Iterator


class SummedRewards:
    """
    Replaces the list in which a Monitor keeps the rewards of the running episode. It holds two numbers, however long the
    episode is.

    :param total: the sum of the rewards so far
    :param count: the number of rewards so far
    """

    def __init__(self, total: float = 0.0, count: int = 0) -> None:
        self.total = float(total)
        self.count = int(count)

    def append(self, reward: float) -> None:
        """
        :param reward: the reward of one more step
        """
        self.total += reward
        self.count += 1

    def __iter__(self) -> Iterator[float]:
        yield self.total

    def __len__(self) -> int:
        return self.count
