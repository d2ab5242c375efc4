"""Grid worlds. A cell is (row, column) from the top left; states count row by row."""

from collections.abc import Callable, Collection

from sb3_adaptive_q.envs.tables.types import Cell, GridTable, Outcome, Start, Table, ended, start_in

UP, DOWN, LEFT, RIGHT = (-1, 0), (1, 0), (0, -1), (0, 1)
DIAGONALS = [(-1, -1), (-1, 1), (1, -1), (1, 1)]

#: Upward shift in each column of the windy grid
_WIND = (0, 0, 0, 1, 1, 1, 2, 2, 1, 0)


def windy_grid(king: bool = False) -> tuple[Table, Start]:
    """
    Build the windy grid world of 7 by 10 cells (Sutton and Barto, 2018, example 6.5; with ``king`` exercise 6.10).

    Every step is rewarded with -1 until the goal is reached. The shortest way has 15 steps without ``king``.

    :param king: whether there are eight moves, and wind that varies by one cell either way, each with probability 1/3, in
        the columns that have wind
    :return: table and start distribution
    """
    moves = [UP, DOWN, LEFT, RIGHT, *(DIAGONALS if king else [])]
    goal = (3, 7)

    def outcomes(cell: Cell, move: Cell) -> list[Outcome]:
        wind = _WIND[cell[1]]
        winds = [wind - 1, wind, wind + 1] if king and wind else [wind]
        column = min(max(cell[1] + move[1], 0), 9)
        cells = [(min(max(cell[0] + move[0] - shift, 0), 6), column) for shift in winds]
        return [(1.0 / len(winds), row * 10 + column, -1.0, (row, column) == goal) for row, column in cells]

    return _grid((7, 10), moves, (3, 0), goal, outcomes)


def dyna_maze() -> tuple[Table, Start]:
    """
    Build the maze of 6 by 9 cells of Sutton and Barto (2018), figure 8.2.

    The goal is worth 1, everything else 0; the shortest way has 14 steps.

    :return: table and start distribution
    """
    return _maze({(1, 2), (2, 2), (3, 2), (4, 5), (0, 7), (1, 7), (2, 7)}, start=(2, 0))


def blocking_mazes() -> list[tuple[Table, Start]]:
    """
    Build the two phases of the blocking maze (Sutton and Barto, 2018, example 8.2): the short way closes, a long one opens.

    :return: table and start distribution of both
    """
    return [_maze({(3, column) for column in columns}, start=(5, 3)) for columns in (range(8), range(1, 9))]


def shortcut_mazes() -> list[tuple[Table, Start]]:
    """
    Build the two phases of the shortcut maze (Sutton and Barto, 2018, example 8.3): a shorter way opens.

    :return: table and start distribution of both
    """
    return [_maze({(3, column) for column in columns}, start=(5, 3)) for columns in (range(1, 9), range(1, 8))]


def hasselt_grid() -> tuple[Table, Start]:
    """
    Build the grid of 3 by 3 cells of van Hasselt (2010), section 4.2.

    In the goal, top right, every action ends the episode with 5; every other step pays -12 or 10, each half of the time.

    :return: table and start distribution
    """
    goal = (0, 2)

    def outcomes(cell: Cell, move: Cell) -> list[Outcome]:
        if cell == goal:
            return [(1.0, 2, 5.0, True)]
        row, column = _moved((3, 3), cell, move)
        return [(0.5, row * 3 + column, reward, False) for reward in (-12.0, 10.0)]

    return _grid((3, 3), [UP, DOWN, LEFT, RIGHT], (2, 0), goal, outcomes, ends_in_goal=False)


def moving_goals() -> list[tuple[Table, Start]]:
    """
    Build three slippery grids of 8 by 8 cells without holes, with the goal in another far corner each.

    As on gymnasium's FrozenLake, whose order of actions this is, the move goes astray to either side with probability 1/3
    each. Who comes into the goal's corner, or stays in it against the wall, is paid 1, and the episode ends; so one who
    stands there when the goal appears has to stay or come back.

    :return: table and start distribution of the goals bottom right, top right, bottom left
    """
    moves = [LEFT, DOWN, RIGHT, UP]

    def of_goal(goal: Cell) -> tuple[Table, Start]:
        def outcomes(cell: Cell, move: Cell) -> list[Outcome]:
            action = moves.index(move)
            cells = [_moved((8, 8), cell, moves[(action + turn) % 4]) for turn in (-1, 0, 1)]
            return [
                (1.0 / 3.0, row * 8 + column, float((row, column) == goal), (row, column) == goal) for row, column in cells
            ]

        return _grid((8, 8), moves, (0, 0), goal, outcomes, ends_in_goal=False)

    return [of_goal(goal) for goal in ((7, 7), (0, 7), (7, 0))]


def _maze(walls: Collection[Cell], start: Cell) -> tuple[Table, Start]:
    """A grid of 6 by 9 cells with the goal top right; whoever runs into a wall stays where they are."""
    goal = (0, 8)

    def outcomes(cell: Cell, move: Cell) -> list[Outcome]:
        moved = _moved((6, 9), cell, move)
        row, column = cell if moved in walls else moved
        return [(1.0, row * 9 + column, float((row, column) == goal), (row, column) == goal)]

    return _grid((6, 9), [UP, DOWN, LEFT, RIGHT], start, goal, outcomes, walls)


def _moved(shape: tuple[int, int], cell: Cell, move: Cell) -> Cell:
    return min(max(cell[0] + move[0], 0), shape[0] - 1), min(max(cell[1] + move[1], 0), shape[1] - 1)


def _grid(
    shape: tuple[int, int],
    moves: list[Cell],
    start: Cell,
    goal: Cell,
    outcomes: Callable[[Cell, Cell], list[Outcome]],
    walls: Collection[Cell] = (),
    ends_in_goal: bool = True,
) -> tuple[Table, Start]:
    """The table of what happens with each move in each cell, and nothing more in the goal where episodes have ended there."""
    n_rows, n_columns = shape
    cells = [(row, column) for row in range(n_rows) for column in range(n_columns)]
    table = {state: {action: outcomes(cell, move) for action, move in enumerate(moves)} for state, cell in enumerate(cells)}
    if ends_in_goal:
        table[goal[0] * n_columns + goal[1]] = ended(goal[0] * n_columns + goal[1], len(moves))
    letters = {**dict.fromkeys(walls, "#"), start: "S", goal: "G"}
    desc = ["".join(letters.get((row, column), ".") for column in range(n_columns)) for row in range(n_rows)]
    return GridTable(table, desc, moves), start_in(len(cells), start[0] * n_columns + start[1])
