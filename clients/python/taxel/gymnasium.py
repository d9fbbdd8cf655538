"""BioTac channels in the observations of Gymnasium, for one environment or for a vector of them.

    env = taxel.gymnasium.TactileObservation(env, predictor, contact, dt=0.02)
    observation, info = env.reset(seed=1)
    observation["channels"]  # (fingers, 21), counts

`contact(env, observation, info)` tells what touches the fingertips: a `taxel.contacts.ContactSample`, such
as `taxel.mujoco.SiteContacts` reads; or places, m, and forces on the finger, N, in each sensor's frame,
each (fingers, 3), of a vector environment (environments, fingers, 3).

An episode begins as if the fingertips had been touched so, without a change, for long. Each step waits for
its predictions, so that an environment with a seed gives the same observations again.
"""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import override

from taxel.arguments import is_real, is_whole
from taxel.channels import CHANNELS, COUNTS_MAX
from taxel.contacts import ContactSample
from taxel.errors import InvalidArgument, MissingDependency
from taxel.fingers import Fingers
from taxel.predictor import Predictor
from taxel.skin import PAD

try:
    import gymnasium
    from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
    from gymnasium.vector.utils import batch_space
except ModuleNotFoundError as error:
    raise MissingDependency("taxel.gymnasium", str(error.name), "gymnasium") from None

KEY: Final = "channels"
"""The channels in an observation; what was the observation before stands under `observation`."""

Contact = Callable[[Any, Any, dict[str, Any]], ContactSample | tuple[ArrayLike, ArrayLike]]
"""From an environment, its observation and its info to what touches the fingertips."""


class TactileObservation(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Adds the channels to the observations of an environment.

    The observation becomes a dictionary with `channels`, (fingers, 21) float32, counts. A dictionary keeps
    its own keys beside it; any other observation stands under `observation`. Channels end at ±4095, as
    those of the sensor's converter, and differences of them, do.

    Args:
        env: the environment.
        predictor: local or remote.
        contact: tells what touches the fingertips; see the module.
        dt: seconds that pass in a step of the environment.
        fingers: how many fingertips it has.
        strict: a contact that looks wrong is an error, not an `taxel.errors.InputWarning`.

    Raises:
        InvalidArgument: a shape is wrong, or a number is not finite or not positive.
        RequestError: no prediction could be had.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        predictor: Predictor,
        contact: Contact,
        *,
        dt: float,
        fingers: int = 1,
        strict: bool = False,
    ) -> None:
        super().__init__(env)
        self._touch = _Touch(predictor, contact, dt, (_checked_fingers(fingers),), strict)
        self.observation_space = _space(env.observation_space, fingers)

    @override
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        observation, info = self.env.reset(seed=seed, options=options)
        channels = self._touch.begin(self.env, observation, info)
        return _joined(observation, channels), info

    @override
    def step(self, action: Any) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        channels = self._touch.step(self.env, observation, info)
        return _joined(observation, channels), reward, terminated, truncated, info


class TactileVectorObservation(VectorWrapper):
    """Adds the channels to the observations of a vector environment, all in one prediction a step.

    Each environment's fingertips have a clock and a past of their own. They begin again with its episodes:
    in the step in which the vector environment resets it (`AutoresetMode.NEXT_STEP`), or at
    `reset(options={"reset_mask": ...})` (`AutoresetMode.DISABLED`).

    Args:
        env: the vector environment.
        predictor: local or remote.
        contact: tells what touches the fingertips of all environments, (environments, fingers, 3).
        dt: seconds that pass in a step.
        fingers: how many fingertips each environment has.
        strict: a contact that looks wrong is an error.

    Raises:
        InvalidArgument: as `TactileObservation`; or the environment resets in the same step, after which
            what touched the fingertips at the end of an episode is no longer known.
        RequestError: no prediction could be had.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        predictor: Predictor,
        contact: Contact,
        *,
        dt: float,
        fingers: int = 1,
        strict: bool = False,
    ) -> None:
        super().__init__(env)
        mode = env.metadata.get("autoreset_mode")
        if mode not in (AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED):
            raise InvalidArgument(
                f"the vector environment's metadata['autoreset_mode'] is {mode!r}: expected "
                "NEXT_STEP or DISABLED"
            )
        self._resets_itself = mode == AutoresetMode.NEXT_STEP
        self._touch = _Touch(predictor, contact, dt, (env.num_envs, _checked_fingers(fingers)), strict)
        self.single_observation_space = _space(env.single_observation_space, fingers)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        self._ended = np.zeros(env.num_envs, np.bool_)

    @override
    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        # The environment takes the mask out of the options.
        mask = (options or {}).get("reset_mask")
        begun = np.ones(self.num_envs, np.bool_) if mask is None else np.array(mask, np.bool_)
        observation, info = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        channels = self._touch.begin(self.env, observation, info, begun)
        self._ended[begun] = False
        return _joined(observation, channels), info

    @override
    def step(self, actions: Any) -> tuple[dict[str, Any], Any, Any, Any, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(actions)
        channels = self._touch.step(self.env, observation, info, self._ended)
        if self._resets_itself:
            self._ended = np.logical_or(terminated, truncated)
        return _joined(observation, channels), reward, terminated, truncated, info


class _Touch:
    """The fingertips of one environment, (fingers,), or of several, (environments, fingers)."""

    def __init__(
        self, predictor: Predictor, contact: Contact, dt: float, shape: tuple[int, ...], strict: bool
    ) -> None:
        if not is_real(dt) or not 0.0 < dt < np.inf:
            raise InvalidArgument(f"dt is {dt!r}: expected seconds above 0")
        self._predictor, self._contact, self._rate_hz, self._shape = predictor, contact, 1.0 / dt, shape
        self._fingers = predictor.fingers(int(np.prod(shape)), rate_hz=self._rate_hz, strict=strict)
        self._last = np.tile(PAD, (len(self._fingers), 1))

    def step(
        self, env: Any, observation: Any, info: dict[str, Any], begun: NDArray[np.bool_] | None = None
    ) -> NDArray[np.float32]:
        """The channels after a step; where an episode has begun in it, those of its beginning."""
        ids = self._ids(np.array([False]) if begun is None else begun)
        position, force = self._read(env, observation, info, ids)
        self._fingers.step(position, force)
        return self._begin(position, force, ids)

    def begin(
        self, env: Any, observation: Any, info: dict[str, Any], begun: NDArray[np.bool_] | None = None
    ) -> NDArray[np.float32]:
        """The channels where episodes begin; elsewhere the newest."""
        ids = self._ids(np.array([True]) if begun is None else begun)
        position, force = self._read(env, observation, info, ids)
        return self._begin(position, force, ids)

    def _ids(self, begun: NDArray[np.bool_]) -> NDArray[np.int64]:
        """The numbers of the fingertips of some environments."""
        along = begun.reshape(-1, *(1 for _ in self._shape[1:]))
        return np.flatnonzero(np.broadcast_to(along, self._shape))

    def _begin(
        self, position: NDArray[np.float64], force: NDArray[np.float64], ids: NDArray[np.int64]
    ) -> NDArray[np.float32]:
        """The channels in a new array, after these fingertips begin again as they are touched now."""
        channels = self._fingers.channels.copy()
        if len(ids):
            self._fingers.prime(position[ids], force[ids], ids)
            # Others must not step for the first channels of these, which their own steps will check.
            first = Fingers(self._predictor, len(ids), rate_hz=self._rate_hz)
            first.prime(position[ids], force[ids])
            channels[ids] = first.step(position[ids], force[ids])
        np.clip(channels, -COUNTS_MAX, COUNTS_MAX, out=channels)
        return channels.reshape(*self._shape, len(CHANNELS))

    def _read(
        self, env: Any, observation: Any, info: dict[str, Any], begun: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Places and forces of all fingertips now, (n, 3); `begun` have no last place."""
        touched = self._contact(env, observation, info)
        self._last[begun] = PAD
        if isinstance(touched, ContactSample):
            if len(touched.position) != len(self._last):
                raise InvalidArgument(
                    f"contact gives {len(touched.position)} fingertips: expected {len(self._last)}"
                )
            place = np.where(touched.touched[:, None], touched.position, self._last)
            self._last = place.copy()
            return place, touched.force
        try:
            position, force = (np.asarray(values, np.float64) for values in touched)
        except (TypeError, ValueError, RuntimeError) as error:
            raise InvalidArgument(f"contact gives {error}: expected places and forces") from None
        for name, values in (("places", position), ("forces", force)):
            if values.shape != (*self._shape, 3):
                raise InvalidArgument(
                    f"contact gives {name} of shape {values.shape}: expected {(*self._shape, 3)}"
                )
        return position.reshape(-1, 3), force.reshape(-1, 3)


def _checked_fingers(fingers: Any) -> int:
    if not is_whole(fingers) or fingers < 1:
        raise InvalidArgument(f"fingers is {fingers!r}: expected a whole number, at least 1")
    return int(fingers)


def _space(before: gymnasium.Space[Any], fingers: int) -> gymnasium.spaces.Dict:
    """The space of observations with channels."""
    own = dict(before.spaces) if isinstance(before, gymnasium.spaces.Dict) else {"observation": before}
    if KEY in own:
        raise InvalidArgument(f"the observation has {KEY!r} already: expected another key")
    counts = gymnasium.spaces.Box(-COUNTS_MAX, COUNTS_MAX, (fingers, len(CHANNELS)), np.float32)
    return gymnasium.spaces.Dict({**own, KEY: counts})


def _joined(observation: Any, channels: NDArray[np.float32]) -> dict[str, Any]:
    own = observation if isinstance(observation, dict) else {"observation": observation}
    return {**own, KEY: channels}
