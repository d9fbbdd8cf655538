"""Gymnasium's observations with channels: its checker agrees, and each environment has its own past."""

import warnings
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.typing import NDArray

import taxel
from taxel.contacts import ContactSample
from taxel.errors import InvalidArgument
from taxel.gymnasium import TactileObservation, TactileVectorObservation
from taxel.local import shipped_repository
from taxel.predictor import Predictor
from taxel.skin import PAD

FINGERS = 2
Action = NDArray[np.float32]


class Press(gymnasium.Env[NDArray[np.float32], Action]):
    """Two fingertips that are pressed by the action, in episodes of a random length."""

    metadata = {"render_modes": []}  # noqa: RUF012
    observation_space = gymnasium.spaces.Box(0.0, 10.0, (FINGERS,), np.float32)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (FINGERS,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        super().reset(seed=seed)
        self.force = self.np_random.uniform(0.0, 2.0, FINGERS)
        self.left = int(self.np_random.integers(3, 9))
        return self.force.astype(np.float32), {}

    def step(self, action: Action) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        self.force = np.clip(self.force + action, 0.0, 10.0)
        self.left -= 1
        return self.force.astype(np.float32), 0.0, self.left == 0, False, {}


def pressed(env: Any, observation: Any, info: dict[str, Any]) -> tuple[Any, Any]:
    """Of one environment or of several: the observation is the force."""
    force = np.asarray(observation, np.float64)[..., None] * [0.0, 0.1, 1.0]
    return np.broadcast_to(PAD, force.shape), force


@pytest.fixture(scope="module")
def predictor() -> Iterator[Predictor]:
    with taxel.load(shipped_repository()) as source:
        yield source.predictor("xgb")


@pytest.fixture
def made() -> Iterator[str]:
    """A name that `gymnasium.make` knows, so that the checker asks for the same observations again."""
    gymnasium.register("taxel-tests/Press-v0", entry_point=Press, max_episode_steps=50)
    yield "taxel-tests/Press-v0"
    del gymnasium.registry["taxel-tests/Press-v0"]


# Of any wrapper the checker says that it is one.
@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version")
@pytest.mark.parametrize("dt", [0.02, 0.01, 0.004])
def test_gymnasiums_checker_passes(predictor: Predictor, made: str, dt: float) -> None:
    env = TactileObservation(gymnasium.make(made), predictor, pressed, dt=dt, fingers=FINGERS)
    # The checker closes an environment of the same specification, which no predictor is part of.
    check_env(env, skip_render_check=True, skip_close_check=True)
    assert env.observation_space["channels"].shape == (FINGERS, 21)


def test_channels_are_those_of_fingers(predictor: Predictor) -> None:
    env = TactileObservation(Press(), predictor, pressed, dt=0.02, fingers=FINGERS)
    fingers = predictor.fingers(FINGERS, rate_hz=50.0)
    for episode in range(2):
        observation, _ = env.reset(seed=episode)
        fingers.prime(*pressed(None, observation["observation"], {}))
        for _ in range(12):
            observation, *_ = env.step(env.action_space.sample())
            expected = fingers.step(*pressed(None, observation["observation"], {}))
            np.testing.assert_array_equal(observation["channels"], expected)


def test_an_episode_begins_as_if_it_had_been_touched_so_for_long(predictor: Predictor) -> None:
    env = TactileObservation(Press(), predictor, pressed, dt=0.02, fingers=FINGERS)
    observation, _ = env.reset(seed=5)
    position, force = pressed(None, observation["observation"], {})
    window = np.concatenate([position, force, force, force], axis=1).astype(np.float32)
    np.testing.assert_array_equal(observation["channels"], predictor.predict(window))


@pytest.mark.parametrize("dt", [0.02, 0.004])
def test_a_vector_is_as_many_environments(predictor: Predictor, dt: float) -> None:
    count, steps = 3, 30
    vector = TactileVectorObservation(
        SyncVectorEnv([Press] * count), predictor, pressed, dt=dt, fingers=FINGERS
    )
    alone = [TactileObservation(Press(), predictor, pressed, dt=dt, fingers=FINGERS) for _ in range(count)]
    observed, _ = vector.reset(seed=7)
    own = [env.reset(seed=7 + number)[0] for number, env in enumerate(alone)]
    assert observed in vector.observation_space
    random, ended, resets = np.random.default_rng(1), np.zeros(count, np.bool_), 0
    for _ in range(steps):
        actions = random.uniform(-1, 1, (count, FINGERS)).astype(np.float32)
        observed, _, terminated, truncated, _ = vector.step(actions)
        for number, env in enumerate(alone):
            resets += ended[number]
            # As Gymnasium does: the step after the last one of an episode resets instead.
            own[number] = env.reset()[0] if ended[number] else env.step(actions[number])[0]
            np.testing.assert_array_equal(observed["observation"][number], own[number]["observation"])
            np.testing.assert_array_equal(observed["channels"][number], own[number]["channels"])
        assert observed in vector.observation_space
        ended = terminated | truncated
    assert resets > count


def test_a_contact_that_looks_wrong_is_told_once(predictor: Predictor) -> None:
    def millimetres(env: Any, observation: Any, info: dict[str, Any]) -> tuple[Any, Any]:
        return np.tile([0.0, 0.0, -7.0], (FINGERS, 1)), np.tile([0.0, 0.0, 1.0], (FINGERS, 1))

    env = TactileObservation(Press(), predictor, millimetres, dt=0.02, fingers=FINGERS)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        for _ in range(3):
            env.reset(seed=1)
            env.step(env.action_space.sample())
    assert ["look like millimetres" in str(warning.message) for warning in told] == [True]
    env = TactileObservation(Press(), predictor, millimetres, dt=0.02, fingers=FINGERS, strict=True)
    with pytest.raises(InvalidArgument, match="look like millimetres"):
        env.reset(seed=1)
    with pytest.raises(InvalidArgument, match="look like millimetres"):
        env.step(env.action_space.sample())


def test_a_mask_resets_only_its_environments(predictor: Predictor) -> None:
    inner = SyncVectorEnv([Press] * 3, autoreset_mode=AutoresetMode.DISABLED)
    vector = TactileVectorObservation(inner, predictor, pressed, dt=0.02, fingers=FINGERS)
    vector.reset(seed=1)
    before = vector.step(np.ones((3, FINGERS), np.float32))[0]["channels"]
    mask = np.array([False, True, False])
    options: dict[str, Any] = {"reset_mask": mask}
    after, _ = vector.reset(seed=[None, 2, None], options=options)
    np.testing.assert_array_equal(after["channels"][~mask], before[~mask])
    fresh, _ = TactileObservation(Press(), predictor, pressed, dt=0.02, fingers=FINGERS).reset(seed=2)
    np.testing.assert_array_equal(after["channels"][1], fresh["channels"])


def test_a_contact_sample_keeps_its_place_where_nothing_touches_any_more(predictor: Predictor) -> None:
    place = np.array([[0.003, 0.0, -0.006], [-0.004, 0.001, -0.0069]])

    def contact(env: Any, observation: Any, info: dict[str, Any]) -> ContactSample:
        """The first fingertip is let go at the second step."""
        touched = np.array([env.unwrapped.left > 100, True])
        force = np.where(touched[:, None], [0.0, 0.0, 1.0], 0.0)
        position = np.where(touched[:, None], place, PAD)
        return ContactSample(position, force, touched, np.zeros(2), np.zeros(2))

    class Long(Press):
        def reset(self, **options: Any) -> tuple[NDArray[np.float32], dict[str, Any]]:
            begun = super().reset(**options)
            self.left = 102
            return begun

    env = TactileObservation(Long(), predictor, contact, dt=0.01, fingers=FINGERS)
    env.reset(seed=1)
    for _ in range(40):
        observation, *_ = env.step(np.zeros(FINGERS, np.float32))
    window = np.zeros((2, 12), np.float32)
    window[:, :3], window[1, [5, 8, 11]] = place, 1.0
    np.testing.assert_array_equal(observation["channels"], predictor.predict(window))


def test_what_does_not_fit_is_told(predictor: Predictor) -> None:
    for wrong, said in (
        ({"dt": 0.0}, "dt is 0.0: expected seconds above 0"),
        ({"fingers": 0}, "fingers is 0: expected a whole number"),
    ):
        with pytest.raises(InvalidArgument, match=said):
            TactileObservation(Press(), predictor, pressed, **{"dt": 0.02, **wrong})  # type: ignore[arg-type]
    once = TactileObservation(Press(), predictor, pressed, dt=0.02, fingers=FINGERS)
    with pytest.raises(InvalidArgument, match="'channels' already"):
        TactileObservation(once, predictor, pressed, dt=0.02, fingers=FINGERS)
    with pytest.raises(InvalidArgument, match=r"places of shape \(2, 3\): expected \(3, 3\)"):
        TactileObservation(Press(), predictor, pressed, dt=0.02, fingers=3).reset(seed=1)
    sample = ContactSample(np.zeros((3, 3)), np.zeros((3, 3)), np.ones(3, bool), np.zeros(3), np.zeros(3))
    with pytest.raises(InvalidArgument, match="contact gives 3 fingertips: expected 2"):
        TactileObservation(Press(), predictor, lambda *_: sample, dt=0.02, fingers=2).reset(seed=1)
    with pytest.raises(InvalidArgument, match=r"contact gives .*: expected places and forces"):
        TactileObservation(Press(), predictor, lambda *_: 3, dt=0.02).reset(seed=1)  # type: ignore[arg-type,return-value]
    same = SyncVectorEnv([Press], autoreset_mode=AutoresetMode.SAME_STEP)
    with pytest.raises(InvalidArgument, match="expected NEXT_STEP or DISABLED"):
        TactileVectorObservation(same, predictor, pressed, dt=0.02, fingers=FINGERS)
