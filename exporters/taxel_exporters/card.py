"""The README.md of an artifact: a model card."""

from taxel.corrections import AppliedEffect
from taxel.manifest import Manifest, Parity, RoundedWeights, Training
from taxel.windows import ExtraFeature


def card(manifest: Manifest) -> str:
    """A model card in Markdown, made from the manifest alone."""
    ahead = manifest.window.look_ahead
    timing = (
        f"online it answers {ahead * manifest.window.sample_period_ms:g} ms late" if ahead else "causal"
    )
    return f"""# {manifest.name}, version {manifest.version}

{manifest.description}

- {_family(manifest)}{manifest.parameters} parameters, platform `{manifest.platform}`.
- Window: input combination {manifest.window.combination}, {len(manifest.window.features)} values; {timing}.
- Output: 21 channels in 12-bit counts.

{_imported(manifest) if manifest.training is None else _trained(manifest.training)}
{_corrected(manifest) if manifest.effects else ""}
{" ".join(_checked(manifest))}
"""


def _family(manifest: Manifest) -> str:
    return f"Family `{manifest.training.family}`, " if manifest.training else ""


def _trained(training: Training) -> str:
    errors = training.metrics["test"]
    baseline = training.metrics["mean_predictor"]
    sources = "\n".join(
        f"- {source.name} ({source.format}, {source.rows} rows, sha256 {source.sha256[:12]}…)"
        for source in training.data
    )
    return f"""## Trained on

{sources}

{training.windows["train"]} windows to train, {training.windows["validation"]} to stop early, \
{training.windows["test"]} held out. Seed {training.seed}.

## On the held-out part

| | MAE, counts | normalised MAE | MAE electrodes | normalised MAE electrodes |
| --- | --- | --- | --- | --- |
| this model | {_cells(errors)} |
| mean predictor | {_cells(baseline)} |"""


def _imported(manifest: Manifest) -> str:
    imported = manifest.imported
    assert imported is not None
    return f"""## Imported from

- {imported.file} ({imported.format}, sha256 {imported.sha256[:12]}…)

It was trained elsewhere: on which data, and how well it predicts data held out from it, is not known."""


def _corrected(manifest: Manifest) -> str:
    effects = "\n".join(_effect(effect) for effect in manifest.effects)
    needs = "\n".join(_need(extra) for extra in manifest.window.effect_extras)
    return f"""
## Corrected

Effects found in measured data were added to the model; errors above are of the model without them.

{effects}

At run time they need:

{needs or "- nothing beside the window."}
"""


def _effect(effect: AppliedEffect) -> str:
    parameters = ", ".join(
        f"{parameter.name} {parameter.value:.4g} {parameter.unit}".rstrip()
        for parameter in effect.parameters
    )
    return f"- `{effect.name}`: {effect.about}" + (f" ({parameters})" if parameters else "")


def _need(extra: ExtraFeature) -> str:
    if extra.history is not None:
        return f"- `{extra.name}` ({extra.unit}), computed by the window builder from past contacts."
    return f"- `{extra.name}` ({extra.unit}), given by the caller; {extra.default:g} where it is not."


def _checked(manifest: Manifest) -> list[str]:
    found = [rounding(manifest, manifest.rounded_weights)] if manifest.rounded_weights else []
    if manifest.parity is not None:
        found.append(_agreement(manifest, manifest.parity))
    return found or ["It has not been compared with the model that it was made from."]


def _agreement(manifest: Manifest, parity: Parity) -> str:
    if manifest.effects:
        windows, origin = "windows", "the model's own prediction with the effects added apart"
    elif manifest.training:
        windows, origin = "held-out windows", "the model that was trained"
    else:
        windows, origin = "random windows", "its source evaluated in double precision"
    return (
        f"On {parity.windows} {windows} it differs from {origin} by at most "
        f"{parity.largest_difference:g} counts."
    )


def rounding(manifest: Manifest, weights: RoundedWeights) -> str:
    """One sentence on the size and the error of rounded weights."""
    return (
        f"Its weights are rounded to {weights.datatype}: on {weights.windows} held-out windows the "
        f"normalised MAE is {weights.norm_mae:.4f}, with float32 weights {weights.float32_norm_mae:.4f} "
        f"({weights.rise:+.2%}); the model file has {manifest.model_file.size / 1e6:.2f} MB instead of "
        f"{weights.float32_size / 1e6:.2f} MB."
    )


def _cells(errors: dict[str, float]) -> str:
    figures = ("mae", "norm_mae", "mae_electrodes", "norm_mae_electrodes")
    return " | ".join(f"{errors[figure]:.3f}" for figure in figures)
