"""Rounds that take turns over base models, so that their rates tell of models and not of one."""

from dataclasses import dataclass, replace

from taxel_models.ground.ground import Clean, Ground


@dataclass(frozen=True)
class SeveralModels:
    """Grounds that differ in their base model. Rounds take turns, so that few rounds have all of them."""

    grounds: tuple[Ground, ...]

    def clean(self, number: int) -> Clean:
        """A recording of the round's own ground, with the number of its model."""
        model = number % len(self.grounds)
        return replace(self.grounds[model].clean(number), base_model=model)
