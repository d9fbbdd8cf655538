"""The README.md that lies beside an artifact and says what it is."""

from taxel.manifest import Manifest


def card(manifest: Manifest) -> str:
    """A model card in Markdown, from nothing but the manifest."""
    training = manifest.training
    errors = training.metrics["test"]
    baseline = training.metrics["mean_predictor"]
    ahead = manifest.window.look_ahead
    timing = (
        f"online it answers {ahead * manifest.window.sample_period_ms:g} ms late" if ahead else "causal"
    )
    sources = "\n".join(
        f"- {source.name} ({source.format}, {source.rows} rows, sha256 {source.sha256[:12]}…)"
        for source in training.data
    )
    parity = manifest.parity
    checked = (
        f"On {parity.windows} held-out windows it differs from the model that was trained by at most "
        f"{parity.largest_difference:g} counts."
        if parity
        else "It has not been compared with the model that was trained."
    )
    return f"""# {manifest.name}, version {manifest.version}

{manifest.description}

- Family `{training.family}`, {manifest.parameters} parameters, platform `{manifest.platform}`.
- Window: input combination {manifest.window.combination}, {len(manifest.window.features)} values; {timing}.
- Output: 21 channels in 12-bit counts.

## Trained on

{sources}

{training.windows["train"]} windows to train, {training.windows["validation"]} to stop early, \
{training.windows["test"]} held out. Seed {training.seed}.

## On the held-out part

| | MAE, counts | normalised MAE | MAE electrodes | normalised MAE electrodes |
| --- | --- | --- | --- | --- |
| this model | {_cells(errors)} |
| mean predictor | {_cells(baseline)} |

{checked}
"""


def _cells(errors: dict[str, float]) -> str:
    figures = ("mae", "norm_mae", "mae_electrodes", "norm_mae_electrodes")
    return " | ".join(f"{errors[figure]:.3f}" for figure in figures)
