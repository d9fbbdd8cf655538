"""The README.md that lies beside an artifact and says what it is."""

from taxel.manifest import Manifest, Training


def card(manifest: Manifest) -> str:
    """A model card in Markdown, from nothing but the manifest."""
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

{_checked(manifest)}
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


def _checked(manifest: Manifest) -> str:
    parity = manifest.parity
    if parity is None:
        return "It has not been compared with the model that it was made from."
    windows, origin = (
        ("held-out windows", "the model that was trained")
        if manifest.training
        else ("random windows", "its source evaluated in double precision")
    )
    return (
        f"On {parity.windows} {windows} it differs from {origin} by at most "
        f"{parity.largest_difference:g} counts."
    )


def _cells(errors: dict[str, float]) -> str:
    figures = ("mae", "norm_mae", "mae_electrodes", "norm_mae_electrodes")
    return " | ".join(f"{errors[figure]:.3f}" for figure in figures)
