"""Runs with `taxel[gymnasium]`, beside a server: an environment whose observations get the channels."""

import sys

import gymnasium
import numpy as np

import taxel
import taxel.gymnasium

PLACE, FORCE = [[0.0, 0.0, -0.007]], [[0.0, 0.0, 1.0]]


class Finger(gymnasium.Env[np.ndarray, np.ndarray]):
    """It is touched, and nothing else happens."""

    observation_space = action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        """As Gymnasium asks."""
        return np.zeros(1, np.float32), {}

    def step(self, action):
        """As Gymnasium asks."""
        return np.zeros(1, np.float32), 0.0, False, False, {}


with taxel.connect(sys.argv[-1]) as source:
    predictor = source.predictor("ffnn-causal")
    touched = taxel.gymnasium.TactileObservation(Finger(), predictor, lambda *_: (PLACE, FORCE), dt=0.01)
    touched.reset(seed=1)
    observation = touched.step(np.zeros(1, np.float32))[0]
assert observation["channels"].shape == (1, len(taxel.CHANNELS)), observation
