"""MountainCar for the compiled path, as a user would write it: three functions and their parameters."""

import math
from typing import NamedTuple

import numpy as np
from gymnasium.envs.classic_control.mountain_car import MountainCarEnv

from sb3_adaptive_q.vec_env import Dynamics, as_float32, grid_index, register_dynamics


class MountainCarParameters(NamedTuple):
    force: float
    gravity: float
    max_speed: float
    min_position: float
    max_position: float
    goal_position: float
    goal_velocity: float
    edges: np.ndarray
    counts: np.ndarray
    scales: np.ndarray


@register_dynamics(MountainCarEnv)
class MountainCarDynamics(Dynamics):
    def __init__(self, env, grid):
        super().__init__(env, grid)
        if grid is None:
            raise ValueError("MountainCar needs a DiscretizeObservation around it.")
        constants = (float(getattr(env, name)) for name in MountainCarParameters._fields[:7])
        self.parameters = MountainCarParameters(*constants, *grid)

    @staticmethod
    def reset(parameters, generator):
        return -0.6 + (-0.4 - -0.6) * generator.random(), 0.0

    @staticmethod
    def step(parameters, state, action, generator):
        position, velocity = state
        velocity += (action - 1) * parameters.force + math.cos(3 * position) * -parameters.gravity
        velocity = min(max(velocity, -parameters.max_speed), parameters.max_speed)
        position = min(max(position + velocity, parameters.min_position), parameters.max_position)
        if position == parameters.min_position and velocity < 0:
            velocity = 0.0
        terminated = position >= parameters.goal_position and velocity >= parameters.goal_velocity
        return (position, velocity), -1.0, terminated

    @staticmethod
    def index(parameters, state):
        observation = (as_float32(state[0]), as_float32(state[1]))
        return grid_index(parameters.edges, parameters.counts, parameters.scales, observation)
