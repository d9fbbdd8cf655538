"""What tests of the loop share."""

from collections.abc import Iterator

import pytest

from taxel_models.loop.effects.effect import Effect
from taxel_models.loop.effects.registry import candidates
from taxel_models.loop.observations import Observations
from taxel_models.loop.reference import correlated, own_structure


@pytest.fixture(scope="module")
def quick_references() -> Iterator[None]:
    """References know nothing of moved inputs: these ask all models again and again, which takes long."""

    def quick(observations: Observations) -> list[Effect]:
        return [effect for effect in candidates(observations) if not effect.is_costly]

    with pytest.MonkeyPatch.context() as patch:
        for module in (own_structure, correlated):
            patch.setattr(module, "candidates", quick)
        yield
