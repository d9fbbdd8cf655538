"""The engines that a model is timed beside, and what is known of its operations."""

from dataclasses import dataclass

from taxel_bench.engines import Engine


@dataclass(frozen=True)
class OtherEngines:
    """The engines beside ours.

    Attributes:
        baseline: the published way; None where there is none for this artifact.
        flops: operations of one window; None where they cannot be counted.
        notes: what a reader of the figures must know.
        peers: other libraries that evaluate the same model file.
        skipped: peers that cannot, each with the reason.
    """

    baseline: Engine | None
    flops: int | None
    notes: list[str]
    peers: tuple[Engine, ...]
    skipped: dict[str, str]
